"""A predicted reading seen earlier or later in its run."""

import numpy as np

from ocp.effects.context import LogRows
from robots.pose import Array


def shifted_by_time(x: LogRows, signal: Array, delay: float) -> Array:
    """Change (n, 1) of `signal` (n,) when it comes `delay` s late, per second of delay; nothing where its run holds no row so
    early."""
    out = np.zeros((len(signal), 1))
    for run in np.unique(x.run):
        at = np.flatnonzero(x.run == run)
        out[at, 0] = (np.interp(x.time[at] - delay, x.time[at], signal[at]) - signal[at]) / delay
    return out


def shifted_by_path(x: LogRows, signal: Array, lag: float) -> Array:
    """Change (n, 1) of `signal` (n,) when the motion is `lag` m behind along its way, per metre; a run's way is the integral of
    its feed."""
    out = np.zeros((len(signal), 1))
    for run in np.unique(x.run):
        at = np.flatnonzero(x.run == run)
        steps = 0.5 * (x.feed[at][1:] + x.feed[at][:-1]) * np.diff(x.time[at])
        way = np.append(0.0, np.cumsum(steps))
        if way[-1] <= 0:
            continue
        out[at, 0] = (np.interp(way - lag, way, signal[at]) - signal[at]) / lag
    return out
