"""What is late: the arm on its path by a length, the logger by a time, anything with a memory by a time constant."""

from dataclasses import replace
from itertools import pairwise

import numpy as np

from ocp.simulate.twin.contact.moments import ContactMoments
from ocp.simulate.twin.truth.machine import Truth
from robots.pose import Array

STANDING = 1e-9  # m between rows: less is no motion


def lagging(truth: Truth, c: ContactMoments) -> ContactMoments:
    """The moments with arm and contact where they were a length of path earlier (path_lag), at each run's start where it begins.

    Setpoint, clock and speeds stay those of the instant. Rows should be no farther apart than the path is straight.
    """
    length = sum(effect.number("m") for effect in truth.planted("path_lag"))
    if not length:
        return c
    where = np.arange(len(c.s), dtype=float)
    for run in c.runs():
        for piece in _in_contact(c, run):
            where[piece] = piece.start + _earlier(c.s[piece], length)
    low = np.floor(where).astype(np.int64)
    high = np.minimum(low + 1, len(where) - 1)
    share = where - low

    def between(values: Array) -> Array:
        weight = share.reshape(-1, *(1,) * (values.ndim - 1))
        return np.asarray(np.where(weight > 0, (1 - weight) * values[low] + weight * values[high], values[low]))

    return replace(
        c, T_base_flange=between(c.T_base_flange), arm_compliance=between(c.arm_compliance),
        p=between(c.p), n=between(c.n), t=between(c.t), s=between(c.s),
    )  # fmt: skip


def _in_contact(c: ContactMoments, run: slice) -> list[slice]:
    """Stretches of a run that stay on one line in contact."""
    cut = np.flatnonzero((np.diff(c.line[run]) != 0) | np.diff(c.contact[run])) + 1
    edges = np.concatenate([[0], cut, [run.stop - run.start]]) + run.start
    return [slice(int(a), int(b)) for a, b in pairwise(edges) if c.contact[a]]


def _earlier(s: Array, length: float) -> Array:
    """Fractional index (n,) at which the path travelled so far was shorter by `length` m."""
    way = np.concatenate([[0.0], np.cumsum(np.abs(np.diff(s)))])
    moving = np.concatenate([[True], np.diff(way) > STANDING])
    index = np.flatnonzero(moving).astype(float)
    return np.interp(np.maximum(way - length, 0.0), way[moving], index)


def delayed(values: Array, c: ContactMoments, seconds: float) -> Array:
    """Values (n,) as a logger shows them that is behind by `seconds` or shows them later, inside each run."""
    out = values.copy()
    for run in c.runs():
        out[run] = np.interp(c.time_s[run] - seconds, c.time_s[run], values[run])
    return out


def memory(signal: Array, time: Array, restart: Array, tau: float) -> Array:
    """q with dq/dt = (signal - q) / tau from q = 0 at each restart, exact for a signal that is straight between rows."""
    q = np.zeros_like(signal)
    step = np.diff(time, prepend=time[:1])
    decay = np.exp(-np.maximum(step, 0.0) / tau)
    # Response to a straight line from a to b over the step: b - (b - a) tau/step (1 - decay) - a decay.
    ramp = np.where(step > 1e-12, tau * (1 - decay) / np.where(step > 1e-12, step, 1.0), 1.0)
    value = 0.0
    for k in range(len(q)):
        if restart[k]:
            value = 0.0
        else:
            a, b = signal[k - 1], signal[k]
            value = decay[k] * value + b - (b - a) * ramp[k] - a * decay[k]
        q[k] = value
    return q
