"""What one waypoint contributes to the optimal control problem, with exact dense derivatives built once.

A stage's variables are z = (q1..q6 rad, F N). Everything about a waypoint that is not a variable travels in one
parameter vector, so that one compiled function serves all waypoints of all passes.
"""

from dataclasses import dataclass
from functools import cached_property

import casadi as ca
import numpy as np

from ocp.model.cell import Cell
from ocp.model.force_balance import N_WAYPOINT, Model
from ocp.model.theta import Theta, covariance_root

N_Z = 7
# Linear clearance rows a.q >= b that collision checks may add at a waypoint.
N_CLEARANCE = 2
# Rows of a stage's constraints, in order, with the unit in which users read a violation and its factor from SI.
ROWS: tuple[tuple[str, str, float], ...] = (
    ("contact force balance", "mm", 1.0),  # this row is kept in mm for scaling
    ("wheel arc", "deg", 180 / np.pi),
    ("lateral offset on the wheel", "mm", 1e3),
    ("turn about the normal", "deg", 180 / np.pi),
    ("tilt along the feed", "deg", 180 / np.pi),
    ("tilt across the feed", "deg", 180 / np.pi),
    ("distance of the wrist from axis 1 (overhead singularity)", "mm", 1e3),
    ("relative curvature along the belt", "1/m", 1.0),
    ("overlap of the wheel at the planned point (it bears beside it on a hollow blade)", "mm", 1.0),
    *((("clearance", "mm", 1e3),) * N_CLEARANCE),
)
N_ROWS = len(ROWS)
N_PLAIN_ROWS = N_ROWS - N_CLEARANCE  # without the clearances


@dataclass(frozen=True)
class ObjectiveWeights:
    """Weights of the objective, each against its own tolerance or limit, so that 1 means equally undesirable."""

    turn: float = 0.3
    lateral: float = 0.3
    arc: float = 0.1
    tilt: float = 3.0
    wrist: float = 0.05  # times 1/sin^2 of axis 5: conditioning of the wrist
    speed: float = 1.0  # mean square of axis speed over its limit at the programmed feed
    acceleration: float = 1.0  # the same for acceleration
    force_sd: float = 0.0  # times the variance of the predicted force over (5 % of the process force)^2


@dataclass(frozen=True)
class Stage:
    """CasADi functions of one stage, each with exact dense derivatives; see `build_stage`.

    `spread` is the variance term of the objective; it varies slowly along a pass and is costly, so the transcription
    takes it at every few waypoints only.
    """

    model: Model
    objective: ca.SX
    rows: ca.SX
    parameters: ca.SX
    spread: ca.SX | None

    @cached_property
    def value(self) -> ca.Function:
        """(z, par, theta) -> objective, rows (N_ROWS)."""
        return self._function("stage", [self.objective, self.rows])

    @cached_property
    def gradient(self) -> ca.Function:
        """(z, par, theta) -> gradient of the objective (7)."""
        return self._function("stage_gradient", [ca.densify(ca.gradient(self.objective, self._z))])

    @cached_property
    def jacobian(self) -> ca.Function:
        """(z, par, theta) -> Jacobian of the rows (N_ROWS, 7)."""
        return self._function("stage_jacobian", [ca.densify(ca.jacobian(self.rows, self._z))])

    @cached_property
    def hessian(self) -> ca.Function:
        """(z, par, theta, lam_f, lam_rows) -> dense Hessian (7, 7) of lam_f objective + lam . rows."""
        lam_f, lam = ca.SX.sym("lam_f"), ca.SX.sym("lam", N_ROWS)
        H = ca.hessian(lam_f * self.objective + ca.dot(lam, self.rows), self._z)[0]
        return self._function("stage_hessian", [ca.densify(H)], [lam_f, lam])

    @cached_property
    def spread_terms(self) -> tuple[ca.Function, ca.Function, ca.Function]:
        """(z, par, theta) -> variance term, its gradient (7), its Hessian (7, 7)."""
        assert self.spread is not None
        H, g = ca.hessian(self.spread, self._z)
        return (
            self._function("spread", [self.spread]),
            self._function("spread_gradient", [ca.densify(g)]),
            self._function("spread_hessian", [ca.densify(H)]),
        )

    @property
    def n_parameters(self) -> int:
        """Numbers of `parameters`: N_PARAMETERS, and the conditions of a cell with effects."""
        return int(self.parameters.numel())

    @property
    def n_theta(self) -> int:
        """Numbers of the model's theta."""
        return int(self.model.theta.numel())

    @property
    def _z(self) -> ca.SX:
        return ca.vertcat(self.model.q, self.model.F)

    def _function(self, name: str, outputs: list[ca.SX], more: list[ca.SX] | None = None) -> ca.Function:
        return ca.Function(name, [self._z, self.parameters, self.model.theta, *(more or [])], outputs, {"cse": True})


N_PARAMETERS = N_WAYPOINT + 7 * N_CLEARANCE + 2  # waypoint, clearances (a, b), sign of the shoulder, stage weight


def build_stage(cell: Cell, model: Model, weights: ObjectiveWeights, theta: Theta) -> Stage:
    """Objective and constraint rows of one waypoint.

    The values of `theta` are folded in before differentiating: planning holds them, and a third of the instructions go.
    """
    clearance = ca.SX.sym("clearance", 7 * N_CLEARANCE)
    shoulder_sign, stage_weight = ca.SX.sym("shoulder_sign"), ca.SX.sym("stage_weight")
    parameters = ca.vertcat(model.w, clearance, shoulder_sign, stage_weight)
    process, wheel = cell.process, cell.wheel
    slots = [ca.dot(clearance[7 * i : 7 * i + 6], model.q) - clearance[7 * i + 6] for i in range(N_CLEARANCE)]
    posture = [model.arc, model.lateral, model.turn, model.tilt, shoulder_sign * model.shoulder, model.curvature[0]]
    rows = ca.vertcat(1e3 * model.residual, *posture, 1e3 * model.parts[1], *slots)
    arc_mid, arc_half = 0.5 * (wheel.arc[0] + wheel.arc[1]), 0.5 * (wheel.arc[1] - wheel.arc[0])
    objective = (
        weights.turn * (model.turn / max(process.turn_tolerance, 1e-3)) ** 2
        + weights.lateral * (model.lateral / max(process.lateral_tolerance, 1e-4)) ** 2
        + weights.arc * ((model.arc - arc_mid) / arc_half) ** 2
        + weights.tilt * ca.sumsqr(model.tilt) / max(process.tilt_tolerance, 1e-3) ** 2
        + weights.wrist / ca.sin(model.q[4]) ** 2
    )
    spread = None
    if weights.force_sd > 0:
        variance = force_variance(model, theta)
        spread = stage_weight * weights.force_sd * variance / (0.05 * process.force) ** 2
        spread = ca.substitute(spread, model.theta, ca.DM(theta.values))
    folded, rows = ca.substitute([stage_weight * objective, rows], [model.theta], [ca.SX(ca.DM(theta.values))])
    return Stage(model, folded, rows, parameters, spread)


def force_variance(model: Model, theta: Theta) -> ca.SX:
    """Variance N^2 of the predicted force to first order: dF/dx = -(dr/dx) / (dr/dF) in the parameters and in the joints."""
    sensitivity = ca.jacobian(model.residual, model.theta) @ ca.DM(covariance_root(theta.covariance))
    joints = theta.joint_noise**2 * ca.sumsqr(ca.jacobian(model.residual, model.q))
    return (ca.sumsqr(sensitivity) + joints) / ca.jacobian(model.residual, model.F) ** 2
