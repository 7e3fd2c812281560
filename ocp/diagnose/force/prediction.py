"""What the log would show: contact force, normal and tangential reading of every row, with active effects in the balance.

Effects that add interference or push enter the balance itself and the force is solved again; those of the sensor, and those
that remember the log, enter the reading. docs/diagnosis_force.md, eq. 1 to 5.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from ocp.calibrate.force.conditions import LogConditions
from ocp.calibrate.force.fit import BIAS
from ocp.calibrate.force.log import Flags, Index
from ocp.calibrate.force.model import PROBE, STATE, ForceModel, ForceRows, PlacedRows
from ocp.diagnose.force.arm import BLADE, Arm
from ocp.diagnose.force.believed import SHEAR_BIAS, SHEAR_GAIN
from ocp.diagnose.force.context import PLACE, Samples, hook_columns, samples_of, with_stroke_sign
from ocp.effects.context import LogRows
from ocp.effects.effect import Active, Effect, Scanned
from ocp.model.cell import Cell
from ocp.model.theta import Theta
from robots.pose import Array

M = Theta.size
ZEROED = ("parts", "slopes", "normal_stiffness", "friction_deflection", "clamp_deflection", "F")  # of rows in the air
TOLERANCE = 2e-4  # N: a step of Newton below this leaves less than 1e-7 N


@dataclass(frozen=True)
class Scene:
    """Rows of one log with everything about them that does not depend on the estimate; theta (M,) is the prior's mean; given:
    effects that the cell itself states, always in the prediction; pressed (n,): rows that only contact explains."""

    cell: Cell
    model: ForceModel
    rows: ForceRows
    conditions: LogConditions
    arm: Arm
    theta: Array
    given: tuple[Active, ...] = ()
    pressed: Flags | None = None

    @cached_property
    def air(self) -> Samples:
        """Samples of all rows without contact: where the arm is, no force."""
        low, rows = np.full(len(self.rows), self.model.least_force), PlacedRows.of(self.cell, self.rows, self.theta)
        state = self.model.evaluate("state", rows, low)
        out = samples_of(self.cell, rows, self.conditions, low, state, np.zeros(len(low)))
        for name in ZEROED:
            out.values[:, PLACE[name]] = 0.0
        return out

    @cached_property
    def touching(self) -> Index:
        """Indices of the rows in contact."""
        return np.flatnonzero(self.rows.contact).astype(np.int64)

    @cached_property
    def shear(self) -> Array:
        """Tangential force (n,) per newton of normal force as the cell believes: friction with the belt's sign."""
        return np.asarray(self.cell.wheel.friction * self.rows.belt)


@dataclass(frozen=True)
class Predicted:
    """Of n rows at one estimate: parameters x and active effects; contact force F (n,) N; readings fn, ft (n,) N; samples of
    all rows; stiffness (n,) N/m; fn_slope, ft_slope (n,): of the readings in F; the rows in contact as the balance had them;
    prompt (n,), (n,) N: what of both readings a delay shifts, the contact's own. What the sensor adds is slow, or of free phase:
    shifted with it, a wave's phase and the delay would be one curved valley."""

    x: Array
    active: tuple[Active, ...]
    F: Array
    fn: Array
    ft: Array
    samples: Samples
    stiffness: Array
    fn_slope: Array
    ft_slope: Array
    rows: PlacedRows
    prompt: tuple[Array, Array]


def predict(scene: Scene, x: Array, active: Sequence[Active] = (), near: Predicted | None = None) -> Predicted:
    """Readings at nuisance x (`believed.NUISANCE`) and coefficients of `active`; Newton starts at `near`'s force, and the sign
    of the flange's stroke is taken from there."""
    at, n, whole = scene.touching, len(scene.rows), (*scene.given, *active)
    rows = placed(scene, x, whole)
    guess = rows.base.setpoint if near is None else near.F[at]
    if scene.cell.flange is None and near is None:
        guess = np.full(len(at), scene.model.law.process_force)
    same = near is not None and len(near.active) == len(active)
    known = near.stiffness[at] if near is not None and same else None
    signs = None if near is None else near.samples.at("stroke_sign")[at]
    inside = scene.conditions.take(at)

    def extra(k: Index, F: Array, state: Array) -> Array:
        given = 1.0 / np.maximum(state[:, STATE["slopes"]].sum(axis=1), 1e-12)
        here = samples_of(scene.cell, rows.take(k), inside.take(k), F, state, given)
        if signs is not None:
            here.put("stroke_sign", signs[k])
        total = np.zeros(len(k))
        for one in bending:
            total += interference(scene.cell, one.effect, one.joint, [one.scanned], here)[0] @ one.a
        return total

    bending = [a for a in whole if a.effect.overlap is not None or a.effect.push is not None]
    pressed = np.zeros(len(at), bool) if scene.pressed is None else scene.pressed[at]
    force, state, stiff = scene.model.solve(rows, guess, pressed, extra if bending else None, known, TOLERANCE)
    samples, F, stiffness = Samples(scene.air.values.copy()), np.zeros(n), np.zeros(n)
    samples.values[at] = samples_of(scene.cell, rows, inside, force, state, stiff).values
    F[at], stiffness[at] = force, stiff
    samples = with_stroke_sign(samples, np.where(scene.rows.contact, scene.conditions.run, -1), scene.conditions.time)
    fn, ft = _readings(scene, x, whole, samples, F)
    fn_slope, ft_slope = np.ones(n), scene.shear * (1.0 + x[SHEAR_GAIN])
    if any(a.effect.sensor is not None or a.effect.shear is not None for a in whole):
        more = Samples(samples.values.copy())
        more.put("F", F + PROBE)
        fn_more, ft_more = _readings(scene, x, whole, more, F + PROBE)
        fn_slope, ft_slope = (fn_more - fn) / PROBE, (ft_more - ft) / PROBE
    made = Predicted(x, tuple(active), F, fn, ft, samples, stiffness, fn_slope, ft_slope, rows, _own(scene, x, F))
    late_n, late_t = np.zeros(n), np.zeros(n)
    for one in whole:
        add_n, add_t = remembered(scene, made, one.effect, one.joint, one.scanned)
        late_n, late_t = late_n + add_n @ one.a, late_t + add_t @ one.a
    return replace(made, fn=fn + late_n, ft=ft + late_t)


def placed(scene: Scene, x: Array, active: Sequence[Active]) -> PlacedRows:
    """Rows in contact at parameters x, their joints and blade moved by what active effects do to the arm."""
    at = scene.touching
    base = scene.rows.take(at)
    theta, shift = np.array(np.broadcast_to(x[:M], (len(at), M))), np.zeros((len(at), 6))
    for one in active:
        if one.effect.on_arm:
            moved = scene.arm.columns(one.effect, one.joint, [one.scanned])
            shift[:, moved.moving] += moved.shift[0, at] @ one.a
            if moved.blade is not None:
                theta[:, BLADE] += moved.blade[0, at] @ one.a
    return PlacedRows.of(scene.cell, base, theta, shift)


def interference(cell: Cell, effect: Effect, joint: int, scans: Sequence[Scanned], samples: Samples) -> Array:
    """Interference (V, n, m) m per unit coefficient of an effect's overlap and push. A push moves the flange's balance: it counts
    as the stroke it takes; in a rigid cell as the overlap that brings as much force."""
    out = np.zeros((len(scans), len(samples), effect.size))
    if effect.overlap is not None:
        out += hook_columns(cell, effect, "overlap", joint, scans, samples)
    if effect.push is not None:
        slopes = samples.at("slopes")
        give = slopes[:, 0] if cell.flange is not None else slopes.sum(axis=1)
        out += hook_columns(cell, effect, "push", joint, scans, samples) * give[:, None]
    return out


def remembered(scene: Scene, made: Predicted, effect: Effect, joint: int, scanned: Scanned) -> tuple[Array, Array]:
    """What an effect that remembers the log adds to both readings (n, m) N per unit coefficient."""
    return _memory(scene, made, effect, joint, scanned, (made.F, *made.prompt), effect.size)


def carried(scene: Scene, made: Predicted, changes: tuple[Array, Array, Array]) -> tuple[Array, Array]:
    """What the memory of all that is active makes of changes (n, k) N of the force and of the contact's own share of both
    readings: in both readings (n, k) N."""
    normal, shear = np.zeros_like(changes[1]), np.zeros_like(changes[2])
    for one in remembering(scene, made):
        more = _memory(scene, made, one.effect, one.joint, one.scanned, changes, normal.shape[1])
        normal, shear = normal + one.a[0] * more[0], shear + one.a[0] * more[1]
    return normal, shear


def remembering(scene: Scene, made: Predicted) -> list[Active]:
    """Those of all that is active that remember the log."""
    return [a for a in (*scene.given, *made.active) if a.effect.along is not None or a.effect.along_shear is not None]


def _memory(
    scene: Scene, made: Predicted, effect: Effect, joint: int, scanned: Scanned, forces: tuple[Array, Array, Array], count: int
) -> tuple[Array, Array]:
    """Memory (n, count) N in both readings of the force and of both readings (n,), or of columns (n, k) of their changes."""
    none = np.zeros((len(made.F), count))
    if effect.along is None and effect.along_shear is None:
        return none, none
    assert effect.size == 1, f"{effect.name}: what remembers has one coefficient"
    c, s = scene.conditions, made.samples
    slopes = s.at("slopes")
    share = np.divide(slopes[:, 1], slopes.sum(axis=1), out=np.zeros(len(slopes)), where=slopes.sum(axis=1) > 0)
    contact, clock = c.contact.astype(float), c.clock if "clock_s" in c.given else None
    log = LogRows(
        run=c.run.astype(float), time=c.time, s=c.s, F=forces[0], d_wheel=s.at("parts")[:, 1], stiffness=made.stiffness,
        wheel_share=share, fn=forces[1], ft=forces[2], contact=contact, travel=c.travel, feed=c.feed, clock=clock,
    )  # fmt: skip
    normal = none if effect.along is None else np.asarray(effect.along(log, joint, scanned), float)
    if effect.along_shear is not None:
        return normal, np.asarray(effect.along_shear(log, joint, scanned), float)
    # What the contact itself lets go, both readings show; a shift of one reading says so by a hook of its own.
    return normal, normal * scene.shear[:, None]


def _readings(scene: Scene, x: Array, active: Sequence[Active], samples: Samples, F: Array) -> tuple[Array, Array]:
    """Both readings (n,) N with what active effects do to the sensor, before anything that remembers."""
    fn, ft = _own(scene, x, F)
    for one in active:
        e = one.effect
        if e.sensor is not None:
            fn = fn + hook_columns(scene.cell, e, "sensor", one.joint, [one.scanned], samples)[0] @ one.a
        if e.shear is not None:
            ft = ft + hook_columns(scene.cell, e, "shear", one.joint, [one.scanned], samples)[0] @ one.a
    return fn, ft


def _own(scene: Scene, x: Array, F: Array) -> tuple[Array, Array]:
    """Both readings (n,) N of the contact's own force."""
    return F + x[BIAS], scene.shear * F * (1.0 + x[SHEAR_GAIN]) + x[SHEAR_BIAS]
