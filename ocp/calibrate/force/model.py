"""Contact force of logged rows from the one symbolic model, and its derivative in every parameter.

The force is implicit: residual(q, F, w, theta) = 0 (docs/model.md, eq. 2), so dF/dtheta = -(dr/dtheta) / (dr/dF).
docs/force_registration.md, eq. 1 to 3.
"""

from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from functools import cached_property
from typing import Any

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from ocp.contact.wheel.law import WheelLaw
from ocp.effects.engine.compiled import run_rows
from ocp.model.cell import Cell
from ocp.model.force_balance import build_model
from ocp.model.theta import NAMES, Theta
from robots.pose import Array

SETPOINT = NAMES.index("flange_setpoint_offset")
NEWTON_STEPS = 30
FORCE_TOLERANCE = 1e-5  # N; a Newton step of this size leaves some 1e-10 N
# Share of the wheel law's lowest force below which the balance is continued along its tangent: the law's polynomial in
# log F is not meant to be followed to zero.
LEAST_FORCE = 0.5


@dataclass(frozen=True)
class ForceRows:
    """What the model needs of n logged rows: commanded joints q (n, 6) rad, waypoint (n, 16) as `force_balance.WAYPOINT` (of a
    cell with effects their conditions follow), setpoint (n,) N of the flange, belt (n,) -1, 0 or 1: sign of the belt's speed,
    contact (n,) False in the air."""

    q: Array
    waypoint: Array
    setpoint: Array
    belt: Array
    contact: NDArray[np.bool_]

    def __len__(self) -> int:
        return len(self.q)

    @staticmethod
    def joined(parts: Sequence["ForceRows"]) -> "ForceRows":
        """Rows one after the other."""
        return ForceRows(*(np.concatenate([vars(part)[f.name] for part in parts]) for f in fields(ForceRows)))

    def take(self, rows: Any) -> "ForceRows":
        """The rows of an index, slice or mask."""
        return ForceRows(*(value[rows] for value in vars(self).values()))


@dataclass(frozen=True)
class BeltFunctions(ABC):
    """Functions of the balance of one cell and wheel law for many rows, built once for each sign of the belt."""

    cell: Cell
    law: WheelLaw

    @cached_property
    def least_force(self) -> float:
        """N; below it the balance is linear in F (docs/force_registration.md, eq. 3)."""
        return LEAST_FORCE * self.law.limits["force"][0]

    @cached_property
    def _functions(self) -> dict[int, dict[str, ca.Function]]:
        return {}

    @abstractmethod
    def built(self, belt: int) -> dict[str, ca.Function]:
        """The functions (q, F, w, theta) -> numbers of a row by their kinds, for a belt of the given sign."""

    def of_rows(self, kind: str, rows: ForceRows, theta: Array, F: Array) -> Array:
        """Numbers (n, k) of a kind at each row's own theta (n, m) and F (n,); no rows give (0, 0)."""
        out: Array = np.empty((0, 0))
        for belt in (-1, 0, 1):
            at = np.flatnonzero(rows.belt == belt)
            if not len(at):
                continue
            if belt not in self._functions:
                self._functions[belt] = self.built(belt)
            values = run_rows(self._functions[belt][kind], rows.q[at], F[at, None], rows.waypoint[at], theta[at])
            if not out.size:
                out = np.zeros((len(rows), values.shape[1]))
            out[at] = values
        return out


@dataclass(frozen=True)
class ForceModel(BeltFunctions):
    """Force between wheel and blade of one cell and wheel law."""

    def built(self, belt: int) -> dict[str, ca.Function]:
        """See `evaluate`."""
        model = build_model(replace(self.cell, wheel=replace(self.cell.wheel, belt_speed=float(belt))), self.law)
        slope = ca.jacobian(model.residual, model.F)
        state = ca.vertcat(model.delta, model.parts, model.arc, model.lateral, model.turn, model.tilt, model.curvature)
        outputs = {
            "balance": ca.vertcat(model.residual, slope),
            "derivative": ca.vertcat(slope, ca.jacobian(model.residual, model.theta).T),
            "state": ca.vertcat(state, ca.vec(model.T_base_blade.T)),
        }
        arguments = [model.q, model.F, model.w, model.theta]
        return {name: ca.Function(name, arguments, [ca.densify(o)], {"cse": True}) for name, o in outputs.items()}

    def evaluate(self, kind: str, rows: ForceRows, theta: Array, F: Array) -> Array:
        """Rows (n, k) of "balance" (residual m, its slope in F m/N), "derivative" (slope, dr/dtheta) or "state" (overlap
        m, parts (4) m, arc, lateral, turn, tilt (2), relative curvature (3), T_base_blade (16)) at theta (m,) and F (n,)."""
        whole = np.tile(theta, (len(rows), 1))
        if self.cell.flange is not None:
            # A row's own setpoint is the cell's plus a known offset: the model stays as it is.
            whole[:, SETPOINT] += rows.setpoint - self.cell.flange.setpoint
        return self.of_rows(kind, rows, whole, F)

    def force(self, rows: ForceRows, theta: Array, guess: Array | None = None, pressed: NDArray[np.bool_] | None = None) -> Array:
        """Contact force (n,) N, zero in the air and where the wheel does not reach the blade; Newton from `guess` (n,).

        Rows known to be `pressed` (n,) get a negative force instead, the tangent's over the gap: a fit that starts too far
        off then still sees which way the wheel is.
        """
        F = np.zeros(len(rows))
        active = np.flatnonzero(rows.contact)
        if not len(active):
            return F
        start = np.maximum(rows.setpoint if self.cell.flange is not None else self.law.process_force, self.least_force)
        F[active] = (np.broadcast_to(start, len(rows)) if guess is None else guess)[active]
        for _ in range(NEWTON_STEPS):
            part = rows.take(active)
            residual, slope = self.evaluate("balance", part, theta, np.maximum(F[active], self.least_force)).T
            residual = residual + slope * np.minimum(F[active] - self.least_force, 0.0)
            step = -residual / slope
            # From far off a step may overshoot into forces where the law is steep: at most a factor of three up.
            F[active] = np.minimum(F[active] + step, 3.0 * np.maximum(F[active], self.least_force))
            active = active[np.abs(step) > FORCE_TOLERANCE]
            if not len(active):
                break
        return np.maximum(F, 0.0) if pressed is None else np.where(pressed, F, np.maximum(F, 0.0))

    def sensitivity(self, rows: ForceRows, theta: Array, F: Array) -> Array:
        """dF/dtheta (n, m) at the forces F (n,) that `force` gave; zero where the force is zero."""
        out = np.zeros((len(rows), Theta.size))
        at = np.flatnonzero(rows.contact & (F != 0))
        if len(at):
            values = self.evaluate("derivative", rows.take(at), theta, np.maximum(F[at], self.least_force))
            out[at] = -values[:, 1:] / values[:, :1]
        return out
