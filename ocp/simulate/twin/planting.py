"""Effects planted in the virtual cell: one with its values, reading and drawing them.

Names and keys are the catalogue's and part of the data contract: labels of data sets and diagnoses use the same.
"""

import re
from collections.abc import Sequence
from dataclasses import dataclass
from difflib import get_close_matches
from typing import Any

import numpy as np

from ocp.simulate.twin.kinds import EFFECT_KINDS, EffectKind, Key
from robots.errors import BadInput, shown

Value = float | tuple[float, ...] | str
LISTED = "`python -m ocp.simulate --list-effects` lists all"

LONGEST_EFFECT = 200  # characters of an effect as it is written
UNUSUAL = 1e4  # times the usual size: beyond, a unit is wrong


@dataclass(frozen=True)
class Planted:
    """One effect with its joint, or None, and the values of all its keys."""

    effect: str
    joint: int | None
    values: dict[str, Value]

    def number(self, key: str) -> float:
        """The value of a key that is one number."""
        value = self.values[key]
        if isinstance(value, str | tuple):
            raise TypeError(f"{self.effect}.{key} is no number")
        return float(value)

    def vector(self, key: str) -> "np.ndarray[Any, np.dtype[np.float64]]":
        """The value of a key as an array (length,)."""
        return np.atleast_1d(np.asarray(self.values[key], float))

    def word(self, key: str) -> str:
        """The value of a key that is a name."""
        return str(self.values[key])


def parse_effect(text: str) -> Planted:
    """An effect as a user writes it: `backlash:5=2e-4`, `gear_harmonic:4=8e-5,order=19`, `payload_com=0.01/0/0.02`.

    The number behind the first `=` is the size, other keys follow by name, vectors stand with `/`. Keys left out take their
    default or the middle of their range. Raises BadInput in one sentence.
    """
    if len(text) > LONGEST_EFFECT:
        raise BadInput(f"effect '{shown(text)}': has {len(text)} characters, the limit is {LONGEST_EFFECT}; shorten it")
    head, _, tail = text.strip().partition("=")
    name, colon, number = head.partition(":")
    kind = _kind(text, name.strip())
    joint = _joint(text, kind, number.strip() if colon else None)
    given = _given(text, kind, tail)
    values = {key.name: _read(text, key, given[key.name]) if key.name in given else middle(key, joint) for key in kind.keys}
    if "source_joint" in values:
        values["source_joint"] = _source(text, kind, joint, values["source_joint"], "source_joint" in given)
    return Planted(kind.name, joint, values)


def _kind(text: str, name: str) -> EffectKind:
    if name not in EFFECT_KINDS:
        near = get_close_matches(name, EFFECT_KINDS, 1, 0.4)
        hint = f"the nearest is '{near[0]}'; " if near else ""
        raise BadInput(f"effect '{text}': there is no effect '{name}'; {hint}{LISTED}")
    return EFFECT_KINDS[name]


def _joint(text: str, kind: EffectKind, number: str | None) -> int | None:
    if not kind.joints:
        if number is not None:
            raise BadInput(f"effect '{text}': {kind.name} belongs to no joint; write {kind.name}=SIZE")
        return None
    allowed = ", ".join(map(str, kind.joints))
    if number is None:
        if kind.common:
            return None
        if len(kind.joints) == 1:
            return kind.joints[0]
        raise BadInput(f"effect '{text}': {kind.name} needs a joint ({allowed}); write {kind.name}:{kind.joints[0]}=SIZE")
    if not re.fullmatch(r"\d{1,3}", number, re.ASCII) or int(number) not in kind.joints:
        raise BadInput(f"effect '{text}': {kind.name} is not of joint '{number}'; choose from {allowed}")
    return int(number)


def _source(text: str, kind: EffectKind, joint: int | None, source: Value, given: bool) -> float:
    """The joint that another one follows; one that is not given is not the joint itself."""
    others = [float(i) for i in kind.joints if i != joint]
    if given and source not in others:
        own = "the joint itself" if source == joint else "no such joint"
        raise BadInput(f"effect '{text}': source_joint {source:g} is {own}; give another of {', '.join(map(str, kind.joints))}")
    return float(source) if isinstance(source, float) and source in others else others[0]


def _given(text: str, kind: EffectKind, tail: str) -> dict[str, str]:
    """Texts of the keys that are given."""
    found: dict[str, str] = {}
    for i, part in enumerate(p.strip() for p in tail.split(",")) if tail.strip() else ():
        name, equals, value = (p.strip() for p in part.partition("="))
        if not equals:
            if i > 0:
                raise BadInput(f"effect '{text}': '{part}' names no key; write key=value after the first number")
            name, value = kind.keys[0].name, name
        names = [key.name for key in kind.keys]
        if name not in names:
            raise BadInput(f"effect '{text}': {kind.name} has no key '{name}'; its keys are {', '.join(names)}")
        if name in found:
            raise BadInput(f"effect '{text}': key '{name}' is given twice; remove one")
        found[name] = value
    return found


def _read(text: str, key: Key, value: str) -> Value:
    if key.unit == "name":
        if not value:
            raise BadInput(f"effect '{text}': {key.name} is empty; give a name")
        return value
    try:
        numbers = [float(part) for part in value.split("/")]
    except ValueError:
        raise BadInput(f"effect '{text}': {key.name} = '{value}' is not a number, as in 2e-4; correct it") from None
    if not np.isfinite(numbers).all():
        raise BadInput(f"effect '{text}': {key.name} = '{value}' is not finite; correct it")
    most = UNUSUAL * max(abs(key.low), abs(key.high), abs(key.default or 0.0))
    if max(map(abs, numbers)) > most:
        raise BadInput(f"effect '{text}': {key.name} = '{shown(value)}' is beyond {most:g}; is it in SI units?")
    if min(numbers) < 0 < key.low and not key.signed:
        raise BadInput(f"effect '{text}': {key.name} = '{value}' is negative, which it never is; correct it")
    if len(numbers) != key.length:
        form = "/".join(["1e-4", "0", "0"][: key.length])
        raise BadInput(
            f"effect '{text}': {key.name} = '{value}' has {len(numbers)} numbers, {key.length} are needed; write it as {form}"
        )
    if key.integer and numbers[0] != round(numbers[0]):
        raise BadInput(f"effect '{text}': {key.name} = '{value}' must be a whole number; round it")
    return numbers[0] if key.length == 1 else tuple(numbers)


def middle(key: Key, joint: int | None) -> Value:
    """What a key takes that is not given: its default, else the middle of its range (geometric unless drawn evenly)."""
    if key.unit == "name":
        return "T1"
    even = key.uniform or key.low <= 0
    size = 0.5 * (key.low + key.high) if even else float(np.sqrt(key.low * key.high))
    size = (size if key.default is None else key.default) * _scale(key, joint)
    if key.length == 3:
        return (size, 0.0, 0.0)
    return float(round(size)) if key.integer else size


def _scale(key: Key, joint: int | None) -> float:
    return key.scale[joint - 1] if key.scale and joint is not None else 1.0


def draw_effect(
    rng: np.random.Generator, kind: EffectKind, joint: int | None = None, targets: Sequence[str] = ("T1",)
) -> Planted:
    """An effect of a kind at random: joint, sizes inside their typical range, signs and directions; `targets` are the nests."""
    if joint is None and kind.joints and not kind.common:
        joint = int(rng.choice(kind.joints))
    values: dict[str, Value] = {}
    for key in kind.keys:
        values[key.name] = str(rng.choice(list(targets))) if key.unit == "name" else _drawn(rng, key, joint)
    if "source_joint" in values:
        values["source_joint"] = float(rng.choice([i for i in kind.joints if i != joint]))
    planted = Planted(kind.name, joint, values)
    if "lever_arm_m" in values:
        values["lever_link1_m"], values["lever_arm_m"] = _levers(rng, planted.number("stiffness_N_m"))
    return planted


def _drawn(rng: np.random.Generator, key: Key, joint: int | None) -> Value:
    even = key.uniform or key.low <= 0
    size = rng.uniform(key.low, key.high) if even else np.exp(rng.uniform(np.log(key.low), np.log(key.high)))
    size = float(size) * _scale(key, joint)
    if key.length == 3:
        direction = rng.normal(size=3)
        return tuple((size * direction / np.linalg.norm(direction)).tolist())
    if key.signed:
        size *= float(rng.choice([-1.0, 1.0]))
    return float(round(size)) if key.integer else size


# Torque k a b of a balancer, N m: below, it balances nothing; above, it would lift the arm (own weight 4.7 kN m, PHYSICS 2.5).
BALANCER_TORQUE = (300.0, 4500.0)


def _levers(rng: np.random.Generator, stiffness: float) -> tuple[float, float]:
    """Levers a, b m in 0.1..0.6 with which a spring is a balancer."""
    while True:
        a, b = np.exp(rng.uniform(np.log(0.1), np.log(0.6), 2))
        if BALANCER_TORQUE[0] <= stiffness * a * b <= BALANCER_TORQUE[1]:
            return float(a), float(b)


def labels(planted: Sequence[Planted]) -> list[dict[str, Any]]:
    """What was planted, in the form of a data set's labels.json: effect, joint (None: of no joint), then every key."""
    found = []
    for one in planted:
        label: dict[str, Any] = {"effect": one.effect, "joint": one.joint}
        kind = EFFECT_KINDS.get(one.effect)
        whole = {key.name for key in kind.keys if key.integer} if kind is not None else set()
        for name, value in one.values.items():
            label[name] = list(value) if isinstance(value, tuple) else int(value) if name in whole else value
        found.append(label)
    return found
