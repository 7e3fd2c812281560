"""Conditions of a force log's rows: where along the pass, which way each axis moves, how long the wheel ran, how warm it is.

`log_conditions` has what the log says; `effect_conditions` completes it by the cell's own, laid out for the effects in the model.
"""

from dataclasses import dataclass, fields
from typing import Any

import numpy as np

from ocp.calibrate.force.log import Flags, ForceLog, Index
from ocp.effects.engine.symbolic import CONDITIONS
from ocp.model.cell import Cell
from robots.pose import Array

STILL = 1e-4  # rad/s; an axis slower than this stands
# What a log may lack, as `ForceLog` names it.
OPTIONAL = {
    **{"s_mm": "s", "ft_N": "ft", "feed_mm_s": "feed", "belt_m_s": "belt", "line": "line", "ground_before": "ground_before"},
    **{"temperature_C": "temperature", "wheel_temperature_C": "wheel_temperature", "clock_s": "clock"},
}
LEAST_FEED = 1e-3  # m/s; effects divide by the feed


@dataclass(frozen=True)
class LogConditions:
    """Of n rows: s m along the pass; travel sign of ds/dt; approach (n, 6) signs of the axes' motion, speed (n, 6) rad/s; feed
    m/s, belt m/s, setpoint N; clock s (contact time so far where the log has none); ground_before; warm, wheel_warm K above the
    cell's reference; run, line; time s in the run. What a log does not say is nan; given: the columns that it has."""

    run: Index
    line: Index
    time: Array
    s: Array
    travel: Array
    approach: Array
    speed: Array
    feed: Array
    belt: Array
    setpoint: Array
    clock: Array
    ground_before: Array
    warm: Array
    wheel_warm: Array
    contact: Flags
    given: frozenset[str]

    def take(self, rows: Any) -> "LogConditions":
        """The rows of an index or mask."""
        values = {f.name: getattr(self, f.name) for f in fields(self)}
        return LogConditions(**{k: v[rows] if isinstance(v, np.ndarray) else v for k, v in values.items()})


def log_conditions(cell: Cell, log: ForceLog, used: float = 0.0) -> LogConditions:
    """Conditions of a log's rows; `used` s: how long the wheel ground before it, for logs without a clock."""
    n = len(log)
    s = _along(log) if log.s is None else log.s
    rate_s, rate_q = _rate(log, s[:, None])[:, 0], _rate(log, log.q)
    unknown = np.full(n, np.nan)
    own = cell.flange.setpoint if cell.flange is not None else cell.process.force
    setpoint = log.setpoint if log.setpoint_sd is None else None
    optional = {column: getattr(log, name) for column, name in OPTIONAL.items()} | {"setpoint_N": setpoint}
    given = frozenset({"time_s", "approach", "speed", *(name for name, column in optional.items() if column is not None)})
    if len(log.sessions) > 1:
        given |= {"session"}
    reference = cell.tables.reference_temperature_C
    return LogConditions(
        run=log.run,
        line=np.zeros(n, np.int64) if log.line is None else log.line,
        time=log.time,
        s=s,
        travel=np.where(rate_s < 0, -1.0, 1.0),
        approach=np.where(np.abs(rate_q) > STILL, np.sign(rate_q), 0.0),
        speed=rate_q,
        feed=np.abs(rate_s) if log.feed is None else log.feed,
        belt=np.full(n, cell.wheel.belt_speed) if log.belt is None else log.belt,
        setpoint=np.full(n, own) if log.setpoint is None else log.setpoint,
        clock=used + _contact_time(log) if log.clock is None else log.clock,
        ground_before=unknown if log.ground_before is None else log.ground_before.astype(float),
        warm=unknown if log.temperature is None else log.temperature - reference,
        wheel_warm=unknown if log.wheel_temperature is None else log.wheel_temperature - reference,
        contact=log.contact,
        given=given,
    )


def _along(log: ForceLog) -> Array:
    """Arc length (n,) m from the end of the pass that lies lowest along the blade's longest direction."""
    centred = log.p - log.p.mean(axis=0)
    span = np.linalg.svd(centred[:: max(1, len(centred) // 500)], full_matrices=False)[2][0]
    span = span * np.sign(span[int(np.argmax(np.abs(span)))])
    s = np.zeros(len(log))
    for run in np.unique(log.run):
        at = np.flatnonzero(log.run == run)
        length = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(log.p[at], axis=0), axis=1))])
        up = (log.p[at[-1]] - log.p[at[0]]) @ span >= 0
        s[at] = length if up else length[-1] - length
    return s


def _rate(log: ForceLog, values: Array) -> Array:
    """Time derivative (n, k) inside each run, by central differences."""
    out = np.zeros_like(values)
    for run in np.unique(log.run):
        at = np.flatnonzero(log.run == run)
        if len(at) > 1 and np.all(np.diff(log.time[at]) > 0):
            out[at] = np.gradient(values[at], log.time[at], axis=0)
    return out


def _contact_time(log: ForceLog) -> Array:
    """Seconds (n,) in contact since the log's start."""
    step = np.zeros(len(log))
    same = log.run[1:] == log.run[:-1]
    step[1:][same] = np.diff(log.time)[same]
    return np.asarray(np.cumsum(step * log.contact))


def effect_conditions(cell: Cell, log: ForceLog) -> Array:
    """Columns (n, 24) for the model's effects (`ocp.effects.engine.symbolic.CONDITIONS`); (n, 0) for a cell without effects.

    What the log does not say is the cell's `[conditions]`. The stroke rate of the flange is not logged: its friction is left
    out.
    """
    if not cell.effects:
        return np.zeros((len(log), 0))
    own, c = cell.conditions, log_conditions(cell, log, cell.conditions.clock)
    blocks = vars(c) | {
        "time": c.clock,
        "feed": np.maximum(c.feed, LEAST_FEED) if log.feed is None else c.feed,
        "stroke_sign": 0.0,
        "ground_before": float(own.ground_before) if log.ground_before is None else c.ground_before,
        "warm": own.warm if log.temperature is None else c.warm,
        "wheel_warm": own.wheel_warm if log.wheel_temperature is None else c.wheel_warm,
    }
    return CONDITIONS.stack(len(log), blocks)
