"""A patch: what an effect outside the catalogue does to the arm or the tracker, as a fitted sum of plain features.

A patch explains nothing. It holds where it was measured: with x a feature's conditions, held at the nearest measured ones (but
for what is linear in them), and d(c) the distance of condition c from its measured range in the features' length,

    change = w sum_k a_k f_k(x),      w = exp(-1/2 sum_c d(c)^2)                                                      (1)

so that it fades out beyond. The length is that over which the finest feature of c changes: 1 / k rad of a wave of k per turn; of
the range that c covers a kth (at most SOFT) for k half waves over it, and for its kth power. It enters as a turn of one joint
(source "joint"), as a tilt of its axis about the two directions across it that stand still in the link before or turn with the
joint ("axis still", "axis turning"), as a displacement of the tracker's frame ("frame") or of its readings along, aside and above
the beam ("beam along", ..), as a force along the contact's normal ("force"), or as what the normal reading shows beside it
("sensor"). Features are products of factors, written as "approach3 * cos 2 q3":

    cos k c, sin k c     of an angle c        wave k c     cos(pi k x) / (1 + (k / 4)^2), x = 0..1 over c's range
    power p c            of c over its largest size        c alone: c itself        is NAME: 1 where that payload hangs
    line k               1 on that line of the blade        approachN, travel, is and line stand alone

Conditions: q1..q6 rad; approach1..6; tau1..6 N m load torque; mx1..6, my1..6 N m moment of all weight beyond an axis about x and
y of the link before it; settling20, settling60, settling200: exp(-t / 20 s) and so on, t the time since the motion to where the
arm stands began (0 in a program, whose arm moves on); warm K above the cell's reference temperature; time s; range m, azimuth
rad (from the middle of what was measured), elevation rad of a reflector seen from the tracker. Of a contact: q1..q6, s m along
the pass, travel +-1, feed m/s, belt m/s, setpoint N, warm, wheel K above the reference, time s of the campaign's clock.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import lru_cache
from typing import Any

import casadi as ca
import numpy as np

from ocp.effects.context import SETTLING, ArmContext, ContactContext, TrackerContext
from ocp.effects.effect import Active, Effect, Scanned
from ocp.effects.forms import at_joint, hanging_moment
from robots.errors import shown
from robots.pose import Array

PATCH = "patch "  # effects of this name are made, not listed
ON_ARM = ("joint", "axis still", "axis turning")
ON_BEAM = ("beam along", "beam aside", "beam above")
ON_CONTACT = ("force", "sensor")
SOURCES = (*ON_ARM, "frame", *ON_BEAM, *ON_CONTACT)
SOFT = 4.0  # wave number at which a smooth function's prior has fallen to half
GONE = 5.0  # lengths from which a patch is not there
MOST_FEATURES = 64
MOST_WEIGHT, MOST_PUSH = 0.1, 1e3  # rad or m, N
COLUMNS = {"warm": "temperature_C", "wheel": "wheel_temperature_C", "time": "clock_s", "line": "line"}  # by conditions
COLUMNS |= {"feed": "feed_mm_s", "setpoint": "setpoint_N", "belt": "belt_m_s"}
_OF_JOINTS = ("approach", "tau", "mx", "my", "q")
_OF_STANDING = tuple(f"settling{s:.0f}" for s in SETTLING)
_OF_BEAM = ("range", "azimuth", "elevation")
_ALONE = ("warm", "time", *_OF_BEAM)
_OF_GRINDING = ("s", "travel", "feed", "belt", "setpoint", "wheel")
_OF_CONTACT = (*_OF_GRINDING, "line", "warm", "time", *(f"q{j}" for j in range(1, 7)))
_NUMBERED = ("cos", "sin", "wave", "power")

Condition = Callable[[str], Any]
Factor = tuple[str, float, str]  # form, number, condition or name


def feature_factors(feature: str) -> list[Factor]:
    """Factors of a feature. Raises ValueError, a sentence."""
    found: list[Factor] = []
    for text in feature.split(" * "):
        word, _, rest = text.strip().partition(" ")
        if word == "is" and rest:
            found.append(("is", 1.0, rest))
            continue
        if word == "line" and rest.isdecimal():
            found.append(("line", float(rest), "line"))
            continue
        number, _, name = rest.partition(" ")
        try:
            one = (word, float(number), name) if word in _NUMBERED else ("itself", 1.0, text.strip())
        except ValueError:
            one = ("", 0.0, "")
        sign = (one[2].startswith("approach") or one[2] == "travel") and one[0] != "itself"
        whole = one[0] == "power" and one[1] not in (1.0, 2.0, 3.0)
        if not known_condition(one[2]) or not 0.0 < one[1] <= 1e4 or whole or sign:
            raise ValueError(f"feature '{shown(feature)}' is none; write e.g. 'cos 2 q3', 'approach3 * cos 1 q3' or 'is bare'")
        found.append(one)
    return found


def known_condition(name: str) -> bool:
    """Whether features may vary with it."""
    return name in (*_ALONE, *_OF_STANDING, *_OF_GRINDING) or any(name == f"{one}{j}" for one in _OF_JOINTS for j in range(1, 7))


def conditions_of(features: Sequence[str]) -> tuple[str, ...]:
    """What features vary with between limits, each once: signs and names of payloads have none."""
    names = [name for feature in features for form, _, name in feature_factors(feature) if form != "is"]
    return tuple(dict.fromkeys(n for n in names if not n.startswith("approach") and n != "travel"))


def columns_of(features: Sequence[str]) -> tuple[str, ...]:
    """Columns that say what features vary with, where it is not always known."""
    found = set()
    for form, _, name in (factor for feature in features for factor in feature_factors(feature)):
        found |= {"payload"} if form == "is" else {COLUMNS[name]} if name in COLUMNS else set()
        found |= {"approach"} if name.startswith("approach") else {"time_s"} if name in _OF_STANDING else set()
    return tuple(sorted(found))


def span(measured: tuple[float, float]) -> float:
    """Length of a measured range, one where it has none."""
    return measured[1] - measured[0] or 1.0


def lengths(scanned: Scanned) -> dict[str, float]:
    """Length of each condition that has a range, over which the finest feature of it changes."""
    found = {name: span((low, high)) for name, low, high in scanned["range"]}
    for form, number, name in (factor for feature in scanned["features"] for factor in feature_factors(feature)):
        if name in found and form != "line":
            whole = next(span((low, high)) for n, low, high in scanned["range"] if n == name)
            found[name] = min(found[name], 1.0 / number if form in ("cos", "sin") else whole / min(number, SOFT))
    return found


def _limits(scanned: Scanned) -> dict[str, tuple[float, float]]:
    return {name: (low, high) for name, low, high in scanned["range"]}


def _value(factor: Factor, x: Condition, limits: Mapping[str, tuple[float, float]]) -> Any:
    """A factor at the nearest measured condition."""
    form, number, name = factor
    if form == "line":
        return x("line") == number
    if form == "is" or name not in limits:
        return x(f"is {name}" if form == "is" else name)
    low, high = limits[name]
    if (form, number) == ("power", 1.0):
        return x(name) / (max(abs(low), abs(high)) or 1.0)
    at = ca.fmin(ca.fmax(x(name), low), high)
    if form in ("cos", "sin"):
        return getattr(ca, form)(number * at)
    if form == "wave":
        return ca.cos(np.pi * number * (at - low) / span((low, high))) / (1.0 + (number / SOFT) ** 2)
    return (at / (max(abs(low), abs(high)) or 1.0)) ** number if form == "power" else at


def _features(x: Condition, scanned: Scanned) -> list[Any]:
    """All features with their fading (eq. 1)."""
    limits, faded, length = _limits(scanned), 0.0, lengths(scanned)
    for name, (low, high) in limits.items():
        off = ca.fmax(ca.fmax(x(name) - high, low - x(name)), 0.0) / length[name]
        faded = faded + off**2
    fades = limits and not scanned.get("stays")
    weight = ca.exp(-0.5 * ca.fmin(faded, GONE**2)) if fades else 1.0
    found = []
    for feature in scanned["features"]:
        product = weight
        for factor in feature_factors(feature):
            product = product * _value(factor, x, limits)
        found.append(product)
    return found


def conditions_of_arm(x: ArmContext) -> Condition:
    """Conditions by name at an instant of the arm."""

    def value(name: str) -> Any:
        if name.startswith("is "):
            return x.is_payload(name[3:])
        if name in ("warm", "time"):
            return getattr(x, name)
        if name in _OF_STANDING:
            return x.settling[_OF_STANDING.index(name)]
        kind, j = name[:-1], int(name[-1])
        return moment(x, j)[kind == "my"] if kind in ("mx", "my") else getattr(x, kind)[j - 1]

    return value


def moment(x: ArmContext, joint: int) -> tuple[Any, Any]:
    """Moments N m of all weight beyond an axis about x and y of the link before it."""
    before, total = x.frames[joint - 1], hanging_moment(x, joint)
    return ca.dot(total, before[:3, 0]), ca.dot(total, before[:3, 1])


def _tilts(x: ArmContext, joint: int, scanned: Scanned) -> dict[int, ca.SX]:
    """Small turns about the two directions across an axis, every direction with every feature."""
    before, turned = x.frames[joint - 1], x.frames[joint][:3, 0]
    about = [before[:3, 0], before[:3, 1]]
    if scanned["source"] == "axis turning":
        z = before[:3, 2]
        across = turned - ca.dot(turned, z) * z
        across = across / ca.norm_2(across)
        about = [across, ca.cross(z, across)]
    columns = [ca.vertcat(ca.SX.zeros(3), direction * f) for direction in about for f in _features(conditions_of_arm(x), scanned)]
    return {joint - 1: ca.horzcat(*columns)}


def _reading(x: TrackerContext, joint: int, scanned: Scanned) -> ca.SX:
    """Displacements of a reading in the tracker's frame."""
    flat, distance = ca.norm_2(x.point[:2]), ca.norm_2(x.point)
    middle, mean_flat, mean_distance = scanned.get("about", (0.0, 1.0, 1.0))
    turned = ca.atan2(x.point[1], x.point[0]) - middle
    seen = {
        "range": distance,
        "azimuth": ca.atan2(ca.sin(turned), ca.cos(turned)),
        "elevation": ca.atan2(x.point[2], flat),
        "time": x.time,
        "warm": x.warm,
    }
    features = _features(lambda name: seen[name], scanned)
    if scanned["source"] == "frame":
        return ca.horzcat(*(ca.SX.eye(3)[:, i] * f for i in range(3) for f in features))
    along = x.point / distance
    aside = ca.vertcat(-x.point[1], x.point[0], 0.0) / flat
    above = ca.cross(along, aside) * distance / mean_distance
    direction = dict(zip(ON_BEAM, (along, aside * flat / mean_flat, above), strict=True))[scanned["source"]]
    return ca.horzcat(*(direction * f for f in features))


def _contact(x: ContactContext, joint: int, scanned: Scanned) -> ca.SX:
    """Force along the normal, or what is read beside it."""
    seen = {name: getattr(x, name) for name in (*_OF_GRINDING[:-1], "line", "warm")}
    seen |= {"wheel": x.wheel_warm, "time": x.clock} | {f"q{j + 1}": x.q[j] for j in range(6)}
    return ca.horzcat(*_features(lambda name: seen[name], scanned))


@lru_cache
def patch_effect(name: str) -> Effect:
    """The effect of a patch by its name, 'patch SOURCE|WHERE|coefficients|prior|COLUMN,..': it travels between processes."""
    source, where, count, size, *needs = name.removeprefix(PATCH).split("|")
    names = tuple(f"a{k + 1}" for k in range(int(count)))
    hooks: dict[str, Any] = {"reading": _reading}
    if source == "joint":
        hooks = {"joint": lambda x, j, scanned: at_joint(j, *_features(conditions_of_arm(x), scanned))}
    elif source in ON_ARM:
        hooks = {"twist": _tilts}
    elif source in ON_CONTACT:
        hooks = {"push" if source == "force" else "sensor": _contact}
    return Effect(
        name=name,
        title=f"patch over {where}",
        subsystem={"force": "wheel", "sensor": "sensor"}.get(source, "joint" if source in ON_ARM else "tracker"),
        physics="A correction that explains nothing (docs/diagnosis.md, Patch).",
        parameters=(),
        coefficients=names,
        prior_sd=(float(size),) * len(names),
        values=lambda a, scanned: dict(zip(names, np.asarray(a, float).tolist(), strict=True)),
        coefficients_of=lambda values: (np.array([values[n] for n in names], float), {}),
        needs=tuple(needs[0].split(",")) if needs else (),
        **hooks,
    )


def make_patch(
    source: str,
    where: str,
    joint: int,
    features: Sequence[str],
    measured: Mapping[str, tuple[float, float]],
    size: float,
    signal: str = "tracker",
    **more: Any,
) -> Active:
    """A patch of zero weights with prior sd `size` (rad, m or N) each; measured: ranges of what the features vary with; signal
    that it is learnt from; about: of a beam's patch, azimuth rad, distance over ground and distance m measured on average."""
    count = len(features) * {"frame": 3, "axis still": 2, "axis turning": 2}.get(source, 1)
    scanned = {"signal": signal, "source": source, "features": tuple(features), **more}
    scanned["range"] = tuple((n, float(measured[n][0]), float(measured[n][1])) for n in conditions_of(features))
    needs = ",".join(columns_of(features))
    effect = patch_effect(f"{PATCH}{source}|{where}|{count}|{size:.3g}" + (f"|{needs}" if needs else ""))
    return Active(effect, joint, np.zeros(count), scanned, np.eye(count) * size**2)


def dense_ends(values: Array, near: float, share: float) -> list[float]:
    """The least and the most of values (n,); where these lie far off, of what a `share` of all lies near (of the range)."""
    values = np.sort(values)
    width = near * (values[-1] - values[0])
    count = np.searchsorted(values, values + width, "right") - np.searchsorted(values, values - width)
    kept, ends = values[count >= share * len(values)][[0, -1]], values[[0, -1]]
    return [float(end) for end in np.where(np.abs(kept - ends) > 2.0 * width, kept, ends)]


def within(patch: Active, ranges: Callable[[float], Mapping[str, tuple[float, float]]]) -> Active:
    """The patch as if no more than these ranges of its conditions had been measured; they are asked for by its middle azimuth."""
    measured = ranges(patch.scanned.get("about", (0.0,))[0])
    ends = [(name, max(low, measured[name][0]), min(high, measured[name][1])) for name, low, high in patch.scanned["range"]]
    limits = tuple((name, low, max(low, high)) for name, low, high in ends)
    return replace(patch, scanned={**patch.scanned, "range": limits})


def patch_table(patch: Active, promise: str) -> dict[str, Any]:
    """The `[[patches]]` table of a fitted patch."""
    source, where, *_ = patch.effect.name.removeprefix(PATCH).split("|")
    table: dict[str, Any] = {"signal": patch.scanned["signal"], "where": where, "kernel": source}
    if patch.joint:
        table["joint"] = patch.joint
    table |= {"features": list(patch.scanned["features"]), "weights": [float(v) for v in patch.a]}
    table["covariance"] = [[float(v) for v in row] for row in patch.covariance]
    table["range"] = {name: [low, high] for name, low, high in patch.scanned["range"]}
    table |= {"about": list(patch.scanned["about"])} if "about" in patch.scanned else {}
    return table | {"formula": formula_of(patch), "promise": promise}


def patch_of(table: Mapping[str, Any]) -> Active:
    """The patch of a `[[patches]]` table. Raises ValueError, a sentence."""
    source, joint, where = table["kernel"], table.get("joint") or 0, table["where"]
    if source not in SOURCES:
        raise ValueError(f"kernel '{shown(source)}' is none; known are {', '.join(SOURCES)}")
    if (source in ON_ARM) != bool(joint):
        raise ValueError(f"a patch of kernel '{source}' {'needs a joint' if source in ON_ARM else 'belongs to no joint'}")
    if "|" in where:
        raise ValueError(f"where = '{shown(where)}' of a patch holds a bar; name its conditions")
    _check_conditions(source, table["features"], table["range"])
    a, rows = table["weights"], table["covariance"]
    if not all(len(row) == len(a) for row in rows) or len(rows) != len(a):
        raise ValueError(f"a patch of {len(a)} weights needs a covariance of as many rows and columns")
    a, covariance = np.asarray(a, float), np.asarray(rows, float).reshape(len(a), len(a))
    variance = np.diag(covariance)
    if not (np.isfinite(a).all() and np.isfinite(covariance).all()):
        raise ValueError("weights and covariance of a patch are finite numbers; correct those that are not")
    if not _is_covariance(covariance):
        raise ValueError("the covariance of a patch is symmetric, and no sum of its weights has a negative variance; correct it")
    most, unit = (MOST_PUSH, "N") if source in ON_CONTACT else (MOST_WEIGHT, "rad or m")
    if not (np.abs(a) <= most).all() or (variance > most**2).any():
        raise ValueError(f"weights of a patch and their deviations are at most {most:g} {unit}; are they in SI units?")
    size = max(float(np.sqrt(variance.max(initial=0.0))), float(np.abs(a).max(initial=0.0)), 1e-9)
    more = {"about": tuple(table["about"])} if table.get("about") else {}
    made = make_patch(source, where, joint, table["features"], table["range"], size, table["signal"], **more)
    if len(a) != len(made.a) or not np.isfinite(more.get("about", (0.0,))).all():
        raise ValueError(f"a patch of these features needs {len(made.a)} weights, and finite numbers in about")
    return Active(made.effect, joint, a, made.scanned, covariance)


def _is_covariance(matrix: Array) -> bool:
    """Symmetric and positive semidefinite, to the digits that a file has."""
    size = np.sqrt(np.maximum(np.diag(matrix), 0.0))
    if (np.diag(matrix) < 0).any() or (np.abs(matrix - matrix.T) > 1e-6 * np.outer(size, size)).any():
        return False
    unit = np.where(size > 0, size, 1.0)
    return bool(np.linalg.eigvalsh(matrix / np.outer(unit, unit)).min(initial=0.0) > -1e-6)


def _check_conditions(source: str, features: Sequence[str], measured: Mapping[str, Sequence[float]]) -> None:
    """Raises ValueError, a sentence: a condition that the kernel does not see, or without its range."""
    factors = [factor for feature in features for factor in feature_factors(feature)]
    hung, used = any(form == "is" for form, _, _ in factors), {name for form, _, name in factors if form != "is"}
    if source in ON_CONTACT and (hung or not used <= set(_OF_CONTACT)):
        raise ValueError(f"a patch of kernel '{source}' varies with {', '.join(_OF_CONTACT)} alone")
    if source not in (*ON_ARM, *ON_CONTACT) and (hung or not used <= set(_ALONE)):
        raise ValueError(f"a patch of kernel '{source}' varies with {', '.join(_ALONE)} alone")
    if source in ON_ARM and used & set(_OF_BEAM):
        raise ValueError(f"a patch of kernel '{source}' does not vary with where the tracker stands")
    if source in ON_ARM and used & {"line", *_OF_GRINDING}:
        raise ValueError(f"a patch of kernel '{source}' does not vary with what is ground")
    for name in conditions_of(features):
        low, high = measured.get(name, (np.nan, np.nan))
        if not (np.isfinite(low) and np.isfinite(high) and low <= high):
            raise ValueError(f"range.{name} of a patch is missing or not [lowest, highest]")


def lengths_outside(patch: Active, conditions: Mapping[str, Array]) -> Array:
    """Distance (n,) of conditions (n,) from the measured ones, in the lengths of eq. 1; zero inside."""
    total, length = np.zeros(1), lengths(patch.scanned)
    for name, low, high in patch.scanned["range"]:
        values = conditions[name]
        off = np.maximum(np.maximum(values - high, low - values), 0.0) / length[name]
        total = total + off**2
    return np.sqrt(total)


def is_patch(effect: Effect) -> bool:
    """Whether an effect is a patch."""
    return effect.name.startswith(PATCH)


MOST_TERMS = 4  # of a formula that are told
HINTS = {
    "joint ripple": "a ripple of the gear with a broken number of waves a turn",
    "joint motor": "an error of the motor's encoder or its coupling",
    "joint approach": "play that differs over the turn",
    "joint approach wait": "an axis that comes to rest after its stop; an arm that moves on has nothing of it",
    "joint approach tau": "play or friction that grows with the load",
    "joint tau": "a spring that is not linear",
    "joint tau ripple": "teeth that give with the load",
    "joint payload": "something that the payload brings with it",
    "joint temperature": "warmth of the drive",
    "joint time": "something that settles or creeps",
    "axis q": "an axis that tilts as it turns: a bearing, or what it stands on",
    "axis moment": "an axis that tilts under weight: its bearing gives",
    "axis temperature": "an axis that tilts with warmth",
    "beam range": "the instrument's own scale",
    "beam azimuth": "the instrument's own circle",
    "beam elevation": "the instrument's own circle",
    "force s": "form or stock of the blade along its lines",
    "force s travel": "a guide that sticks along its way",
    "force line": "form or stock of the blade across its lines",
    "force travel": "what the belt drags along",
    "force feed": "what gives way or is ground off while the blade moves by",
    "force setpoint": "a flange that does not bring what it is told",
    "force belt": "a belt whose cut, or whose drag on the cover, goes with its speed",
    "force q": "hoses or cables that pull as the arm turns",
    "force clock": "a belt that wears, or an arm that warms up",
    "force temperature": "warmth of the hall",
    "sensor": "what touches the sensor: friction shows nothing of it",
    "force wheel_temperature": "warmth of the wheel's cover",
}


def hint_of(patch: Active) -> str:
    """What such a dependence may come from, in words."""
    source, where, *_ = patch.effect.name.removeprefix(PATCH).split("|")
    conditions = [part.rstrip("123456").removesuffix(" wave").removesuffix(" period") for part in where.split(" x ")]
    for kept in (conditions, conditions[:1], []):
        if hint := HINTS.get(" ".join([source.split()[0], *kept])):
            return hint
    return "not known"


def formula_of(patch: Active) -> str:
    """The hint, and the largest terms of a fitted patch, urad, um or N."""
    at_contact = patch.scanned["source"] in ON_CONTACT
    unit = "N" if at_contact else "urad" if patch.joint else "um"
    features, a = patch.scanned["features"], (1.0 if at_contact else 1e6) * np.asarray(patch.a, float)
    names = [*features] * (len(a) // len(features))
    order = np.argsort(-np.abs(a))
    source, where, *_ = patch.effect.name.removeprefix(PATCH).split("|")
    what = f"{source} of joint {patch.joint}" if patch.joint and source != "joint" else f"{source} {patch.joint or ''}".strip()
    terms = " ".join(f"{a[k]:+.3g} {names[k]}" for k in order[:MOST_TERMS])
    return f"{what} over {where} (perhaps {hint_of(patch)}): {terms}{' ..' if len(a) > MOST_TERMS else ''} {unit}"
