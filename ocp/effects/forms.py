"""Forms that effects share: places of coefficients, waves, steps in time, keys to coefficients and back."""

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import casadi as ca
import numpy as np

from ocp.effects.context import LogRows
from ocp.effects.effect import Scanned, Surroundings, amplitude_and_phase, cosine_and_sine
from robots.pose import Array

Values = Callable[[Array, Scanned], dict[str, Any]]
Coefficients = Callable[[Mapping[str, Any]], tuple[Array, dict[str, Any]]]
INSTANTS = 40  # a step's instant is sought at so many places: it misses by at most one reading in eighty
HOUR = 3600.0  # s


def at_joint(joint: int, *columns: Any) -> ca.SX:
    """(6, m) that is zero but for row `joint`."""
    out = ca.SX.zeros(6, len(columns))
    for i, value in enumerate(columns):
        out[joint - 1, i] = value
    return out


def row(*columns: Any) -> ca.SX:
    """(1, m)."""
    return ca.horzcat(*(ca.SX(c) for c in columns))


def after(time: ca.SX, instant: Any) -> ca.SX:
    """0 before an instant, 1 from it on."""
    return ca.if_else(time >= instant, 1.0, 0.0)


def one(key: str) -> dict[str, Any]:
    """values and coefficients_of where the only coefficient is the parameter itself."""
    return several(key)


def several(*keys: str) -> dict[str, Any]:
    """values and coefficients_of where coefficients are the parameters in this order."""
    return {
        "values": lambda a, scanned: {key: float(a[i]) for i, key in enumerate(keys)},
        "coefficients_of": lambda values: (np.array([float(values[key]) for key in keys]), {}),
    }


def scanned_with(keys: tuple[str, ...], *scanned_keys: str) -> dict[str, Any]:
    """As `several`, with scanned values that are parameters too."""
    return {
        "values": lambda a, scanned: {key: float(a[i]) for i, key in enumerate(keys)} | {k: scanned[k] for k in scanned_keys},
        "coefficients_of": lambda values: (np.array([float(values[key]) for key in keys]), {k: values[k] for k in scanned_keys}),
    }


def vectors(keys: tuple[str, ...], *scanned_keys: str) -> dict[str, Any]:
    """values and coefficients_of of vectors (3) one after the other, with scanned values that are parameters too."""

    def values(a: Array, scanned: Scanned) -> dict[str, Any]:
        parts = {key: [float(v) for v in a[3 * i : 3 * i + 3]] for i, key in enumerate(keys)}
        return parts | {k: scanned[k] for k in scanned_keys}

    def coefficients_of(values: Mapping[str, Any]) -> tuple[Array, dict[str, Any]]:
        a = np.concatenate([np.asarray(values[key], float).reshape(3) for key in keys])
        return a, {k: values[k] for k in scanned_keys}

    return {"values": values, "coefficients_of": coefficients_of}


def wave(amplitude: str, *scanned_keys: str) -> dict[str, Any]:
    """values and coefficients_of of A cos(x + phase) = a0 cos x + a1 sin x."""

    def values(a: Array, scanned: Scanned) -> dict[str, Any]:
        size, phase = amplitude_and_phase(a)
        return {k: scanned[k] for k in scanned_keys} | {amplitude: size, "phase_rad": phase}

    def coefficients_of(values: Mapping[str, Any]) -> tuple[Array, dict[str, Any]]:
        a = cosine_and_sine(float(values[amplitude]), float(values["phase_rad"]))
        return a, {k: values[k] for k in scanned_keys}

    return {"values": values, "coefficients_of": coefficients_of}


def share(key: str) -> dict[str, Any]:
    """values and coefficients_of of a factor 1 + x that divides: the coefficient a = x / (1 + x) enters linearly."""
    return {
        "values": lambda a, scanned: {key: float(a[0] / max(1.0 - a[0], 1e-3))},
        "coefficients_of": lambda values: (np.array([values[key] / (1.0 + values[key])]), {}),
    }


def instants(time: Array) -> Array:
    """At most INSTANTS candidates between distinct times (n,) s, evenly over the readings."""
    distinct = np.unique(np.asarray(time, float)[np.isfinite(time)])
    middle = 0.5 * (distinct[1:] + distinct[:-1])
    if len(middle) <= INSTANTS:
        return middle
    return np.asarray(middle[np.unique(np.linspace(0, len(middle) - 1, INSTANTS).round().astype(int))])


def steps(joint: int, seen: Surroundings) -> Sequence[Scanned]:
    """Variants of a step's instant at_s."""
    return [{"at_s": float(t)} for t in instants(seen.time)]


def steps_between_runs(joint: int, seen: Surroundings) -> Sequence[Scanned]:
    """Instants between runs and sessions where known, else anywhere."""
    return [{"at_s": float(t)} for t in (np.asarray(seen.breaks) if len(seen.breaks) else instants(seen.time))][: 4 * INSTANTS]


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
