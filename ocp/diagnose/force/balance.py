"""Equilibrium of logged rows with parameters, joints and interference of their own, and all that its derivatives tell.

The model is `ocp/model/force_balance.py`; here every row may have its own parameters (a blade that moved), its own shift of the
joints (an error of a gear) and an extra overlap. docs/diagnosis_force.md, eq. 1 to 3.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import casadi as ca
import numpy as np

from ocp.calibrate.force.log import Flags, Index
from ocp.calibrate.force.model import BeltFunctions, ForceRows
from ocp.model.cell import Cell
from ocp.model.force_balance import build_model
from ocp.model.theta import NAMES
from robots.pose import Array

SETPOINT = NAMES.index("flange_setpoint_offset")
STEPS = 15  # Newton steps in F; six do, and where effects turn the balance over no number does
TOLERANCE = 2e-4  # N: a step of Newton below this leaves less than 1e-7 N
# Columns of what `Balance.state` gives.
STATE = {
    "residual": slice(0, 1), "parts": slice(1, 5), "slopes": slice(5, 9), "arc": slice(9, 10), "lateral": slice(10, 11),
    "turn": slice(11, 12), "tilt": slice(12, 14), "curvature": slice(14, 17), "T": slice(17, 33),
    "friction_deflection": slice(33, 34),
}  # fmt: skip

# Extra interference (k,) m of some rows (their indices), at their forces (k,) N and the state's columns there.
Extra = Callable[[Index, Array, Array], Array]
PROBE = 0.05  # N; over which the change of the extra interference with the force is first taken


@dataclass(frozen=True)
class Rows:
    """What the balance needs of n rows: those of the force model (q with the shift of its joints in), and parameters theta
    (n, m) of each row, its own setpoint in them."""

    base: ForceRows
    theta: Array

    @staticmethod
    def of(cell: Cell, base: ForceRows, theta: Array, shift: Array | None = None) -> "Rows":
        """Rows at parameters theta (m,) or (n, m) with joints moved by `shift` (n, 6) rad."""
        whole = np.array(np.broadcast_to(theta, (len(base), theta.shape[-1])))
        if cell.flange is not None:
            whole[:, SETPOINT] += base.setpoint - cell.flange.setpoint
        return Rows(base if shift is None else replace(base, q=base.q + shift), whole)

    def take(self, rows: Any) -> "Rows":
        """The rows of an index or mask."""
        return Rows(self.base.take(rows), self.theta[rows])


@dataclass(frozen=True)
class Balance(BeltFunctions):
    """Force between wheel and blade of one cell and wheel law."""

    def built(self, belt: int) -> dict[str, ca.Function]:
        """See `evaluate`."""
        friction: Any = ca.SX.sym("mu")  # a symbol in the place of a number: the parts' derivative in it is wanted
        wheel = replace(self.cell.wheel, belt_speed=float(belt), friction=friction)
        model = build_model(replace(self.cell, wheel=wheel), self.law)
        slopes, more = ca.jacobian(model.parts, model.F), ca.jacobian(ca.sum1(model.parts), friction)
        state = [model.residual, model.parts, slopes, model.arc, model.lateral, model.turn, model.tilt, model.curvature]
        by = ca.horzcat(ca.jacobian(model.residual, model.theta), ca.jacobian(model.residual, model.q))
        outputs = {"state": ca.vertcat(*state, ca.vec(model.T_base_blade.T), more), "derivative": by.T}
        arguments = [model.q, model.F, model.w, model.theta]
        known = {name: ca.substitute(ca.densify(o), friction, self.cell.wheel.friction) for name, o in outputs.items()}
        return {name: ca.Function(name, arguments, [o], {"cse": True}) for name, o in known.items()}

    def evaluate(self, kind: str, rows: Rows, F: Array) -> Array:
        """(n, k) of "state" (see STATE; slopes: of the parts in F, m/N) or "derivative" (of the residual in theta (m) and q
        (6)) at forces F (n,)."""
        return self.of_rows(kind, rows.base, rows.theta, F)

    def solve(
        self, rows: Rows, guess: Array, pressed: Flags, extra: Extra | None = None, stiffness: Array | None = None
    ) -> tuple[Array, Array, Array]:
        """Force (n,) N of rows in contact; state (n, 34) there; stiffness (n,) N/m: dF per m of overlap.

        Not below zero, but for rows known to be `pressed` (n,): theirs is the tangent's over the gap, so that a fit that starts
        too far off sees which way the wheel is. `extra` is the interference that effects add; what it changes with the force
        enters by secants. Newton from `guess`, with the `stiffness` (n,) of a solution nearby.
        """
        F = np.array(guess, float)
        state = np.zeros((len(F), STATE["friction_deflection"].stop))
        ready, gain = self._gain(rows, F, extra, stiffness)
        total = np.zeros(len(F))
        old_F, old_extra = F.copy(), np.full(len(F), np.nan)
        active = np.arange(len(F), dtype=np.int64)
        for _ in range(STEPS):
            part = rows.take(active)
            at = np.maximum(F[active], self.least_force)
            now = self.evaluate("state", part, at) if ready is None else ready
            ready = None
            state[active] = now
            add = np.zeros(len(active)) if extra is None else extra(active, at, now)
            moved = at - old_F[active]
            known = np.isfinite(old_extra[active]) & (np.abs(moved) > 1e-3)
            given = now[:, STATE["slopes"]].sum(axis=1)
            gain[active] = _reasonable(np.divide(add - old_extra[active], moved, out=gain[active], where=known), given)
            total[active] = given - gain[active]
            step = (now[:, 0] + add - total[active] * (F[active] - at)) / total[active]
            old_F[active], old_extra[active] = at, add
            F[active] = np.minimum(F[active] + step, 3.0 * at)
            active = active[np.abs(step) > TOLERANCE]
            if not len(active):
                break
        touching = pressed | (F > 0)
        return np.where(touching, F, 0.0), state, np.where(touching, 1.0 / np.maximum(total, 1e-12), 0.0)

    def _gain(self, rows: Rows, F: Array, extra: Extra | None, stiffness: Array | None) -> tuple[Array | None, Array]:
        """The state at F where it was needed, and the derivative (n,) m/N of the extra interference in F."""
        if extra is None:
            return None, np.zeros(len(F))
        if stiffness is not None and (stiffness > 0).all():
            now = self.evaluate("state", rows, np.maximum(F, self.least_force))
            return now, np.asarray(now[:, STATE["slopes"]].sum(axis=1) - 1.0 / stiffness)
        here, index = np.maximum(F, self.least_force), np.arange(len(F), dtype=np.int64)
        there = here + PROBE
        before, after = (self.evaluate("state", rows, at) for at in (here, there))
        change: Array = extra(index, there, after) - extra(index, here, before)
        return before, _reasonable(change / PROBE, before[:, STATE["slopes"]].sum(axis=1))


def _reasonable(gain: Array, given: Array) -> Array:
    """Effects that change the stiffness beyond reason would turn the balance over."""
    return np.asarray(np.clip(gain, -3.0 * given, 0.7 * given))
