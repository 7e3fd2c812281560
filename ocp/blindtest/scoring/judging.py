"""When an answer is right: names within declared classes, sets, values."""

from collections.abc import Sequence
from typing import Any

import numpy as np

from ocp.blindtest.oracle.oracle import Name
from ocp.simulate.twin.truth.planting import Planted

SURE = 1.6449  # standard deviations of a 90 % interval
KAB = ("stiffness_N_m", "lever_link1_m", "lever_arm_m")  # readings hold the product of a balancer's spring and levers


def read_name(text: str) -> Name:
    """`gear_1x:3` or `payload_mass` of an answer's classes."""
    effect, _, joint = text.partition(":")
    return effect, int(joint or 0)


def names_by_probability(document: dict[str, Any]) -> list[tuple[Name, float]]:
    """Names with their marginal probabilities, most probable first."""
    return [((r["effect"], r["joint"] or 0), float(r["probability"])) for r in document["ranking"]]


def declared_classes(document: dict[str, Any]) -> list[set[Name]]:
    """Declared classes of names that cannot be told apart."""
    return [{read_name(text) for text in group} for group in document["indistinguishable"]]


def alike(a: Name, b: Name, groups: Sequence[set[Name]]) -> bool:
    """Whether a name stands for another: the same, or of one class."""
    return a == b or any(a in g and b in g for g in groups)


def decided_names(document: dict[str, Any]) -> list[Name]:
    """What the answer decides for: the effects of its best explanation, none where having no effect is more probable."""
    best = max(document["explanations"], key=lambda e: e["probability"], default=None)
    if best is None or document["p_none"] >= max(best["probability"], document["p_unknown"]):
        return []
    return [(e["effect"], e["joint"] or 0) for e in best["effects"]]


def matched(planted: Sequence[Name], said: Sequence[Name], groups: Sequence[set[Name]]) -> int:
    """How many of the planted are named, each name used once: the same ones first, then those of one class."""
    left, count, missing = list(said), 0, []
    for one in planted:
        if one in left:
            left.remove(one)
            count += 1
        else:
            missing.append(one)
    for one in missing:
        twin = next((s for s in left if alike(one, s, groups)), None)
        if twin is not None:
            left.remove(twin)
            count += 1
    return count


def first_right(planted: Sequence[Name], names: Sequence[Name], groups: Sequence[set[Name]], within: int) -> bool:
    """Whether one of the first `within` names is one of the planted."""
    return any(alike(p, s, groups) for p in planted for s in names[:within])


def value_errors(planted: Planted, parameters: dict[str, Any]) -> tuple[float | None, list[float]]:
    """Relative error of the size (None where the answer has no such key), and deviations in standard errors of everything that
    has one."""
    error, z = None, []
    for k, (key, true) in enumerate(planted.values.items()):
        given = parameters.get(key)
        if given is None or isinstance(true, str):
            continue
        mean, sd = _pair(given, key, parameters)
        real = np.atleast_1d(np.asarray(true, float)) * _levers(key, planted.values)
        off = np.atleast_1d(mean) - real
        if key == "phase_rad":
            off = (off + np.pi) % (2 * np.pi) - np.pi
        if k == 0:
            error = float(np.linalg.norm(off) / np.linalg.norm(real))
        if sd is not None and np.all(np.atleast_1d(sd) > 0):
            z += [float(v) for v in off / np.atleast_1d(sd)]
    return error, z


def _pair(given: dict[str, Any], key: str, parameters: dict[str, Any]) -> tuple[Any, Any]:
    """Mean and standard deviation; of a balancer's product with its levers."""
    factor = _levers(key, {k: p["value"] for k, p in parameters.items()})
    mean = np.asarray(given["value"], float) * factor
    return mean, None if given["sd"] is None else np.asarray(given["sd"], float) * factor


def _levers(key: str, known: dict[str, Any]) -> float:
    if key != KAB[0] or not all(k in known for k in KAB):
        return 1.0
    return float(known[KAB[1]]) * float(known[KAB[2]])
