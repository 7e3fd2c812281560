"""Library-free features: what an effect nobody catalogued would look like, by where it enters and what it varies with.

Each kernel is a handful of smooth functions of one condition (or two) that enter the readings at one joint's angle, as a tilt
of its axis, as a displacement of the instrument's frame, or as the reading itself. They are tested like effects (same
projection, same evidence); a condition that wins although the library was offered speaks for an effect outside it.
"""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from ocp.diagnosis.system import Conditions
from robots.measurements import Index
from robots.pose import Array

SMOOTH = 7  # cosines over a condition's range
TILTED = 5  # of them for each direction of a tilting axis
SOFT = 4.0  # wave number at which their prior has fallen to half
LEAST_TURN = np.radians(20.0)  # an axis that moved less varies with nothing
ORDERS_OF_TWO = ((1, 1), (1, 2), (2, 1), (2, 2), (1, 3), (2, 3))  # waves per turn of a joint and of another one
RIPPLES = np.arange(2.5, 121.0)  # half-integer orders per turn: integers are the library's
JOINT_RANGE = (2e-5, 5e-4)  # rad, typical low and high of an angle error
FRAME_RANGE = (2e-5, 5e-4)  # m, of a displacement
FORCE_RANGE = (0.2, 5.0)  # N, of a force reading
_SCALAR = ("s", "feed", "setpoint", "travel", "belt", "clock", "time", "temperature", "wheel_temperature", "run", "line")


@dataclass(frozen=True)
class Kernel:
    """Features (n, V, m) of unit size in gap units (k components): changes (n, k, V, m) SI; where: the condition; source:
    joint, axis, frame or reading; joint (0: none); typical low and high of its size in `unit`."""

    where: str
    source: str
    joint: int
    changes: Array
    low: float
    high: float


def kernels(c: Conditions) -> Iterator[Kernel]:
    """All kernels that the conditions allow."""
    if c.d_joints is not None:
        for j in range(6):
            if np.ptp(c.q[:, j]) > LEAST_TURN or c.signal != "tracker":
                for where, features in _of_joint(c, j):
                    changes = c.d_joints[:, :, j, None, None] * features[:, None]
                    yield Kernel(where, "joint", j + 1, changes, *JOINT_RANGE)
                if c.d_tilts is not None:
                    yield _wobble(c, c.d_tilts, j)
    n, k = c.q.shape[0], 3 if c.d_joints is None else c.d_joints.shape[1]
    if c.signal == "tracker":
        for where, features in _of_frame(c):
            m = features.shape[1]
            changes = (np.eye(3)[None, :, :, None] * features[:, None, None, :]).reshape(n, 3, 1, 3 * m)
            yield Kernel(where, "frame", 0, changes, *FRAME_RANGE)
    elif c.signal == "force":
        for where, features in _of_reading(c):
            changes = np.zeros((n, k, 1, features.shape[1]))
            changes[:, 0, 0] = features
            yield Kernel(where, "reading", 0, changes, *FORCE_RANGE)


def _wobble(c: Conditions, d_tilts: Array, j: int) -> Kernel:
    """The axis of joint j tilts as it turns: bearings, a base plate that is not flat."""
    features = smooth(c.q[:, j], TILTED)
    changes = (d_tilts[:, :, j, :, None] * features[:, None, None, :]).reshape(len(c.q), d_tilts.shape[1], 1, -1)
    return Kernel(f"q{j + 1}", "axis", j + 1, changes, *JOINT_RANGE)


def _of_joint(c: Conditions, j: int) -> Iterator[tuple[str, Array]]:
    """Features (n, V, m) of joint j (0..5), by what they vary with."""
    name, q = j + 1, c.q[:, j]
    yield f"q{name}", smooth(q)[:, None]
    yield f"ripple{name}", np.stack([np.cos(RIPPLES * q[:, None]), np.sin(RIPPLES * q[:, None])], axis=2)
    if c.approach is not None and np.ptp(c.approach[:, j]) > 0:
        sign = c.approach[:, j]
        turns = np.stack([np.column_stack([np.ones(len(q)), np.cos(k * q), np.sin(k * q)]) for k in (1, 2)], axis=1)
        yield f"approach{name}", sign[:, None, None] * turns
    if c.gear_ratio is not None and np.isfinite(c.gear_ratio[j]):
        phase = np.outer(q, c.gear_ratio[j] * np.arange(1, 4))
        yield f"motor{name}", np.hstack([np.cos(phase), np.sin(phase)])[:, None]
    if c.tau is not None and np.ptp(c.tau[:, j]) > 1.0:
        yield f"tau{name}", smooth(c.tau[:, j], 3)[:, None]
    for i in range(6):
        if i != j and np.ptp(c.q[:, i]) > LEAST_TURN:
            yield f"q{name} x q{i + 1}", np.stack([_products(q, c.q[:, i], *k) for k in ORDERS_OF_TWO], axis=1)
    for where, values in (("temperature", c.temperature), ("time", _time(c))):
        if values is not None and np.ptp(values) > 0:
            yield f"{where}{name}", smooth(values, 3)[:, None]
    indicator = groups(c.payload)
    if indicator is not None:
        yield f"payload{name}", indicator[:, None]


def _products(q: Array, other: Array, a: int, b: int) -> Array:
    """Waves (n, 4) of two angles, a per turn of the first times b per turn of the second."""
    one = np.column_stack([np.cos(a * q), np.sin(a * q)])
    two = np.column_stack([np.cos(b * other), np.sin(b * other)])
    return (one[:, :, None] * two[:, None, :]).reshape(len(q), 4)


def _of_frame(c: Conditions) -> Iterator[tuple[str, Array]]:
    """Features (n, m) of a displacement common to all directions of the frame."""
    for where, values in (("time", _time(c)), ("temperature", c.temperature)):
        if values is not None and np.ptp(values) > 0:
            yield where, smooth(values, 3)
    for where, index in (("payload", c.payload), ("session", c.session)):
        indicator = groups(index)
        if indicator is not None:
            yield where, indicator
    time, nests = _time(c), groups(c.target, centred=False)
    if time is not None and nests is not None and np.ptp(time) > 0:
        yield "target x time", (nests[:, :, None] * smooth(time, 2)[:, None, :]).reshape(len(time), -1)


def _of_reading(c: Conditions) -> Iterator[tuple[str, Array]]:
    """Features (n, m) of the reading itself."""
    for where in _SCALAR:
        values = getattr(c, where)
        if values is None or np.ptp(values) == 0:
            continue
        if where in ("run", "line", "travel"):
            indicator = groups(values)
            if indicator is not None and indicator.shape[1] <= 12:
                yield where, indicator
        else:
            yield where, smooth(values, SMOOTH if where == "s" else 3)


def _time(c: Conditions) -> Array | None:
    return c.clock if c.clock is not None else c.time


def smooth(values: Array, count: int = SMOOTH) -> Array:
    """Cosines (n, count) over the range of values, falling with their wave number; the constant is left out."""
    span = float(np.ptp(values)) or 1.0
    x = (values - values.min()) / span
    k = np.arange(1, count + 1)
    return np.asarray(np.cos(np.pi * k * x[:, None]) / (1.0 + (k / SOFT) ** 2))


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
