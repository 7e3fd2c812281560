"""Library-free features: what an effect nobody catalogued would look like, by where it enters and what it varies with.

Each kernel is a handful of smooth functions of one condition (or two) that enter the readings at one joint's angle, as a tilt
of its axis, as a displacement of the instrument's frame, along or across the instrument's beam, or as the reading itself. They
are tested like effects (same projection, same evidence); a condition that wins although the library was offered speaks for an
effect outside it.

Kernels of a force log act at the contact, with its friction and not in the air, or on the normal reading alone: how a sensor's
second axis reads is its own affair. Of waves of time and path, which are of the reading, only those that the log speaks for most
take part (`ocp.diagnose.force.waves`).
"""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from ocp.diagnose.engine.channel_system import ReadingConditions
from ocp.diagnose.rules import FORCE_KERNEL, FRAME_KERNEL, JOINT_KERNEL, LEAST_TORQUE, LEAST_TURN, TILT_KERNEL
from ocp.effects.engine.evaluate import left_of_motion
from robots.pose import Array
from robots.tracker_readings import Index

TILTED = 5  # cosines for each direction of a tilting axis
ORDERS_OF_TWO = ((1, 1), (1, 2), (2, 1), (2, 2), (1, 3), (2, 3))  # waves per turn of a joint and of another one
INSTANTS = 7  # at which a nest may move
MOTOR_WAVES = 8  # per turn of a motor: resolvers err up to there
LOADED = np.arange(1.0, 81.0)  # orders per turn of ripples that grow with the load
RIPPLES = np.arange(2.5, 121.0)  # half-integer orders per turn: integers are the library's
BEAM = ("range", "azimuth", "elevation")
SMOOTH = 7  # cosines over a condition's range
SOFT = 4.0  # wave number at which their prior has fallen to half
MOST_GROUPS = 12
CLOCK_WAVES = 12  # of the campaign's clock at most, half waves
_SCALAR = ("s", "feed", "setpoint", "travel", "belt", "clock", "time", "temperature", "wheel_temperature", "run", "line")
_TWO = "travel s, travel feed, setpoint s, setpoint clock, setpoint belt, setpoint feed, clock s, belt time, feed s"


@dataclass(frozen=True)
class Kernel:
    """Features (n, V, m) of unit size in gap units (k components): changes (n, k, V, m) SI; where: the condition; source:
    joint, axis, frame, beam or reading; joint (0: none); typical low and high of its size, SI; among: of how many variants these
    are the most telling, 0: they are all there are."""

    where: str
    source: str
    joint: int
    changes: Array
    low: float
    high: float
    among: int = 0


def is_periodic(where: str) -> bool:
    """Whether a kernel is of waves or periods, of which the most telling are taken."""
    return "wave" in where or "period" in where


def kernels(c: ReadingConditions) -> Iterator[Kernel]:
    """All kernels that the conditions allow."""
    if c.d_joints is not None:
        for j in range(6):
            if np.ptp(c.q[:, j]) > LEAST_TURN or c.signal != "tracker":
                for where, features in _of_joint(c, j):
                    changes = c.d_joints[:, :, j, None, None] * features[:, None]
                    yield Kernel(where, "joint", j + 1, changes, *JOINT_KERNEL)
                if c.d_tilts is not None:
                    yield from _of_axis(c, c.d_tilts[:, :, j], j)
    n, k = c.q.shape[0], 3 if c.d_joints is None else c.d_joints.shape[1]
    if c.signal == "tracker":
        still = np.broadcast_to(np.eye(3), (n, 3, 3))
        for where, features in _of_frame(c):
            yield Kernel(where, "frame", 0, _each(still, features)[:, :, None], *FRAME_KERNEL)
            if c.point is not None and where in ("time", "temperature"):
                # What grows about a point, wherever that is: the arm, the air's index, the floor.
                grown = np.concatenate([still, unit(c.point)[:, :, None]], axis=2)
                yield Kernel(f"range x {where}", "frame", 0, _each(grown, features[:, :2])[:, :, None], *FRAME_KERNEL)
        yield from _of_nests(c)
        if c.point is not None:
            yield from _of_beam(c, c.point)
            if c.sight is not None:
                yield _of_sight(c.point, c.sight)
    elif c.signal == "force":
        for where, features, among in _of_reading(c):
            changes = np.zeros((n, k, *features.shape[1:]))
            changes[:, 0] = features
            if not among and c.pressed is not None:  # what comes by the contact: nothing in the air, and with its friction
                changes = np.concatenate([c.pressed[:, :, None, None] * features[:, None], changes], axis=2)
            yield Kernel(where, "reading", 0, changes, *FORCE_KERNEL, among)


def _of_joint(c: ReadingConditions, j: int) -> Iterator[tuple[str, Array]]:
    """Features (n, V, m) of joint j (0..5), by what they vary with."""
    name, q = j + 1, c.q[:, j]
    tau = c.tau[:, j] if c.tau is not None and np.ptp(c.tau[:, j]) > LEAST_TORQUE else None
    yield f"q{name}", smooth(q)[:, None]
    yield f"ripple{name}", _of_orders(RIPPLES * q[:, None])
    if c.approach is not None and np.ptp(c.approach[:, j]) > 0:
        sign = c.approach[:, j]
        turns = np.stack([np.column_stack([np.ones(len(q)), np.cos(k * q), np.sin(k * q)]) for k in (1, 2)], axis=1)
        yield f"approach{name}", sign[:, None, None] * turns
        if tau is not None:
            yield f"approach{name} x tau{name}", (sign[:, None] * _powers(tau))[:, None]
        if c.signal == "tracker" and c.waited is not None:
            yield f"approach{name} x wait", (sign[:, None] * left_of_motion(c.waited))[:, None]
        if c.signal == "tracker" and c.moved is not None:
            yield f"step{name}", smooth(c.moved[:, j], 5)[:, None]
    ratios = c.gear_ratio[j] if c.gear_ratio is not None else ()
    if len(ratios):
        yield f"motor{name}", _of_orders(np.outer(q, np.outer(ratios, np.arange(1, MOTOR_WAVES + 1)).ravel()))
    if tau is not None:
        yield f"tau{name}", smooth(tau, 3)[:, None]
        if c.signal == "tracker":
            yield f"tau{name} x ripple{name}", unit(tau)[:, None, None] * _of_orders(LOADED * q[:, None])
    for i in range(6):
        if i != j and np.ptp(c.q[:, i]) > LEAST_TURN:
            yield f"q{name} x q{i + 1}", np.stack([waves_of_two(q, c.q[:, i], *k) for k in ORDERS_OF_TWO], axis=1)
            if c.signal == "tracker":
                yield f"q{i + 1}", smooth(c.q[:, i], 3)[:, None]
    for where, values in (("temperature", c.temperature), ("time", _time(c))):
        if values is not None and np.ptp(values) > 0:
            yield f"{where}{name}", smooth(values, 3)[:, None]
            if c.signal == "tracker":
                yield f"{where} x q{name}", products(smooth(values, 2), waves(q))[:, None]
                if tau is not None:
                    yield f"{where} x tau{name}", products(smooth(values, 2), _powers(tau)[:, :2])[:, None]
    indicator = groups(c.payload)
    if indicator is not None:
        yield f"payload{name}", indicator[:, None]
        if c.signal == "tracker":
            yield f"payload x q{name}", products(indicator, waves(q))[:, None]


def _of_axis(c: ReadingConditions, d_tilt: Array, j: int) -> Iterator[Kernel]:
    """Tilts of the axis of joint j about the two directions across it, d_tilt (n, k, 4): as it turns (bearings, a base plate that
    is not flat; directions that stand still in the link before), with the weight's moment across it, with warmth, time and
    payload (directions that stand still, or turn with the joint)."""
    name = j + 1
    still, turning = d_tilt[:, :, :2], d_tilt[:, :, 2:]
    yield Kernel(f"q{name}", "axis", name, _each(still, smooth(c.q[:, j], TILTED))[:, :, None], *JOINT_KERNEL)
    if c.moments is not None and np.ptp(c.moments[:, j]) > LEAST_TORQUE:
        yield Kernel(f"moment{name}", "axis", name, _each(still, unit(c.moments[:, j]))[:, :, None], *TILT_KERNEL)
    slow = (("temperature", c.temperature), ("time", _time(c)))
    varying = [(where, smooth(values, 2)) for where, values in slow if values is not None and np.ptp(values) > 0]
    indicator = groups(c.payload)
    for where, features in varying + ([("payload", indicator)] if indicator is not None else []):
        changes = np.stack([_each(d, features) for d in (still, turning)], axis=2)
        yield Kernel(f"{where}{name}", "axis", name, changes, *TILT_KERNEL)


def _of_beam(c: ReadingConditions, point: Array) -> Iterator[Kernel]:
    """The instrument's own errors at points (n, 3) m in its frame: along the beam or across it, each a function of range,
    azimuth or elevation, or of one of these and of temperature or time; angles show with the distance, here over its mean."""
    flat = np.linalg.norm(point[:, :2], axis=1)
    distance = np.linalg.norm(point, axis=1)
    along = point / distance[:, None]
    aside = np.column_stack([-point[:, 1], point[:, 0], np.zeros(len(point))]) / flat[:, None]
    upward = np.cross(along, aside)
    directions = along, aside * (flat / flat.mean())[:, None], upward * (distance / distance.mean())[:, None]
    turned = np.arctan2(point[:, 1], point[:, 0])
    middle = np.arctan2(np.sin(turned).mean(), np.cos(turned).mean())
    azimuth = np.angle(np.exp(1j * (turned - middle)))
    for where, values in zip(BEAM, (distance, azimuth, np.arctan2(point[:, 2], flat)), strict=True):
        seen = {where: smooth(values, 4)}
        for slow, course in (("temperature", c.temperature), ("time", _time(c))):
            if course is not None and np.ptp(course) > 0:
                seen[f"{where} x {slow}"] = products(unit(values)[:, None], smooth(course, 2))
        for condition, features in seen.items():
            changes = np.stack([d[:, :, None] * features[:, None] for d in directions], axis=2)
            yield Kernel(condition, "beam", 0, changes, *FRAME_KERNEL)


def _of_sight(point: Array, sight: Array) -> Kernel:
    """Reflectors that are no perfect balls: errors along the beam that vary with the direction (n, 3) from which a reflector is
    seen, in the axes of the link that carries it, to second order."""
    along = point / np.linalg.norm(point, axis=1, keepdims=True)
    x, y, z = sight.T
    features = np.column_stack([sight, x * y, y * z, z * x, x * x - y * y, 3 * z * z - 1.0])
    return Kernel("sight", "beam", 0, _each(along[:, :, None], features)[:, :, None], *FRAME_KERNEL)


def _of_frame(c: ReadingConditions) -> Iterator[tuple[str, Array]]:
    """Features (n, m) of a displacement common to all directions of the frame."""
    for where, values in (("time", _time(c)), ("temperature", c.temperature)):
        if values is not None and np.ptp(values) > 0:
            yield where, smooth(values, 3)
    for where, index in (("payload", c.payload), ("session", c.session)):
        indicator = groups(index)
        if indicator is not None:
            yield where, indicator


def _of_nests(c: ReadingConditions) -> Iterator[Kernel]:
    """One nest moves, sooner or later: each nest and instant a variant."""
    time, nests = _time(c), groups(c.target, centred=False)
    if time is not None and nests is not None and np.ptp(time) > 0:
        still = np.broadcast_to(np.eye(3), (len(time), 3, 3))
        instants = np.quantile(time, np.arange(1, INSTANTS + 1) / (INSTANTS + 1))
        moved = [nest * (time > at) for nest in nests.T for at in instants]
        changes = np.stack([_each(still, one[:, None]) for one in moved], axis=2)
        yield Kernel("target x time", "frame", 0, changes, *FRAME_KERNEL)


def _time(c: ReadingConditions) -> Array | None:
    return c.clock if c.clock is not None else c.time


def _of_orders(phase: Array) -> Array:
    """Cosine and sine (n, V, 2) of phases (n, V)."""
    return np.stack([np.cos(phase), np.sin(phase)], axis=2)


def _powers(values: Array) -> Array:
    """First to third power (n, 3) of values over their largest size."""
    x = unit(values)
    return np.column_stack([x, x**2, x**3])


def _each(directions: Array, features: Array) -> Array:
    """Every direction (n, k, d) with every feature (n, m): (n, k, d m)."""
    n, k, _ = directions.shape
    return np.asarray((directions[:, :, :, None] * features[:, None, None, :]).reshape(n, k, -1))


def smooth(values: Array, count: int = SMOOTH) -> Array:
    """Cosines (n, count) over the range of values, falling with their wave number; the constant is left out."""
    span = float(np.ptp(values)) or 1.0
    x = (values - values.min()) / span
    k = np.arange(1, count + 1)
    return np.asarray(np.cos(np.pi * k * x[:, None]) / (1.0 + (k / SOFT) ** 2))


def waves(angle: Array) -> Array:
    """Once a turn (n, 2)."""
    return np.column_stack([np.cos(angle), np.sin(angle)])


def unit(values: Array) -> Array:
    """Values over their largest size."""
    return np.asarray(values / (np.abs(values).max() or 1.0))


def products(one: Array, other: Array) -> Array:
    """Each of (n, a) times each of (n, b): (n, a b)."""
    return np.asarray((one[:, :, None] * other[:, None, :]).reshape(len(one), -1))


def waves_of_two(q: Array, other: Array, a: int, b: int) -> Array:
    """Waves (n, 4) of two angles, a per turn of the first times b per turn of the second."""
    return products(waves(a * q), waves(b * other))


def groups(index: Array | Index | None, centred: bool = True) -> Array | None:
    """Indicators (n, g - 1) of all groups but the largest, or None where there is one group; centred about their means."""
    if index is None:
        return None
    kinds, counts = np.unique(index, return_counts=True)
    if len(kinds) < 2:
        return None
    kept = np.delete(kinds, np.argmax(counts)) if centred else kinds
    indicator = (np.asarray(index)[:, None] == kept).astype(float)
    return indicator - indicator.mean(axis=0) if centred else indicator


def _of_reading(c: ReadingConditions) -> Iterator[tuple[str, Array, int]]:
    """Features (n, V, m) of the normal reading by their condition, all that the conditions of a force log allow; among how many
    variants these are the most telling, 0: they are all there are."""
    for where in _SCALAR:
        one = _of_one(c, where)
        if one is not None:
            yield where, one[:, None], 0
    for first, second in map(str.split, _TWO.split(", ")):
        a, b = _of_one(c, first, 2), _of_one(c, second, 3)
        if a is not None and b is not None:
            yield f"{first} x {second}", products(a, b)[:, None], 0
    for j in range(6):
        if np.ptp(c.q[:, j]) > LEAST_TURN:
            yield f"q{j + 1}", smooth(c.q[:, j], 4)[:, None], 0
    if c.clock is not None and c.run is not None and len(np.unique(c.run)) > 4:
        phase = np.pi * (c.clock - c.clock.min()) / max(float(np.ptp(c.clock)), 1e-9)
        yield "clock wave", np.stack([waves(k * phase) for k in range(3, 3 + CLOCK_WAVES)], axis=1), 0
    for where in dict.fromkeys(w.where for w in c.waves):
        picked = [w for w in c.waves if w.where == where]
        yield where, np.stack([w.columns for w in picked], axis=1), picked[0].among


def _of_one(c: ReadingConditions, where: str, count: int = 3) -> Array | None:
    """Features (n, m) of one condition, None where it is not known or does not vary."""
    values = getattr(c, where)
    if values is None or np.ptp(values) == 0:
        return None
    if where in ("run", "line", "travel"):
        indicator = groups(values)
        return indicator if indicator is not None and indicator.shape[1] <= MOST_GROUPS else None
    return smooth(values, SMOOTH if where == "s" and count == 3 else count)
