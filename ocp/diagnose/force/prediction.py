"""What the log would show: both readings of every row with active effects in the balance, and their derivatives.

Effects that add interference or push enter the balance itself and the force is solved again; those of the sensor, and those
that remember the log, enter the reading. docs/diagnosis_force.md, eq. 1 to 5.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np

from ocp.calibrate.force.fit import BIAS
from ocp.calibrate.force.model import GIVING, PROBE, STATE, ForceModel, ForceRows, PlacedRows
from ocp.calibrate.force.rows import LogConditions
from ocp.diagnose.force.logged_contact import BLADE, PLACE, LoggedArm, logged_arm, samples_of
from ocp.diagnose.force.prior import NUISANCE, SHEAR_BIAS, SHEAR_GAIN
from ocp.effects.context import LogRows
from ocp.effects.effect import Active, Effect, Scanned
from ocp.effects.engine.evaluate import ContactPlace, added_by_giving, added_overlap, contact_columns, overlap_columns
from ocp.model.cell import Cell
from ocp.model.theta import Theta
from robots.pose import Array, Index, Mask

M = Theta.size
HOOKS = ("sensor", "shear")  # of an effect that changes one reading alone: fn, ft
Past = tuple[Array, Array, Array]  # force N, stroke m (n,) and both readings N (2, n), or columns (.., k) of their changes
TOLERANCE = 2e-4  # N: a step of Newton below this leaves less than 1e-7 N
# Of rows in the air.
ZEROED = ("parts", "slopes", "normal_stiffness", "friction_deflection", "joint_push", "clamp_deflection", "F")


@dataclass(frozen=True)
class LogScene:
    """Rows of one log with everything about them that does not depend on the estimate; theta (M,) is the prior's mean; given:
    effects that the cell itself states, always in the prediction; pressed (n,): rows that only contact explains."""

    cell: Cell
    model: ForceModel
    rows: ForceRows
    conditions: LogConditions
    arm: LoggedArm
    theta: Array
    given: tuple[Active, ...] = ()
    pressed: Mask | None = None

    def over(self, rows: ForceRows, conditions: LogConditions, pressed: Mask | None = None) -> "LogScene":
        """The same cell over other rows."""
        arm = logged_arm(self.cell, self.theta, rows.q, conditions)
        return replace(self, rows=rows, conditions=conditions, arm=arm, pressed=pressed)

    @cached_property
    def contact(self) -> ContactPlace:
        """What hooks see of the cell."""
        return ContactPlace(self.cell.wheel.radius, self.cell.wheel.friction, tuple(self.cell.robot.gravity_direction))

    def place(self, samples: Array) -> tuple[ContactPlace, Array, bool]:
        """What `overlap_columns` and `added_overlap` are given at samples (n, k)."""
        return self.contact, samples, self.cell.flange is None

    @cached_property
    def air(self) -> Array:
        """Samples (n, k) of all rows without contact: where the arm is, no force."""
        low, rows = np.full(len(self.rows), self.model.least_force), PlacedRows.of(self.cell, self.rows, self.theta)
        state = self.model.evaluate("state", rows, low)
        out = samples_of(self.cell, rows, self.conditions, low, state, np.zeros(len(low)))
        for name in ZEROED:
            out[:, PLACE[name]] = 0.0
        return out

    @cached_property
    def touching(self) -> Index:
        """Indices of the rows in contact."""
        return np.flatnonzero(self.rows.contact).astype(np.int64)

    @cached_property
    def shear(self) -> Array:
        """Tangential force (n,) per newton of normal force as the cell believes: friction with the belt's sign."""
        return np.asarray(self.cell.wheel.friction * self.rows.belt)

    def slopes(self, at: "Predicted") -> tuple[Array, Array]:
        """Contact force's derivatives of all rows: in theta (n, M) and in the joints (n, 6), zero in the air."""
        n, rows = len(self.rows), self.touching
        theta, joints = np.zeros((n, M)), np.zeros((n, 6))
        held = np.maximum(at.F[rows], self.model.least_force)
        values = self.model.evaluate("derivative", PlacedRows(at.rows.base, at.rows.theta), held)
        if bending := bending_among((*self.given, *at.active)):
            moves = self.model.evaluate("giving", PlacedRows(at.rows.base, at.rows.theta), held)
            beside = added_by_giving(bending, *self.place(at.samples[rows]), moves, at.rows.theta[:, GIVING])
            values[:, [1 + k for k in GIVING]] += beside
        scaled = at.stiffness[rows, None] * values
        theta[rows], joints[rows] = scaled[:, 1 : 1 + M], scaled[:, 1 + M :]
        return theta, joints


@dataclass(frozen=True)
class Predicted:
    """Of n rows at one estimate: parameters x and active effects; contact force F (n,) N; both readings, fn and ft, read (2, n)
    N; samples (n, k) of all rows; stiffness (n,) N/m; slope (2, n): of the readings in F; the rows in contact as the balance had
    them; prompt (2, n) N: what of both readings a delay shifts, the contact's own. What the sensor adds is slow, or of free
    phase: shifted with it, a wave's phase and the delay would be one curved valley."""

    x: Array
    active: tuple[Active, ...]
    F: Array
    read: Array
    samples: Array
    stiffness: Array
    slope: Array
    rows: PlacedRows
    prompt: Array

    @property
    def fn(self) -> Array:
        """Normal reading (n,) N."""
        return np.asarray(self.read[0])


def predict_forces(scene: LogScene, x: Array, active: Sequence[Active] = (), near: Predicted | None = None) -> Predicted:
    """Readings at nuisance x (`prior.NUISANCE`) and coefficients of `active`; Newton starts at `near`'s force."""
    at, n, whole = scene.touching, len(scene.rows), (*scene.given, *active)
    rows = placed_rows(scene, x, whole)
    guess = rows.base.setpoint if near is None else near.F[at]
    if scene.cell.flange is None and near is None:
        guess = np.full(len(at), scene.model.law.process_force)
    same = near is not None and len(near.active) == len(active)
    known = near.stiffness[at] if near is not None and same else None
    inside = scene.conditions.take(at)

    def extra(k: Index, F: Array, state: Array) -> Array:
        given = 1.0 / np.maximum(state[:, STATE["slopes"]].sum(axis=1), 1e-12)
        here = samples_of(scene.cell, rows.take(k), inside.take(k), F, state, given)
        return added_overlap(bending, *scene.place(here))

    bending = bending_among(whole)
    pressed = np.zeros(len(at), bool) if scene.pressed is None else scene.pressed[at]
    force, state, stiff = scene.model.solve(rows, guess, pressed, extra if bending else None, known, TOLERANCE)
    samples, F, stiffness = scene.air.copy(), np.zeros(n), np.zeros(n)
    samples[at] = samples_of(scene.cell, rows, inside, force, state, stiff)
    F[at], stiffness[at] = force, stiff
    read, slope = _readings(scene, x, whole, samples, F), _prompt_slope(scene, x)
    if any(a.effect.sensor is not None or a.effect.shear is not None for a in whole):
        more = samples.copy()
        more[:, PLACE["F"].start] = F + PROBE
        slope = (_readings(scene, x, whole, more, F + PROBE) - read) / PROBE
    made = Predicted(x, tuple(active), F, read, samples, stiffness, slope, rows, _own(scene, x, F))
    late = [remembered(scene, made, one.effect, one.joint, one.scanned) @ one.a for one in remembering(scene, made)]
    return replace(made, read=read + sum(late, np.zeros_like(read)))


def bending_among(active: Sequence[Active]) -> list[Active]:
    """Those that enter the balance."""
    return [a for a in active if a.effect.overlap is not None or a.effect.push is not None]


def placed_rows(scene: LogScene, x: Array, active: Sequence[Active]) -> PlacedRows:
    """Rows in contact at parameters x, their joints and blade moved by what active effects do to the arm."""
    at = scene.touching
    base = scene.rows.take(at)
    theta, shift = np.array(np.broadcast_to(x[:M], (len(at), M))), np.zeros((len(at), 6))
    for one in active:
        if one.effect.on_arm:
            moved = scene.arm.columns(one.effect, one.joint, [one.scanned])
            shift[:, moved.moving] += (moved.shift[:, at, 0] @ one.a).T
            if moved.blade is not None:
                theta[:, BLADE] += (moved.blade[:, at, 0] @ one.a).T
    return PlacedRows.of(scene.cell, base, theta, shift)


def remembered(scene: LogScene, made: Predicted, effect: Effect, joint: int, scanned: Scanned) -> Array:
    """What an effect that remembers the log adds to both readings (2, n, m) N per unit coefficient."""
    assert effect.size == 1, f"{effect.name}: what remembers has one coefficient"
    stroke = made.samples[:, PLACE["parts"].start]
    return _memory(scene, made, effect, joint, scanned, (made.F, stroke, made.prompt))


def carried(scene: LogScene, made: Predicted, changes: Past) -> Array:
    """What the memory of all that is active makes of changes (n, k) of the force N, of the flange's stroke m and of the contact's
    own share of both readings N: in both readings (2, n, k) N."""
    each = ((one, _memory(scene, made, one.effect, one.joint, one.scanned, changes)) for one in remembering(scene, made))
    return sum((one.a[0] * more for one, more in each), np.zeros_like(changes[2]))


def remembering(scene: LogScene, made: Predicted) -> list[Active]:
    """Those of all that is active that remember the log."""
    return [a for a in (*scene.given, *made.active) if a.effect.along is not None or a.effect.along_shear is not None]


def _memory(scene: LogScene, made: Predicted, effect: Effect, joint: int, scanned: Scanned, past: Past) -> Array:
    """Memory (2, n, k) N of a past in both readings; k is one where that has no columns."""
    c, parts, slopes = scene.conditions, made.samples[:, PLACE["parts"]], made.samples[:, PLACE["slopes"]]
    whole = slopes.sum(axis=1, keepdims=True)
    share = np.divide(slopes, whole, out=np.zeros_like(slopes), where=whole > 0)
    same: dict[str, Any] = {name: getattr(c, name) for name in ("time", "s", "travel", "feed")}
    log = LogRows(
        run=c.run.astype(float),
        F=past[0],
        d_wheel=parts[:, 1],
        d_flange=parts[:, 0],
        stroke=past[1],
        stiffness=np.divide(1.0, whole[:, 0], out=np.zeros(len(whole)), where=whole[:, 0] > 0),
        wheel_share=share[:, 1],
        flange_share=share[:, 0],
        fn=past[2][0],
        ft=past[2][1],
        contact=c.contact.astype(float),
        clock=c.clock if "clock_s" in c.given else None,
        **same,
    )
    normal = np.zeros(1) if effect.along is None else np.asarray(effect.along(log, joint, scanned), float)
    # What the contact itself lets go, both readings show; a shift of one reading says so by a hook of its own.
    shear = normal * scene.shear[:, None] if effect.along_shear is None else effect.along_shear(log, joint, scanned)
    return np.stack(np.broadcast_arrays(normal, shear))


def _readings(scene: LogScene, x: Array, active: Sequence[Active], samples: Array, F: Array) -> Array:
    """Both readings (2, n) N with what active effects do to the sensor, before anything that remembers."""
    out = _own(scene, x, F)
    for one in active:
        for reading, hook in zip(out, HOOKS, strict=True):
            if getattr(one.effect, hook) is not None:
                reading += contact_columns(one.effect, hook, one.joint, [one.scanned], scene.contact, samples)[0] @ one.a
    return out


def _own(scene: LogScene, x: Array, F: Array) -> Array:
    """Both readings (2, n) N of the contact's own force."""
    return np.stack([F + x[BIAS], scene.shear * F * (1.0 + x[SHEAR_GAIN]) + x[SHEAR_BIAS]])


def nuisance_derivatives(scene: LogScene, at: Predicted, theta: Array) -> Array:
    """Derivatives (2, n, len(NUISANCE)) of fn and ft in the nuisance; theta (n, M): those of the force."""
    force = np.zeros((len(at.F), len(NUISANCE)))
    force[:, :M] = theta

    def read(slope: Array) -> Array:
        out = slope[:, :, None] * force
        out[0, :, BIAS] = out[1, :, SHEAR_BIAS] = 1.0
        out[1, :, SHEAR_GAIN] = scene.shear * at.F
        return out

    found = read(at.slope)
    if remembering(scene, at):
        stroke, rows = force * _soft(at), scene.touching
        placed, held = PlacedRows(at.rows.base, at.rows.theta), np.maximum(at.F[rows], scene.model.least_force)
        stroke[rows, :M] += scene.model.evaluate("stroke", placed, held)
        found += carried(scene, at, (force, stroke, read(_prompt_slope(scene, at.x))))
    return found


def effect_derivatives(
    scene: LogScene, at: Predicted, slopes: tuple[Array, Array], effect: Effect, joint: int, scans: Sequence[Scanned]
) -> Array | None:
    """Change (2, V, n, m) N of fn and ft per unit coefficient of each variant; None where the log does not say what the effect
    depends on. `slopes`: of the scene."""
    force = force_changes(scene, at, slopes, effect, joint, scans)
    out = at.slope[:, :, None, None] * force
    for reading, hook in zip(out, HOOKS, strict=True):
        if getattr(effect, hook) is not None:
            reading += contact_columns(effect, hook, joint, scans, scene.contact, at.samples).swapaxes(0, 1)
    if remembering(scene, at) and force.any():
        own = force.reshape(len(force), -1)
        past = own, own * _soft(at), _prompt_slope(scene, at.x)[:, :, None] * own
        out += carried(scene, at, past).reshape(out.shape)
    if effect.along is not None or effect.along_shear is not None:
        for v, scanned in enumerate(scans):
            out[:, :, v] += remembered(scene, at, effect, joint, scanned)
    return out.swapaxes(1, 2) if np.isfinite(out).all() else None


def force_changes(
    scene: LogScene, at: Predicted, slopes: tuple[Array, Array], effect: Effect, joint: int, scans: Sequence[Scanned]
) -> Array:
    """Change (n, V, m) N of the contact force per unit coefficient of each variant; nan where the log does not say what the
    effect depends on."""
    theta, joints = slopes
    rows = scene.touching
    force = np.zeros((len(at.F), len(scans), effect.size))
    if effect.overlap is not None or effect.push is not None:
        change = overlap_columns(effect, joint, scans, *scene.place(at.samples[rows]))
        force[rows] = at.stiffness[rows, None, None] * change.swapaxes(0, 1)
    if effect.on_arm:
        moved = scene.arm.columns(effect, joint, scans)
        for j, shift in zip(moved.moving, moved.shift, strict=True):
            force += joints[:, j, None, None] * shift
        for i, shift in zip(BLADE, () if moved.blade is None else moved.blade, strict=False):
            force += theta[:, i, None, None] * shift
    return force


def acts_by_force(scene: LogScene, at: Predicted, effect: Effect) -> bool:
    """Whether an effect changes both readings by their slopes in the contact force and in no other way."""
    others = (effect.sensor, effect.shear, effect.along, effect.along_shear)
    return all(hook is None for hook in others) and not remembering(scene, at)


def _soft(at: Predicted) -> Array:
    """What the flange gives (n, 1) m per newton of the force."""
    return at.samples[:, PLACE["slopes"]][:, :1]


def _prompt_slope(scene: LogScene, x: Array) -> Array:
    """The contact's own readings (2, n) per newton of its force."""
    return np.stack([np.ones(len(scene.shear)), scene.shear * (1.0 + x[SHEAR_GAIN])])
