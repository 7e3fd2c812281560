"""A calibration folded into the cell predicts the same force as one carried in theta."""

from dataclasses import replace

import numpy as np
import pytest

from ocp.model.theta import believed_theta, registered
from ocp.plan.passes.posture import Seed
from ocp.plan.passes.problem import PassProblem
from ocp.plan.passes.solve import PassSolver
from ocp.plan.passes.stage import N_ROWS, ObjectiveWeights
from robots.calibration.store import Calibration
from tests.support.example_pass import LineLaw, bar_pass, bundled_cell


def test_folded_corrections_leave_the_prediction_unchanged():
    names = (
        "th2",
        "c3",
        "wheel_x",
        "wheel_z",
        "wheel_axis_u",
        "wheel_axis_v",
        "blade_y",
        "blade_a",
        "blade_c",
        "flange_stiffness",
        "wheel_radius",
    )
    values = np.array([4e-4, 5e-7, 3e-4, -2e-4, 4e-4, -6e-4, 2e-4, 5e-4, -3e-4, 5000.0, -2e-4])
    calibration = Calibration("kr210_r2700_extra", names, values, np.diag((0.1 * values) ** 2), {})
    cell = replace(bundled_cell(), calibration=calibration)
    q = np.radians([0.5, -82.0, 101.0, -2.0, 80.0, -84.0]) + np.zeros((40, 6))
    path = bar_pass()
    problem = PassProblem.start(path, Seed(1, 0, np.zeros(4), 0.0, q[:4], np.linspace(0, 1, 4), 0.0), np.zeros((40, 3)))
    carried = PassSolver(cell, LineLaw(), believed_theta(cell), ObjectiveWeights()).evaluate(problem, q, path.force)
    folded_cell, theta = registered(cell)
    folded = PassSolver(folded_cell, LineLaw(), theta, ObjectiveWeights()).evaluate(problem, q, path.force)
    assert folded.delta == pytest.approx(carried.delta, abs=1e-8)
    assert folded.residual == pytest.approx(carried.residual, abs=1e-8)
    assert folded.turn == pytest.approx(carried.turn, abs=1e-6)
    assert folded.force_sd == pytest.approx(carried.force_sd, rel=1e-3)
    plain = PassSolver(bundled_cell(), LineLaw(), believed_theta(bundled_cell()), ObjectiveWeights()).evaluate(
        problem, q, path.force
    )
    assert np.abs(plain.delta - carried.delta).max() > 1e-4


def numbers(function, *arguments):
    """All results of a stage's function, one after another."""
    found = function(*arguments)
    return np.concatenate([np.asarray(one).ravel() for one in (found if isinstance(found, tuple | list) else [found])])


def test_one_solver_serves_every_calibration_of_its_cell():
    names = ("th2", "c3", "c5", "wheel_x", "blade_y", "blade_a", "cover_stiffness_scale", "flange_stiffness")
    values = np.array([4e-4, 5e-7, 6e-7, 3e-4, 2e-4, 5e-4, 0.1, 5000.0])
    calibration = Calibration("kr210_r2700_extra", names, values, np.diag((0.1 * values) ** 2), {})
    believed = replace(bundled_cell(), calibration=None)
    cell = replace(believed, calibration=calibration, compliant_joints=(2, 3, 5))
    q = np.radians([0.5, -82.0, 101.0, -2.0, 80.0, -84.0]) + np.zeros((40, 6))
    path = bar_pass()
    problem = PassProblem.start(path, Seed(1, 0, np.zeros(4), 0.0, q[:4], np.linspace(0, 1, 4), 0.0), np.zeros((40, 3)))
    theta = believed_theta(cell)
    own = PassSolver(cell, LineLaw(), theta, ObjectiveWeights())
    first = PassSolver(believed, LineLaw(), believed_theta(believed), ObjectiveWeights(), folded=False)
    other = first.other(cell, LineLaw(), theta)
    z = np.append(q[3], [0.9, 1.1])
    lam = np.linspace(-1.0, 1.0, N_ROWS)
    for name, more in (("value", ()), ("gradient", ()), ("jacobian", ()), ("hessian", (0.7, lam))):
        told = [numbers(getattr(s.stage, name), z, s._parameters(problem, 40)[3], theta.values, *more) for s in (own, other)]
        assert told[1] == pytest.approx(told[0], rel=1e-9, abs=1e-9 * np.abs(told[0]).max()), name
    seen, same = (solver.evaluate(problem, q, path.force) for solver in (own, other))
    assert same.residual == pytest.approx(seen.residual, abs=1e-12)
    assert same.force_sd == pytest.approx(seen.force_sd, rel=1e-9)
    before = first.evaluate(problem, q, path.force)  # of the first calibration still
    assert np.abs(before.residual - seen.residual).max() > 1e-4
    softer = first.other(replace(cell, compliant_joints=(2, 3)), LineLaw(), theta).evaluate(problem, q, path.force)
    assert np.abs(softer.residual - seen.residual).max() > 1e-6
