"""What the effects of a cell depend on, for the rows of a force log (`ocp.effects.engine.symbolic.CONDITIONS`)."""

import numpy as np

from ocp.calibrate.force.log import ForceLog, Index
from ocp.effects.engine.symbolic import CONDITIONS
from ocp.model.cell import Cell
from robots.pose import Array

STILL = 1e-4  # rad/s; an axis slower than this stands


def effect_conditions(cell: Cell, log: ForceLog) -> Array:
    """Columns (n, 24) for the rows of a log; (n, 0) for a cell without effects.

    What the log does not say is the cell's `[conditions]`; without a clock the wheel wears while it is in contact. The stroke
    rate of the flange is not logged: its friction is left out.
    """
    n, own = len(log), cell.conditions
    if not cell.effects:
        return np.zeros((n, 0))
    along = _length(log) if log.s is None else log.s
    speed, rate = _rate(log, log.q), _rate(log, along[:, None])[:, 0]
    reference = cell.tables.reference_temperature_C
    clock = own.clock + _contact_time(log) if log.clock is None else log.clock
    setpoint = cell.process.force if cell.flange is None else cell.flange.setpoint
    blocks = {
        "approach": np.where(np.abs(speed) > STILL, np.sign(speed), 0.0), "speed": speed, "s": along, "time": clock,
        "feed": np.maximum(np.abs(rate), 1e-3) if log.feed is None else log.feed, "clock": clock, "stroke_sign": 0.0,
        "line": 0.0 if log.line is None else log.line.astype(float), "travel": np.where(rate < 0, -1.0, 1.0),
        "ground_before": float(own.ground_before) if log.ground_before is None else log.ground_before.astype(float),
        "warm": own.warm if log.temperature is None else log.temperature - reference,
        "wheel_warm": own.wheel_warm if log.wheel_temperature is None else log.wheel_temperature - reference,
        "setpoint": setpoint if log.setpoint is None else log.setpoint,
        "belt": cell.wheel.belt_speed if log.belt is None else log.belt,
    }  # fmt: skip
    return CONDITIONS.stack(n, blocks)


def _runs(log: ForceLog) -> list[Index]:
    return [np.flatnonzero(log.run == run) for run in np.unique(log.run)]


def _rate(log: ForceLog, values: Array) -> Array:
    """Time derivative (n, k) inside each run."""
    out = np.zeros_like(values)
    for at in _runs(log):
        if len(at) > 1 and (np.diff(log.time[at]) > 0).all():
            out[at] = np.gradient(values[at], log.time[at], axis=0)
    return out


def _length(log: ForceLog) -> Array:
    """Arc length (n,) m since the start of each run."""
    out = np.zeros(len(log))
    for at in _runs(log):
        out[at[1:]] = np.cumsum(np.linalg.norm(np.diff(log.p[at], axis=0), axis=1))
    return out


def _contact_time(log: ForceLog) -> Array:
    """Seconds (n,) in contact since the log's start."""
    step = np.zeros(len(log))
    same = log.run[1:] == log.run[:-1]
    step[1:][same] = np.diff(log.time)[same]
    return np.asarray(np.cumsum(step * log.contact))
