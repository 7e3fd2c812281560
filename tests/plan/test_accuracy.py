"""The working accuracy D: known errors of wheel, blade and arm are told along normal, feed and lateral; so is what is left."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from ocp.model.theta import NAMES, Theta, registered
from ocp.plan.accuracy import accuracy_columns, accuracy_rows, working_accuracy
from ocp.plan.passes.optimise import SolvedPass
from ocp.plan.passes.posture import Seed
from ocp.plan.passes.problem import PassProblem
from ocp.plan.passes.solve import PassSolution, PassSolver
from ocp.plan.passes.stage import ObjectiveWeights
from robots.calibration.store import Calibration
from robots.kinematics import forward
from robots.pose import apply
from tests.support.example_pass import LineLaw, bar_pass, bundled_cell

Q = np.radians([0.5, -82.0, 101.0, -2.0, 80.0, -84.0]) + np.linspace(0, 0.05, 40)[:, None] * [1, 0.5, -0.4, 1, 0.2, 2]


def solved_on(cell, theta, q=Q):
    """Joints q on the bar, as a solved pass of that cell; nothing is optimised."""
    path = bar_pass()
    problem = PassProblem.start(path, Seed(1, 0, np.zeros(4), 0.0, Q[:4], np.linspace(0, 1, 4), 0.0), np.zeros((40, 3)))
    seen = PassSolver(cell, LineLaw(), theta, ObjectiveWeights()).evaluate(problem, q, path.force)
    ones = np.ones(40)
    return SolvedPass(problem, PassSolution(q, ones, ones, path.force, 0, 0.0), seen)


def unbent():
    """The bundled cell, its arm without weight."""
    return replace(bundled_cell(), compliant_joints=())


def calibrated(cell, **values):
    return replace(
        cell, calibration=Calibration(cell.robot.name, tuple(values), np.array([*values.values()]), np.eye(len(values)), {})
    )


def found(believed, theta=None, q=Q):
    cell, known = registered(believed)
    known = known if theta is None else theta
    one = solved_on(cell, known, q)
    nominal = replace(believed, calibration=None)
    return working_accuracy(nominal, cell, known, LineLaw(), [one])[0], one


def axes(one, robot) -> np.ndarray:
    """Feed, lateral, normal (40, 3, 3) in the base frame, rows, from the nominal arm."""
    R = (forward(robot, Q) @ bundled_cell().workpiece.T_flange_blade)[:, :3, :3]
    path = one.problem.path
    return np.stack([np.einsum("kij,kj->ki", R, v) for v in (path.t, np.cross(path.n, path.t), path.n)], axis=1)


def test_a_wheel_that_stands_elsewhere():
    shift = np.array([3e-4, -2e-4, 5e-4])
    accuracy, one = found(calibrated(unbent(), wheel_x=shift[0], wheel_y=shift[1], wheel_z=shift[2]))
    assert accuracy.shift == pytest.approx(-axes(one, unbent().robot) @ shift, abs=1e-9)


def test_a_blade_that_sits_elsewhere_and_an_arm_that_is_not_as_drawn():
    cell = unbent()
    accuracy, one = found(calibrated(cell, blade_x=1e-4, blade_y=-3e-4, blade_z=2e-4))
    R = forward(cell.robot, Q)[:, :3, :3] @ np.array([1e-4, -3e-4, 2e-4])
    assert accuracy.shift == pytest.approx(np.einsum("kij,kj->ki", axes(one, cell.robot), R), abs=1e-9)
    mdh = cell.robot.mdh.copy()
    mdh[1, 2] += 4e-4  # a2
    accuracy, one = found(calibrated(cell, a2=float(mdh[1, 2])))
    T = cell.workpiece.T_flange_blade
    before, after = (apply(forward(robot, Q) @ T, one.problem.path.p) for robot in (cell.robot, replace(cell.robot, mdh=mdh)))
    assert accuracy.shift == pytest.approx(np.einsum("kij,kj->ki", axes(one, cell.robot), after - before), abs=1e-9)


def test_what_the_model_leaves_open_is_told_along_the_same_axes():
    cell, theta = registered(unbent())
    spread = np.array([1e-4, 3e-4, 2e-4])
    covariance = np.zeros_like(theta.covariance)
    index = [NAMES.index(f"wheel_{axis}") for axis in "xyz"]
    covariance[index, index] = spread**2
    accuracy, one = found(unbent(), Theta(theta.values, covariance, 0.0))
    # The slopes are taken about the wheel's own radial and axis; on the bar the blade's normal lies a few degrees beside.
    e = cell.wheel.outward(one.evaluation.arc)
    assert accuracy.sd[:, 2] == pytest.approx(np.sqrt((e * spread) ** 2 @ np.ones(3)), rel=1e-3)
    assert (accuracy.sd**2).sum(axis=1) == pytest.approx(np.full(40, (spread**2).sum()), rel=2e-3)


@pytest.mark.parametrize("turned", [0.4, -0.4])
def test_what_is_open_along_the_feed_is_told_along_it_where_the_belt_runs_askew(turned):
    """The feed as it lies on the wheel, which turns under the blade's own by most of what axis 4 turns."""
    cell, theta = registered(unbent())
    spread, q = np.array([1e-4, 3e-4, 2e-4]), Q + turned * np.eye(6)[3]
    index = [NAMES.index(f"wheel_{axis}") for axis in "xyz"]
    covariance = np.zeros_like(theta.covariance)
    covariance[np.ix_(index, index)] = np.outer(spread, spread)  # along one line, up and aside
    accuracy, one = found(unbent(), Theta(theta.values, covariance, 0.0), q)
    e = cell.wheel.outward(one.evaluation.arc)
    t = np.einsum("kij,kj->ki", one.evaluation.T_base_blade[:, :3, :3], one.problem.path.t)
    t -= np.sum(t * e, axis=1)[:, None] * e
    t /= np.linalg.norm(t, axis=1, keepdims=True)
    for column, direction in ((0, t), (1, np.cross(e, t))):
        assert accuracy.sd[:, column] == pytest.approx(np.abs(direction @ spread), rel=1e-3, abs=1e-8)
    assert np.abs(one.evaluation.turn).min() > 0.35


def test_what_moves_the_joints_beside_the_model_adds_what_the_arm_makes_of_it():
    cell, theta = registered(unbent())
    nothing, noise = np.zeros_like(theta.covariance), 1e-4
    (still, one), (noisy, _) = (found(unbent(), Theta(theta.values, nothing, sd)) for sd in (0.0, noise))
    T, h, p = cell.workpiece.T_flange_blade, 1e-6, one.problem.path.p
    moved = [
        (apply(forward(cell.robot, Q + d) @ T, p) - apply(forward(cell.robot, Q - d) @ T, p)) / (2 * h) for d in h * np.eye(6)
    ]
    e = cell.wheel.outward(one.evaluation.arc)
    assert still.sd == pytest.approx(0.0)
    assert noisy.sd[:, 2] == pytest.approx(noise * np.sqrt(sum(np.sum(e * v, axis=1) ** 2 for v in moved)), rel=1e-3)
    assert (noisy.sd**2).sum(axis=1) == pytest.approx(noise**2 * sum(np.sum(v**2, axis=1) for v in moved), rel=5e-3)


def test_columns_and_figures_of_a_plan():
    accuracy, one = found(calibrated(unbent(), wheel_x=3e-4))
    motion = SimpleNamespace(passes=[one, one], segments=[SimpleNamespace(place=place) for place in (0, 0, 1)])
    s = np.array([np.nan, 0.0, 0.03, 0.06, 0.061, np.nan, 0.06])
    segment, contact = np.array([0, 1, 1, 1, 1, 2, 2]), np.array([0, 1, 1, 1, 1, 0, 1], bool)
    line = SimpleNamespace(time=np.arange(7.0), segment=segment, contact=contact, s=s)
    both = [accuracy, replace(accuracy, shift=2.0 * accuracy.shift)]
    columns = {name: values for name, values, _ in accuracy_columns(both, motion, line)}  # type: ignore[arg-type]
    assert list(columns) == ["d_normal_mm", "d_feed_mm", "d_lateral_mm"]
    for name, axis in (("normal", 2), ("feed", 0), ("lateral", 1)):  # D's axes are x along the feed, y lateral, z normal
        first, last = 1e3 * accuracy.shift[[0, -1], axis]
        assert columns[f"d_{name}_mm"][[1, 3, 4, 6]] == pytest.approx([first, last, last, 2 * last])
        assert np.isnan(columns[f"d_{name}_mm"][[0, 5]]).all()
    assert len({round(float(columns[name][1]), 4) for name in columns}) == 3
    rows = accuracy_rows([accuracy], [one])  # type: ignore[list-item]
    rms = 1e3 * np.sqrt(np.mean(accuracy.shift**2, axis=0))
    told = zip(rms[[2, 0, 1]], ("normal", "feed", "lateral"), strict=True)
    assert rows[0][1] == ", ".join(f"{v:.3f} {axis}" for v, axis in told) and rows[0][2] == "mm"
    miss = accuracy.shift[:, 2] * one.evaluation.stiffness / one.problem.path.force
    assert rows[2][1:] == (f"{100 * np.sqrt(np.mean(miss**2)):.1f}", "%") and float(rows[2][1]) > 1.0
