"""The working accuracy D of the paper: where the contact truly is, seen from where the uncalibrated cell believes it to be.

T_BE T_EW T_WC = T_BG T_GC closes the loop at a working point (eq. 1), T_GC = T_BG^-1 T_BE T_EW T_WC is the contact in the wheel's
frame (eq. 2), D = T_GC^-1 T'_GC the working error (eq. 3), PHYSICS.md section 1. T_GC comes from the cell as its file has it,
unbent and uncalibrated, T'_GC from the model that the plan is made with; both at the plan's joints, which to first order is what
an uncalibrated command would miss.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import casadi as ca
import numpy as np
from scipy.interpolate import PchipInterpolator
from scipy.linalg import block_diag

from ocp.contact.wheel.law import WheelLaw
from ocp.model.cell import Cell, wheel_frame
from ocp.model.force_balance import build_model
from ocp.model.theta import Theta
from ocp.plan.motion import PlannedMotion
from ocp.plan.passes.optimise import SolvedPass
from ocp.plan.programming import Column, Timeline
from robots.kinematics import evaluate_rows, forward
from robots.pose import Array, invert, make_transform


@dataclass(frozen=True)
class WorkingAccuracy:
    """Of a pass of n waypoints, m, in the axes of the contact (along the feed, lateral, normal).

    shift (n, 3): the translation of D, real less believed; sd (n, 3): one sigma of what the plan's own model leaves open.
    """

    shift: Array
    sd: Array


def working_accuracy(nominal: Cell, cell: Cell, theta: Theta, law: WheelLaw, solved: list[SolvedPass]) -> list[WorkingAccuracy]:
    """D along every pass: `nominal` the cell as its file has it, `cell` and `theta` as the plan's model has them."""
    model = build_model(cell, law, cell.process.sigma, uncertain=len(theta.values) > Theta.size)
    place = ca.vertcat(model.arc, model.lateral, model.delta)
    unknown = ca.vertcat(model.theta, model.q)
    slope = ca.Function("slope", [model.q, model.F, model.w, model.theta], [ca.vec(ca.jacobian(place, unknown))])
    found = []
    for one in (whole.touching() for whole in solved):
        path, q = one.problem.path, one.solution.q
        frame = make_transform(np.stack([path.t, np.cross(path.n, path.t), path.n], axis=-1), path.p)
        believed = invert(wheel_frame(nominal)) @ forward(nominal.robot, q) @ nominal.workpiece.T_flange_blade @ frame
        real = invert(wheel_frame(cell)) @ one.evaluation.T_base_blade @ frame
        shift = (invert(believed) @ real)[:, :3, 3]
        found.append(WorkingAccuracy(shift, _deviation(cell, theta, slope, one)))
    return found


def _deviation(cell: Cell, theta: Theta, slope: ca.Function, one: SolvedPass) -> Array:
    """One sigma (n, 3) m of the contact's place along feed, lateral, normal, of theta and of what moves the joints beside it."""
    n = len(one.problem.path.s)
    waypoints = np.hstack([one.problem.waypoints, one.problem.conditions(cell)])
    values = evaluate_rows(slope, one.solution.q, one.solution.force[:, None], waypoints, np.tile(theta.values, (n, 1)))
    J = values.reshape(n, len(theta.values) + 6, 3).transpose(0, 2, 1)
    J[:, 0] *= (cell.wheel.radius - one.evaluation.delta)[:, None]  # of the arc: along the belt
    covariance = block_diag(theta.covariance, theta.joint_noise**2 * np.eye(6))
    along = -cell.wheel.travel * cell.process.sigma  # the feed in (belt, axis) at zero turn
    c, s = along * np.cos(one.evaluation.turn), along * np.sin(one.evaluation.turn)
    turned = np.stack([c[:, None] * J[:, 0] + s[:, None] * J[:, 1], s[:, None] * J[:, 0] - c[:, None] * J[:, 1], J[:, 2]], axis=1)
    return np.asarray(np.sqrt(np.einsum("nij,jk,nik->ni", turned, covariance, turned)))


def accuracy_columns(accuracy: Sequence[WorkingAccuracy], motion: PlannedMotion, line: Timeline) -> list[Column]:
    """What plan.csv says of D at every row of contact, mm."""
    place = np.array([segment.place for segment in motion.segments])[line.segment]
    shift = np.full((len(line.time), 3), np.nan)
    for k, (one, solved) in enumerate(zip(accuracy, motion.passes, strict=True)):
        rows = np.flatnonzero(line.contact & (place == k))
        s = solved.touching().problem.path.s
        shift[rows] = PchipInterpolator(s, one.shift)(np.clip(line.s[rows], s[0], s[-1]))
    return [(f"d_{name}_mm", 1e3 * shift[:, axis], 5) for name, axis in (("normal", 2), ("feed", 0), ("lateral", 1))]


def accuracy_rows(accuracy: Sequence[WorkingAccuracy], solved: Sequence[SolvedPass]) -> list[tuple[str, str, str]]:
    """Question, answer and unit: D before calibration, what is left after it, and the force that the first would cost (eq. 4)."""
    shift, sd = (
        1e3 * np.sqrt(np.mean(np.vstack([getattr(one, name) for one in accuracy]) ** 2, axis=0)) for name in ("shift", "sd")
    )
    miss = np.concatenate(
        [
            one.shift[:, 2] * each.evaluation.stiffness / each.problem.path.force
            for one, each in zip(accuracy, (whole.touching() for whole in solved), strict=True)
        ]
    )
    rows = [("Uncalibrated working error, rms", shift), ("One sigma of what is left of it", sd)]
    told = [(name, "{:.3f} normal, {:.3f} feed, {:.3f} lateral".format(*values[[2, 0, 1]]), "mm") for name, values in rows]
    return [*told, ("Force error that it would make, rms", f"{100 * np.sqrt(np.mean(miss**2)):.1f}", "%")]
