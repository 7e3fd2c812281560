"""Contact force of logged rows from the one symbolic model, solved row by row, and its derivative in every parameter.

The force is implicit: residual(q, F, w, theta) = 0 (docs/model.md, eq. 2), so dF/dtheta = -(dr/dtheta) / (dr/dF).
Calibration solves all rows at the same parameters (docs/force_registration.md, eq. 1 to 3); the diagnosis gives every row its
own (a blade that moved, an error of a gear) and an extra interference by effects (docs/diagnosis_force.md, eq. 1 to 3).
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, fields, replace
from functools import cached_property
from typing import Any

import casadi as ca
import numpy as np

from ocp.calibrate.force.log import Flags, Index
from ocp.contact.wheel.law import WheelLaw
from ocp.effects.engine.compiled import RowLayout
from ocp.model.cell import Cell
from ocp.model.force_balance import N_WAYPOINT, build_model
from ocp.model.theta import NAMES, Theta
from ocp.shell.native import ColumnFunction, compile_together
from robots.kinematics import evaluate_rows
from robots.pose import Array, Stacked

CORRECTION = N_WAYPOINT - 1  # of a waypoint, the column of the indentation's correction
SETPOINT = NAMES.index("flange_setpoint_offset")
# Parameters that what gives way under the force goes with most, and effects with that.
_GIVING = "cover_stiffness_scale", "blade_stiffness_scale", "flange_stiffness", "flange_setpoint_offset"
GIVING = [NAMES.index(name) for name in _GIVING]
STEPS = 15  # Newton steps in F; six do, and where effects turn the balance over no number does
WORTH_COMPILING = 3000  # rows of a log: its fit by machine code saves what compiling takes
FORCE_TOLERANCE = 1e-5  # N; a Newton step of this size leaves some 1e-10 N
# Share of the wheel law's lowest force below which the balance is continued along its tangent: the law's polynomial in
# log F is not meant to be followed to zero.
LEAST_FORCE = 0.5
PROBE = 0.05  # N; over which the change of the extra interference with the force is first taken
# Columns of what `ForceModel.evaluate` gives as "state".
STATE = RowLayout.of(
    "residual 1, slope 1, overlap 1, parts 4, slopes 4, arc 1, lateral 1, turn 1, tilt 2, curvature 3, T 16, "
    "joint_lever 6, joint_push 6, tau 6, friction_deflection 1"
).places

# Extra interference (k,) m of some rows (their indices), at their forces (k,) N and the state's columns there.
Extra = Callable[[Index, Array, Array], Array]


@dataclass(frozen=True)
class ForceRows(Stacked):
    """What the model needs of n logged rows: commanded joints q (n, 6) rad, waypoint (n, 16) as `force_balance.WAYPOINT` (of a
    cell with effects their conditions follow), setpoint (n,) N of the flange, belt (n,) -1, 0 or 1: sign of the belt's speed,
    contact (n,) False in the air; sway (n, 3): what the indentation's correction changes by with lateral m and the two tilts."""

    q: Array
    waypoint: Array
    setpoint: Array
    belt: Array
    contact: Flags
    sway: Array = field(default_factory=lambda: np.zeros((0, 3)))

    def __post_init__(self) -> None:
        if not len(self.sway):
            object.__setattr__(self, "sway", np.zeros((len(self.q), 3)))

    def __len__(self) -> int:
        return len(self.q)

    @staticmethod
    def joined(parts: Sequence["ForceRows"]) -> "ForceRows":
        """Rows one after the other."""
        return ForceRows(*(np.concatenate([vars(part)[f.name] for part in parts]) for f in fields(ForceRows)))


@dataclass(frozen=True)
class PlacedRows(Stacked):
    """Rows with parameters theta (n, m) of their own; each row's own setpoint is in them, a shift of its joints in `base.q`."""

    base: ForceRows
    theta: Array

    @staticmethod
    def of(cell: Cell, base: ForceRows, theta: Array, shift: Array | None = None) -> "PlacedRows":
        """Rows at parameters theta (m,) or (n, m) with joints moved by `shift` (n, 6) rad."""
        whole = np.array(np.broadcast_to(theta, (len(base), theta.shape[-1])))
        if cell.flange is not None:
            # A row's own setpoint is the cell's plus a known offset: the model stays as it is.
            whole[:, SETPOINT] += base.setpoint - cell.flange.setpoint
        return PlacedRows(base if shift is None else replace(base, q=base.q + shift), whole)


@dataclass(frozen=True)
class ForceModel:
    """Force between wheel and blade of one cell and wheel law."""

    cell: Cell
    law: WheelLaw

    @cached_property
    def least_force(self) -> float:
        """N; below it the balance is linear in F (docs/force_registration.md, eq. 3)."""
        return LEAST_FORCE * self.law.limits["force"][0]

    @cached_property
    def _functions(self) -> dict[str, ColumnFunction]:
        # Symbols in the place of numbers: the parts' derivative in the friction is wanted, and rows differ in the belt's sign.
        friction: Any = ca.SX.sym("mu")
        belt: Any = ca.SX.sym("belt")
        wheel = replace(self.cell.wheel, friction=friction, belt_speed=belt)
        model = build_model(replace(self.cell, wheel=wheel), self.law)
        w, sway, posture = model.w, ca.SX.sym("sway", 3), ca.vertcat(model.lateral, model.tilt)
        moved = ca.vertcat(w[:CORRECTION], w[CORRECTION] + ca.dot(sway, posture), w[CORRECTION + 1 :])
        residual, parts = ca.substitute([model.residual, model.parts], [w], [moved])
        model = replace(model, residual=residual, parts=parts)
        slope, slopes = ca.jacobian(model.residual, model.F), ca.jacobian(model.parts, model.F)
        place = [
            model.arc,
            model.lateral,
            model.turn,
            model.tilt,
            model.curvature,
            ca.vec(model.T_base_blade.T),
            model.joint_lever,
            model.joint_push,
            model.tau,
        ]
        state = [model.residual, slope, model.delta, model.parts, slopes, *place, ca.jacobian(ca.sum1(model.parts), friction)]
        by = ca.horzcat(slope, ca.jacobian(model.residual, model.theta), ca.jacobian(model.residual, model.q))
        outputs = {"state": ca.vertcat(*state), "derivative": by.T, "stroke": ca.jacobian(model.parts[0], model.theta).T}
        outputs["giving"] = ca.vec(ca.jacobian(ca.vertcat(model.parts, slopes), model.theta)[:, GIVING])
        arguments = [model.q, model.F, model.w, sway, model.theta, belt]
        known = {name: ca.substitute(ca.densify(o), friction, self.cell.wheel.friction) for name, o in outputs.items()}
        return {name: ColumnFunction(ca.Function(f"force_{name}", arguments, [o], {"cse": True})) for name, o in known.items()}

    @cached_property
    def _compiled(self) -> None:
        """Machine code of all functions, asked for once."""
        compile_together(list(self._functions.values()))

    def evaluate(self, kind: str, rows: PlacedRows, F: Array) -> Array:
        """Numbers (n, k) at forces F (n,) N: "state" (columns `STATE`: residual m and its slope in F m/N, overlap m, the four
        parts m and their slopes m/N, arc rad, lateral m, turn rad, tilts, relative curvature 1/m, T_base_blade by rows, levers of
        the joints m/rad, torques of contact and weight about them N m, the parts' derivative in the friction m), "derivative" (of
        the residual in F, theta (m) and q (6)), "stroke" (the flange's derivative in theta at the same force) or "giving" (of the
        four parts and their slopes in each of `GIVING`)."""
        if not len(F):
            return np.empty((0, self._functions[kind].size1_out(0)))
        if len(F) >= WORTH_COMPILING:
            self._compiled  # noqa: B018
        base = rows.base
        return evaluate_rows(self._functions[kind], base.q, F[:, None], base.waypoint, base.sway, rows.theta, base.belt[:, None])

    def solve(
        self,
        rows: PlacedRows,
        guess: Array,
        pressed: Flags | None = None,
        extra: Extra | None = None,
        stiffness: Array | None = None,
        tolerance: float = FORCE_TOLERANCE,
    ) -> tuple[Array, Array, Array]:
        """Contact force (n,) N of rows in contact, zero where the wheel does not reach the blade; the state there (n, k); the
        contact's stiffness (n,) N/m: force by a small overlap more.

        Rows known to be `pressed` (n,) get a negative force instead, the tangent's over the gap: a fit that starts too far off
        then still sees which way the wheel is. `extra` is the interference that effects add; what it changes with the force
        enters by secants. Newton from `guess`, with the `stiffness` (n,) of a solution nearby, until steps are below
        `tolerance` N.
        """
        F, pressed = np.array(guess, float), np.zeros(len(guess), bool) if pressed is None else pressed
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
            given = -now[:, STATE["slope"]][:, 0]
            add = np.zeros(len(active)) if extra is None else extra(active, at, now)
            moved = at - old_F[active]
            known = np.isfinite(old_extra[active]) & (np.abs(moved) > 1e-3)
            gain[active] = _reasonable(np.divide(add - old_extra[active], moved, out=gain[active], where=known), given)
            total[active] = given - gain[active]
            step = (now[:, 0] + add - total[active] * (F[active] - at)) / total[active]
            old_F[active], old_extra[active] = at, add
            # From far off a step may overshoot into forces where the law is steep: at most a factor of three up.
            F[active] = np.minimum(F[active] + step, 3.0 * at)
            active = active[np.abs(step) > tolerance]
            if not len(active):
                break
        state[:, STATE["parts"]] += state[:, STATE["slopes"]] * (np.maximum(F, self.least_force) - old_F)[:, None]  # last steps
        touching = pressed | (F > 0)
        return np.where(touching, F, 0.0), state, np.where(touching, 1.0 / np.maximum(total, 1e-12), 0.0)

    def _gain(self, rows: PlacedRows, F: Array, extra: Extra | None, stiffness: Array | None) -> tuple[Array | None, Array]:
        """The state at F where it was needed, and the derivative (n,) m/N of the extra interference in F."""
        if extra is None:
            return None, np.zeros(len(F))
        here, index = np.maximum(F, self.least_force), np.arange(len(F), dtype=np.int64)
        now = self.evaluate("state", rows, here)
        given = -now[:, STATE["slope"]][:, 0]
        if stiffness is not None and (stiffness > 0).all():
            return now, np.asarray(given - 1.0 / stiffness)
        there = here + PROBE
        change: Array = extra(index, there, self.evaluate("state", rows, there)) - extra(index, here, now)
        return now, _reasonable(change / PROBE, given)

    def force(self, rows: ForceRows, theta: Array, guess: Array | None = None, pressed: Flags | None = None) -> Array:
        """Contact force (n,) N at parameters theta (m,), zero in the air; see `solve`. Newton from `guess` (n,)."""
        F = np.zeros(len(rows))
        at = np.flatnonzero(rows.contact)
        if len(at):
            usual = np.maximum(rows.setpoint if self.cell.flange is not None else self.law.process_force, self.least_force)
            start = np.broadcast_to(usual, len(rows)) if guess is None else guess
            part = PlacedRows.of(self.cell, rows.take(at), theta)
            F[at] = self.solve(part, start[at], None if pressed is None else pressed[at])[0]
        return F

    def sensitivity(self, rows: ForceRows, theta: Array, F: Array) -> Array:
        """dF/dtheta (n, m) at the forces F (n,) that `force` gave; zero where the force is zero."""
        out = np.zeros((len(rows), Theta.size))
        at = np.flatnonzero(rows.contact & (F != 0))
        if len(at):
            part = PlacedRows.of(self.cell, rows.take(at), theta)
            values = self.evaluate("derivative", part, np.maximum(F[at], self.least_force))
            out[at] = -values[:, 1 : 1 + Theta.size] / values[:, :1]
        return out


def _reasonable(gain: Array, given: Array) -> Array:
    """Effects that change the stiffness beyond reason would turn the balance over."""
    return np.asarray(np.clip(gain, -3.0 * given, 0.7 * given))
