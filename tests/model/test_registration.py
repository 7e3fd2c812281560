"""A calibration folded into the cell predicts the same force as one carried in theta."""

from dataclasses import replace

import numpy as np
import pytest

from ocp.model.theta import believed_theta, registered
from ocp.plan.passes.posture import Seed
from ocp.plan.passes.problem import PassProblem
from ocp.plan.passes.solve import PassSolver
from ocp.plan.passes.stage import ObjectiveWeights
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
