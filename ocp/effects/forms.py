"""Forms that effects share: places of coefficients, waves, steps in time, keys to coefficients and back.

A form is some of the fields of an `Effect`, given as **form: at least its parameters, coefficients with their prior, and the two
ways between them.
"""

from collections import defaultdict
from collections.abc import Callable, Iterable, Mapping, Sequence
from itertools import product
from typing import Any

import casadi as ca
import numpy as np

from ocp.effects.context import ArmContext, ContactContext, LogRows
from ocp.effects.effect import Parameter, Scanned, Surroundings, amplitude_and_phase, cosine_and_sine, scan_key
from robots.gravity import GRAVITY
from robots.pose import Array

Form = dict[str, Any]  # by name of the field
AT_S = Parameter("at_s", "s", 0.0, 1e5, signed=False)
RATED_TORQUE = np.array([7290.0, 8100.0, 5291.0, 2182.0, 1282.0, 825.0])  # N m at the link side, KR 210 (PHYSICS 2.1)
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


def hanging_moment(x: ArmContext, joint: int) -> ca.SX:
    """Moment (3) N m, base axes, of all weight beyond an axis about the origin of the link before it."""
    total = ca.SX.zeros(3)
    weights = [(i, x.link_mass[i], ca.SX(x.link_com[i])) for i in range(joint, 7)] + [(6, x.payload[0], x.payload[1:4])]
    for link, mass, com in weights:
        lever = x.frames[link][:3, 3] + x.frames[link][:3, :3] @ com - x.frames[joint - 1][:3, 3]
        total += mass * GRAVITY * ca.cross(lever, ca.SX(x.down))
    return total


def after(time: ca.SX, instant: Any) -> ca.SX:
    """0 before an instant, 1 from it on."""
    return ca.if_else(time >= instant, 1.0, 0.0)


def cosines(angle: Any) -> tuple[ca.SX, ca.SX]:
    """What the coefficients of a `wave` are multiplied by."""
    return ca.cos(angle), ca.sin(angle)


def tried(**values: Iterable[Any]) -> Callable[[int, Surroundings], Sequence[Scanned]]:
    """A scan over all combinations of the values of its keys, the last key's the fastest."""
    return lambda joint, seen: [dict(zip(values, one, strict=True)) for one in product(*values.values())]


def proportional(*parameters: Parameter, scanned: Sequence[str] = (), usual: Mapping[str, Any] | None = None) -> Form:
    """Parameters that are coefficients themselves, numbers or vectors one after the other, and `scanned` ones beside them. The
    prior is the far end of the usual range. `usual`: values that a table need not name."""
    own = [p for p in parameters if p.key not in scanned]
    starts = np.cumsum([p.length for p in own])[:-1]

    def values(a: Array, given: Scanned) -> dict[str, Any]:
        parts = {p.key: part.tolist() for p, part in zip(own, np.split(np.asarray(a, float), starts), strict=True)}
        found = {p.key: parts[p.key] if p.length > 1 else parts[p.key][0] for p in own}
        return {p.key: found[p.key] if p.key in found else given[p.key] for p in parameters}

    def coefficients_of(values: Mapping[str, Any]) -> tuple[Array, dict[str, Any]]:
        known = {**(usual or {}), **values}
        a = np.concatenate([np.asarray(known[p.key], float).reshape(p.length) for p in own])
        return a, {key: known[key] for key in scanned}

    names = [p.key if p.length == 1 else f"{p.key}_{k + 1}" for p in own for k in range(p.length)]
    return _form(parameters, names, [max(abs(p.low), abs(p.high)) for p in own for _ in range(p.length)], values, coefficients_of)


def wave(*parameters: Parameter, scanned: Sequence[str] = (), usual: Mapping[str, Any] | None = None) -> Form:
    """A cos(x + phase) = a0 cos x + a1 sin x: of the parameters the only one that is not `scanned` is A, phase_rad follows it."""
    beside = proportional(*parameters, scanned=scanned, usual=usual)
    size = next(p for p in parameters if p.key not in scanned)
    at = parameters.index(size) + 1
    whole = (*parameters[:at], Parameter("phase_rad", "rad", 0.0, 3.15), *parameters[at:])

    def values(a: Array, given: Scanned) -> dict[str, Any]:
        found = dict(given) | dict(zip((size.key, "phase_rad"), amplitude_and_phase(a), strict=True))
        return {p.key: found[p.key] for p in whole}

    def coefficients_of(values: Mapping[str, Any]) -> tuple[Array, dict[str, Any]]:
        return cosine_and_sine(float(values[size.key]), float(values["phase_rad"])), beside["coefficients_of"](values)[1]

    return _form(whole, ("cos", "sin"), (size.high, size.high), values, coefficients_of)


def follows(size: Parameter, among: tuple[int, ...]) -> Form:
    """A joint of `among` that turns with another one of them: `size` times the angle of source_joint."""

    def sources(joint: int, seen: Surroundings) -> Sequence[Scanned]:
        return [{"source_joint": i} for i in among if i != joint]

    source = Parameter("source_joint", "1", among[0], among[-1], signed=False)
    return proportional(size, source, scanned=("source_joint",)) | {
        "joints": among,
        "scan": sources,
        "joint": lambda x, j, scanned: at_joint(j, x.q[int(scanned["source_joint"]) - 1]),
    }


def share(size: Parameter) -> Form:
    """A factor 1 + x that divides: the coefficient a = x / (1 + x) enters linearly, and is below one."""

    def doubt(a: Array, sd: Array, scanned: Scanned) -> str:
        return f"no {size.key} makes so much" if a[0] - 2.0 * sd[0] > 1.0 else ""

    form = _form(
        (size,),
        ("share",),
        (size.high,),
        lambda a, scanned: {size.key: float(a[0] / max(1.0 - a[0], 1e-3))},
        lambda values: (np.array([values[size.key] / (1.0 + values[size.key])]), {}),
    )
    return form | {"doubt": doubt}


def in_units(size: Parameter, unit: float, of: Callable[[int, Surroundings], float]) -> Form:
    """A parameter whose coefficient of one is `of(joint, surroundings)`, so that one prior serves all joints; `unit`: the size of
    one in a table, whose joint says nothing."""

    def scan(joint: int, seen: Surroundings) -> Sequence[Scanned]:
        return ({"unit": of(joint, seen)},)

    form = _form(
        (size,),
        ("share",),
        (1.0,),
        lambda a, scanned: {size.key: float(a[0] * scanned["unit"])},
        lambda values: (np.array([values[size.key] / unit]), {"unit": unit}),
    )
    return form | {"scan": scan, "symbolic": ("unit",)}


def late(size: Parameter, about: Sequence[float], least: float, shifted: Callable[[LogRows, Array, float], Array]) -> Form:
    """Forces that come late by `size`: their shift is exact at the sizes `about`, to first order about them."""

    def own_size(a: Array) -> Scanned:
        return {"size": max(abs(float(a[0])), least)}

    form = proportional(size)
    back = form["coefficients_of"]
    return form | {
        "coefficients_of": lambda values: (back(values)[0], own_size(back(values)[0])),
        "own_size": own_size,
        "scan": tried(size=about),
        "along": lambda x, j, scanned: shifted(x, x.fn, scanned["size"]),
        "along_shear": lambda x, j, scanned: shifted(x, x.ft, scanned["size"]),
    }


def moved_at_once(overlap: Callable[[ContactContext], ca.SX]) -> Form:
    """A frame that is shifted by m (3) from at_s on, between two runs where they are known; `overlap` (1, 3) per metre."""
    form = proportional(Parameter("m", "m", 5e-5, 5e-4, length=3), AT_S, scanned=("at_s",))
    form |= {"needs": ("clock_s",), "scan": steps_between_runs, "symbolic": ("at_s",)}
    return form | {"overlap": lambda x, j, scanned: after(x.clock, scanned["at_s"]) * overlap(x)}


def _form(
    parameters: Sequence[Parameter],
    coefficients: Sequence[str],
    prior_sd: Sequence[float],
    values: Callable[[Array, Scanned], dict[str, Any]],
    coefficients_of: Callable[[Mapping[str, Any]], tuple[Array, dict[str, Any]]],
) -> Form:
    form: Form = {"parameters": tuple(parameters), "coefficients": tuple(coefficients), "prior_sd": tuple(prior_sd)}
    return form | {"values": values, "coefficients_of": coefficients_of}


def rated_torque(joint: int, seen: Surroundings) -> float:
    """N m at the link side of joint 1..6, a KR 210's where the robot has none of its own."""
    known = seen.torque_max is not None and np.isfinite(seen.torque_max).all()
    return float((seen.torque_max if seen.torque_max is not None and known else RATED_TORQUE)[joint - 1])


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
    """Instants between runs and sessions where known, else anywhere; the first row too where a break is given there."""
    known = np.asarray(seen.breaks, float)
    inside = len(known) and known.max() > np.nanmin(seen.time)
    return [{"at_s": float(t)} for t in (known if inside else np.append(known, instants(seen.time)))][: 4 * INSTANTS]


def odds_of_instants(scans: Sequence[Scanned], time: Array) -> Array:
    """Log prior odds (V,) of variants over equal ones; time (n,) s: of the readings, on the clock of at_s.

    What happens at once comes with the work, at any of the instants alike, or with time, as likely as the gap between readings
    that an instant lies in is long. Both weigh the same. How long nobody looked before the first reading is not known: as long
    as all of them took. Where there is more than at_s (a nest, a side), in each case for itself; what grows slowly has no
    instant.
    """
    odds, known = np.zeros(len(scans)), np.unique(time[np.isfinite(time)])
    cases = defaultdict[tuple[Any, ...], list[int]](list)
    for v, s in enumerate(scans if len(known) > 1 else ()):
        if "at_s" in s and s.get("until_s", s["at_s"]) <= s["at_s"]:
            cases[scan_key({k: w for k, w in s.items() if k not in ("at_s", "until_s")})].append(v)
    gaps = np.concatenate([[np.ptp(known)], np.diff(known), [0.0]]) if cases else np.empty(0)
    for rows in cases.values():
        lasted = gaps[np.searchsorted(known, [scans[v]["at_s"] for v in rows])]
        odds[rows] = np.log(0.5 + 0.5 * len(rows) * lasted / lasted.sum()) if lasted.any() else 0.0
    return odds


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
