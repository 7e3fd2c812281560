"""What one waypoint contributes to the optimal control problem, with exact dense derivatives built once.

A stage's variables are z = (q1..q6 rad, w, r): joints, rate of the path parameter over its nominal one, and force over feed, each
over its programmed value. The force is F = force x share x w x r, so that nothing is divided by a feed that is zero at touch.
Everything about a waypoint that is not a variable travels in one parameter vector, so that one compiled function serves all
waypoints of all passes.
"""

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import casadi as ca
import numpy as np
from scipy.linalg import block_diag

from ocp.model.cell import Cell
from ocp.model.force_balance import N_WAYPOINT, Model
from ocp.model.theta import Theta, covariance_root
from ocp.shell.native import ColumnFunction
from robots.pose import Array

N_Z = 8
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
    ("contact force", "N", 1.0),
    *((("clearance", "mm", 1e3),) * N_CLEARANCE),
)
N_ROWS = len(ROWS)
N_PLAIN_ROWS = N_ROWS - N_CLEARANCE  # without the clearances


@dataclass(frozen=True)
class ObjectiveWeights:
    """Weights of the objective, each of a mean over the way's time; 1 means equally undesirable.

    The freedoms are held by their boxes; what pulls them to the middle only makes the optimum unique.
    """

    removal: float = 100.0  # square of (depth over what is wanted - 1), along the line and across the patch
    force: float = 1000.0  # square of (force over the programmed one - 1) in the pass
    time: float = 1.0  # nominal time over time
    middle: float = 1e-1  # squares of arc, lateral, turn and tilt over half their ranges
    speed: float = 1.0  # square of axis speed over its limit
    acceleration: float = 1.0  # the same for acceleration
    even_rate: float = 1.0  # square of the change of w within CHANGE_TIME
    even_ratio: float = 3.0  # the same for r
    force_sd: float = 0.0  # times the variance of the predicted force over (5 % of the process force)^2


@dataclass(frozen=True)
class Scatter:
    """The variance term |R of|^2 of one waypoint: of (m) the force's sensitivities, weighed; along = u . of; root R (r, m)."""

    of: ca.SX
    along: ca.SX
    u: ca.SX
    root: Array


@dataclass(frozen=True)
class Stage:
    """CasADi functions of one stage, each with exact dense derivatives; see `build_stage`.

    The variance term `scatter` varies slowly along a pass and is costly: the transcription takes it at every few waypoints only.
    """

    model: Model
    objective: ca.SX
    rows: ca.SX
    parameters: ca.SX
    scatter: Scatter | None
    z: ca.SX

    @cached_property
    def value(self) -> ColumnFunction:
        """(z, par, theta) -> objective, rows (N_ROWS)."""
        return self._function("stage", [self.objective, self.rows])

    @cached_property
    def gradient(self) -> ColumnFunction:
        """(z, par, theta) -> gradient of the objective (8)."""
        return self._function("stage_gradient", [ca.densify(ca.gradient(self.objective, self.z))])

    @cached_property
    def jacobian(self) -> ColumnFunction:
        """(z, par, theta) -> Jacobian of the rows (N_ROWS, 8)."""
        return self._function("stage_jacobian", [ca.densify(ca.jacobian(self.rows, self.z))])

    @cached_property
    def hessian(self) -> ColumnFunction:
        """(z, par, theta, lam_f, lam_rows) -> dense Hessian (8, 8) of lam_f objective + lam . rows."""
        lam_f, lam = ca.SX.sym("lam_f"), ca.SX.sym("lam", N_ROWS)
        H = ca.hessian(lam_f * self.objective + ca.dot(lam, self.rows), self.z)[0]
        return self._function("stage_hessian", [ca.densify(H)], [lam_f, lam])

    @cached_property
    def scatter_terms(self) -> tuple[ColumnFunction, ColumnFunction, ColumnFunction]:
        """(z, par, theta) -> scatter (m), its Jacobian (m, 8); with u (m): the Hessian (8, 8) of u . scatter."""
        assert self.scatter is not None
        one = self.scatter
        return (
            self._function("scatter", [one.of]),
            self._function("scatter_jacobian", [ca.densify(ca.jacobian(one.of, self.z))]),
            self._function("scatter_hessian", [ca.densify(ca.hessian(one.along, self.z)[0])], [one.u]),
        )

    @property
    def functions(self) -> list[ColumnFunction]:
        """All that the nonlinear program evaluates of a stage."""
        scatter = [] if self.scatter is None else self.scatter_terms
        return [self.hessian, self.jacobian, self.value, self.gradient, *scatter]

    @property
    def derived(self) -> dict[str, Any]:
        """`functions` by the names that they have here, for a stage built alike in another process: deriving them takes long."""
        names = ("hessian", "jacobian", "value", "gradient", *(() if self.scatter is None else ("scatter_terms",)))
        return {name: getattr(self, name) for name in names}

    @property
    def n_parameters(self) -> int:
        """Numbers of `parameters`: N_PARAMETERS, and the conditions of a cell with effects."""
        return int(self.parameters.numel())

    @property
    def n_theta(self) -> int:
        """Numbers of the model's theta."""
        return int(self.model.theta.numel())

    def _function(self, name: str, outputs: list[ca.SX], more: list[ca.SX] | None = None) -> ColumnFunction:
        given = [self.z, self.parameters, self.model.theta, *(more or [])]
        return ColumnFunction(ca.Function(name, given, outputs, {"cse": True}))


# What a stage knows beside its waypoint and its clearances.
STAGE = ("force", "gap", "holds", "lean_along", "lean_across", "shoulder_sign", "weight")
N_PARAMETERS = N_WAYPOINT + 7 * N_CLEARANCE + len(STAGE)


def build_stage(cell: Cell, model: Model, weights: ObjectiveWeights, theta: Theta, folded: bool = True) -> Stage:
    """Objective and constraint rows of one waypoint.

    Its own parameters (STAGE): `force` N at nominal rate, zero in the air; `gap` m there; `holds` 1 where the force is that of
    the pass; `lean_along`, `lean_across`: by what share of its mean a tilt of 1 along and across the feed makes the pressure
    uneven, root of the mean square over the patch; sign of the shoulder; `weight`, its share of the way's time. `folded`: the
    values of `theta` are folded in before differentiating: planning holds them, and a third of the instructions go.
    """
    clearance, own = ca.SX.sym("clearance", 7 * N_CLEARANCE), ca.SX.sym("own", len(STAGE))
    parameters = ca.vertcat(model.w, clearance, own)
    force, gap, holds, along, across, shoulder_sign, stage_weight = ca.vertsplit(own)
    rate, ratio = ca.SX.sym("rate"), ca.SX.sym("ratio")
    F = force * rate * ratio
    process, wheel = cell.process, cell.wheel
    slots = [ca.dot(clearance[7 * i : 7 * i + 6], model.q) - clearance[7 * i + 6] for i in range(N_CLEARANCE)]
    posture = [model.arc, model.lateral, model.turn, model.tilt, shoulder_sign * model.shoulder, model.curvature[0]]
    rows = ca.vertcat(1e3 * (model.residual + gap), *posture, 1e3 * model.parts[1], F, *slots)
    arc_mid, arc_half = 0.5 * (wheel.arc[0] + wheel.arc[1]), 0.5 * (wheel.arc[1] - wheel.arc[0])
    middle = (
        (model.turn / max(process.turn_tolerance, 1e-3)) ** 2
        + (model.lateral / max(process.lateral_tolerance, 1e-4)) ** 2
        + ((model.arc - arc_mid) / arc_half) ** 2
        + ca.sumsqr(model.tilt) / max(process.tilt_tolerance, 1e-3) ** 2
    )
    objective = weights.middle * middle + weights.force * holds * (rate * ratio - 1) ** 2 + weights.time / rate
    objective += weights.removal * ((along * model.tilt[0]) ** 2 + (across * model.tilt[1]) ** 2)
    known = [ca.SX(ca.DM(theta.values)) if folded else model.theta, F]
    objective, rows = ca.substitute([stage_weight * objective, rows], [model.theta, model.F], known)
    scatter = None
    if weights.force_sd > 0:
        share = ca.sqrt(weights.force_sd * stage_weight) / (0.05 * process.force)
        u = ca.SX.sym("u", force_sensitivity(model).numel())
        of, along = ca.substitute([share * force_sensitivity(model), share * _along(model, u)], [model.theta, model.F], known)
        scatter = Scatter(of, along, u, scatter_root(theta))
    return Stage(model, objective, rows, parameters, scatter, ca.vertcat(model.q, rate, ratio))


def force_sensitivity(model: Model) -> ca.SX:
    """dF/dx = -(dr/dx) / (dr/dF) of the predicted force in the parameters, then in the joints (m + 6): to first order its
    variance N^2 is |R dF/dx|^2, R of `scatter_root`."""
    change = ca.horzcat(ca.jacobian(model.residual, model.theta), ca.jacobian(model.residual, model.q))
    return ca.densify(-change.T / ca.jacobian(model.residual, model.F))


def _along(model: Model, u: ca.SX) -> ca.SX:
    """u . dF/dx, in one forward sweep."""
    x = ca.vertcat(model.theta, model.q)
    return -ca.jtimes(model.residual, x, u) / ca.jacobian(model.residual, model.F)


def scatter_root(theta: Theta) -> Array:
    """R (r, m + 6): R^T R is the covariance of the parameters, then of the joints' own scatter. It is kept out of the compiled
    functions: every calibration has another."""
    return block_diag(covariance_root(theta.covariance).T, theta.joint_noise * np.eye(6))
