"""What the force sensor shows of a contact: gain, leakage, bias, drift and noise (docs/virtual_grinding.md, Sensor); and what is
late: the arm on its path by a length, the logger by a time, anything with a memory by a time constant.
"""

from dataclasses import replace
from itertools import pairwise
from typing import Any

import numpy as np

from ocp.simulate.twin.contact import ContactMoments, ContactResult, Index
from ocp.simulate.twin.truth import Truth
from robots.pose import Array

STANDING = 1e-9  # m between rows: less is no motion


def lagging(truth: Truth, c: ContactMoments) -> ContactMoments:
    """The moments with arm and contact where they were a length of path earlier (path_lag), at each run's start where it begins.

    Setpoint, clock and speeds stay those of the instant. Rows should be no farther apart than the path is straight.
    """
    length = truth.total("path_lag", "m")
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

    moved = ("T_base_flange", "arm_compliance", "p", "n", "t", "s")
    arrays: dict[str, Any] = {name: between(getattr(c, name)) for name in moved}
    return replace(c, **arrays)


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


def delayed(values: Array, run: Array | Index, time_s: Array, seconds: float) -> Array:
    """Values (n,) as a logger shows them that is behind by `seconds`, each run for itself; before a run's first value it holds
    that value."""
    late = np.array(values, float)
    for label in np.unique(run):
        rows = np.flatnonzero(run == label)
        late[rows] = np.interp(time_s[rows] - seconds, time_s[rows], values[rows])
    return late


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


def behind(values: Array, time: Array, tau: float) -> Array:
    """Values (n,) behind a first-order low-pass that had held the first of them for ever."""
    restart = np.arange(len(time)) == 0
    return np.asarray(values[0] + memory(values - values[0], time, restart, tau))


FILTER = 5e-4  # s, time constant of the sensor's own filter
SLOW_SHARE, SLOW_TIME = 0.4, 0.03  # variance and correlation time s of the noise that is not white


def read_sensor(truth: Truth, result: ContactResult, c: ContactMoments, rng: np.random.Generator) -> tuple[Array, Array]:
    """Readings fn, ft (n,) N: ft is signed along axis x outward wheel radial at the contact."""
    late = truth.total("time_delay", "s")
    normal, tangential = (delayed(f, c.run, c.time_s, late) for f in (result.force, result.tangential))
    for run in c.runs():
        normal[run], tangential[run] = (behind(f[run], c.time_s[run], FILTER) for f in (normal, tangential))
    leak = truth.total("tangential_force", "leak") + truth.total("sensor_crosstalk", "share")
    offset = truth.sensor_bias + truth.total("sensor_bias", "N")
    drift = truth.total("sensor_drift", "N_per_h") * c.campaign_time() / 3600.0
    fn = (1 + truth.total("sensor_gain", "scale")) * (normal + leak * tangential) + offset + drift
    return fn + noise(truth.sensor_sigma, c, rng), tangential + noise(truth.sensor_sigma, c, rng)


def noise(sigma: float, c: ContactMoments, rng: np.random.Generator) -> Array:
    """Noise (n,) N of standard deviation sigma: white, and a part that decays with SLOW_TIME along each run."""
    white, kicks = rng.normal(size=(2, len(c.s)))
    slow = np.empty(len(c.s))
    for run in c.runs():
        keep = np.exp(-np.maximum(np.diff(c.time_s[run], prepend=-np.inf), 0.0) / SLOW_TIME)
        fresh = np.sqrt(1 - keep**2) * kicks[run]
        value = 0.0
        for k in range(len(fresh)):
            value = keep[k] * value + fresh[k]
            slow[run.start + k] = value
    return np.asarray(sigma * (np.sqrt(1 - SLOW_SHARE) * white + np.sqrt(SLOW_SHARE) * slow))
