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


def solved_on(cell, theta):
    """Joints Q on the bar, as a solved pass of that cell; nothing is optimised."""
    path = bar_pass()
    problem = PassProblem.start(path, Seed(1, 0, np.zeros(4), 0.0, Q[:4], np.linspace(0, 1, 4), 0.0), np.zeros((40, 3)))
    seen = PassSolver(cell, LineLaw(), theta, ObjectiveWeights()).evaluate(problem, Q, path.force)
    ones = np.ones(40)
    return SolvedPass(problem, PassSolution(Q, ones, ones, path.force, 0, 0.0), seen)


def unbent():
    """The bundled cell, its arm without weight."""
    return replace(bundled_cell(), compliant_joints=())


def calibrated(cell, **values):
    return replace(
        cell, calibration=Calibration(cell.robot.name, tuple(values), np.array([*values.values()]), np.eye(len(values)), {})
    )


def found(believed, theta=None):
    cell, known = registered(believed)
    known = known if theta is None else theta
    one = solved_on(cell, known)
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
    noisy, _ = found(unbent(), Theta(theta.values, covariance, 1e-4))
    assert (noisy.sd > accuracy.sd).all()


def test_columns_and_figures_of_a_plan():
    accuracy, one = found(calibrated(unbent(), wheel_x=3e-4))
    motion = SimpleNamespace(passes=[one], segments=[SimpleNamespace(place=0), SimpleNamespace(place=0)])
    s = np.array([np.nan, 0.0, 0.03, 0.06, 0.061])
    line = SimpleNamespace(time=np.arange(5.0), segment=np.array([0, 1, 1, 1, 1]), contact=np.array([0, 1, 1, 1, 1], bool), s=s)
    columns = {name: values for name, values, _ in accuracy_columns([accuracy], motion, line)}  # type: ignore[arg-type]
    assert list(columns) == ["d_normal_mm", "d_feed_mm", "d_lateral_mm"]
    assert np.isnan(columns["d_normal_mm"][0])
    for name, axis in (("normal", 2), ("feed", 0), ("lateral", 1)):  # D's axes are x along the feed, y lateral, z normal
        assert columns[f"d_{name}_mm"][[1, 3]] == pytest.approx(1e3 * accuracy.shift[[0, -1], axis])
    assert len({round(float(columns[name][1]), 4) for name in columns}) == 3
    rows = accuracy_rows([accuracy], [one])  # type: ignore[list-item]
    rms = 1e3 * np.sqrt(np.mean(accuracy.shift**2, axis=0))
    told = zip(rms[[2, 0, 1]], ("normal", "feed", "lateral"), strict=True)
    assert rows[0][1] == ", ".join(f"{v:.3f} {axis}" for v, axis in told) and rows[0][2] == "mm"
    assert float(rows[2][1]) > 1.0
