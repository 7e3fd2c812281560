"""A predicted reading seen earlier or later in its run."""

import numpy as np

from ocp.effects.context import LogRows
from robots.pose import Array


def shifted_by_time(x: LogRows, signal: Array, delay: float) -> Array:
    """Change (n, k) of `signal` (n,) or (n, k) when it comes `delay` s late, per second of delay; nothing where its run holds no
    row so early."""
    signal = signal.reshape(len(signal), -1)
    out = np.zeros(signal.shape)
    for run in np.unique(x.run):
        at = np.flatnonzero(x.run == run)
        out[at] = (_between(x.time[at] - delay, x.time[at], signal[at]) - signal[at]) / delay
    return out


def shifted_by_path(x: LogRows, signal: Array, lag: float) -> Array:
    """Change (n, k) of `signal` (n,) or (n, k) when the motion is `lag` m behind along its way, per metre; a run's way is the
    integral of its feed."""
    signal = signal.reshape(len(signal), -1)
    out = np.zeros(signal.shape)
    for run in np.unique(x.run):
        at = np.flatnonzero(x.run == run)
        steps = 0.5 * (x.feed[at][1:] + x.feed[at][:-1]) * np.diff(x.time[at])
        way = np.append(0.0, np.cumsum(steps))
        if way[-1] <= 0:
            continue
        out[at] = (_between(way - lag, way, signal[at]) - signal[at]) / lag
    return out


def _between(at: Array, known: Array, values: Array) -> Array:
    """Values (n, k) known at ascending `known` (n,), linearly between them, the first and the last beyond."""
    if values.shape[1] == 1:
        return np.interp(at, known, values[:, 0])[:, None]
    if len(known) < 2:
        return values
    high = np.clip(np.searchsorted(known, at), 1, len(known) - 1)
    gap = known[high] - known[high - 1]
    share = np.clip(np.divide(at - known[high - 1], gap, out=np.zeros(len(at)), where=gap > 0), 0.0, 1.0)[:, None]
    return np.asarray((1.0 - share) * values[high - 1] + share * values[high])
