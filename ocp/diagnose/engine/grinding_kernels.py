"""Library-free features of a grinding-force log: what the readings themselves may vary with, whatever the cause.

Smooth functions of one condition, products of two, in the normal reading (how the second axis of a sensor reads is its own
affair: logs by other hands differ there where nothing is planted); waves of the campaign's clock, those of the wheel's turn, and
of time and path the one that the log speaks for most (`ocp.diagnose.force.waves`).
"""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from ocp.diagnose.engine.features import SMOOTH, groups, products, smooth
from ocp.diagnose.engine.system import Conditions
from ocp.diagnose.rules import LEAST_TURN
from robots.pose import Array

MOST_GROUPS = 12
CLOCK_WAVES = 12  # of the campaign's clock at most, half waves
_SCALAR = ("s", "feed", "setpoint", "travel", "belt", "clock", "time", "temperature", "wheel_temperature", "run", "line")
_TWO = (
    ("travel", "s"), ("travel", "feed"), ("setpoint", "s"), ("setpoint", "clock"), ("setpoint", "belt"), ("setpoint", "feed"),
    ("clock", "s"), ("belt", "time"), ("feed", "s"),
)  # fmt: skip


@dataclass(frozen=True)
class ReadingKernel:
    """Features (n, V, m) of the normal reading by the condition `where`; among: of how many variants these are the most telling,
    0: they are all there are."""

    where: str
    features: Array
    among: int = 0


def reading_kernels(c: Conditions) -> Iterator[ReadingKernel]:
    """All that the conditions of a force log allow."""
    for where in _SCALAR:
        one = _of_one(c, where)
        if one is not None:
            yield ReadingKernel(where, one[:, None])
    for first, second in _TWO:
        a, b = _of_one(c, first, 2), _of_one(c, second, 3)
        if a is not None and b is not None:
            yield ReadingKernel(f"{first} x {second}", products(a, b)[:, None])
    for j in range(6):
        if np.ptp(c.q[:, j]) > LEAST_TURN:
            yield ReadingKernel(f"q{j + 1}", smooth(c.q[:, j], 4)[:, None])
    if c.clock is not None and c.run is not None and len(np.unique(c.run)) > 4:
        phase = np.pi * (c.clock - c.clock.min()) / max(float(np.ptp(c.clock)), 1e-9)
        yield ReadingKernel("clock wave", np.stack([_wave(k * phase) for k in range(3, 3 + CLOCK_WAVES)], axis=1))
    kinds = dict.fromkeys(w.where for w in c.waves)
    for where in kinds:
        waves = [w for w in c.waves if w.where == where]
        yield ReadingKernel(where, np.stack([w.columns for w in waves], axis=1), waves[0].among)


def _of_one(c: Conditions, where: str, count: int = 3) -> Array | None:
    """Features (n, m) of one condition, None where it is not known or does not vary."""
    values = getattr(c, where)
    if values is None or np.ptp(values) == 0:
        return None
    if where in ("run", "line", "travel"):
        indicator = groups(values)
        return indicator if indicator is not None and indicator.shape[1] <= MOST_GROUPS else None
    return smooth(values, SMOOTH if where == "s" and count == 3 else count)


def _wave(phase: Array) -> Array:
    return np.column_stack([np.cos(phase), np.sin(phase)])
