"""What the force sensor shows of a contact: gain, leakage, bias, drift, lag and noise (docs/virtual_grinding.md, Sensor)."""

import numpy as np

from ocp.simulate.twin.contact.moments import ContactMoments, ContactResult
from ocp.simulate.twin.contact.timing import delayed, memory
from ocp.simulate.twin.truth.machine import Truth
from robots.pose import Array

FILTER = 5e-4  # s, time constant of the sensor's own filter
SLOW_SHARE, SLOW_TIME = 0.4, 0.03  # variance and correlation time s of the noise that is not white


def read_sensor(truth: Truth, result: ContactResult, c: ContactMoments, rng: np.random.Generator) -> tuple[Array, Array]:
    """Readings fn, ft (n,) N: ft is signed along axis x outward wheel radial at the contact."""
    late = sum(effect.number("s") for effect in truth.planted("time_delay"))
    normal, tangential = (_filtered(delayed(f, c, late), c) for f in (result.force, result.tangential))
    leak = sum(effect.number("leak") for effect in truth.planted("tangential_force"))
    leak += sum(effect.number("share") for effect in truth.planted("sensor_crosstalk"))
    gain = 1 + sum(effect.number("scale") for effect in truth.planted("sensor_gain"))
    offset = truth.sensor_bias + sum(effect.number("N") for effect in truth.planted("sensor_bias"))
    drift = sum(effect.number("N_per_h") for effect in truth.planted("sensor_drift"))
    fn = gain * (normal + leak * tangential) + offset + drift * c.campaign_time() / 3600.0
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


def _filtered(values: Array, c: ContactMoments) -> Array:
    """Values behind the sensor's filter, started at rest at each run's first value."""
    restart = np.zeros(len(values), bool)
    first = np.empty(len(values))
    for run in c.runs():
        restart[run.start] = True
        first[run] = values[run.start]
    return np.asarray(first + memory(values - first, c.time_s, restart, FILTER))
