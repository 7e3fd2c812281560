"""Effects as a cell file holds them: `[[effects]]` tables to coefficients with covariance and back.

[[effects]]
effect = "backlash"
joint = 5
half_width_rad = 2.1e-4
sd = { half_width_rad = 4e-6 }          # optional: one sigma of keys
"""

from collections.abc import Mapping
from dataclasses import dataclass
from difflib import get_close_matches
from typing import Any

import numpy as np

from ocp.effects.catalogue import library
from ocp.effects.effect import Active, Effect, Parameter, effect_named
from ocp.effects.patch import PATCH, patch_of
from ocp.shell.cache import OWN_EFFECTS
from robots.errors import shown
from robots.pose import Array

UNUSUAL = 1e4  # times the upper end of the usual range: beyond, a unit is wrong
MOST_NUMBERS = 1000  # of one key: a profile over a blade
RESERVED = ("effect", "joint", "sd")


@dataclass(frozen=True)
class CellEffect:
    """An effect with values as plain data: name, joint (0: none), coefficients a (m,) with covariance (m, m), scanned values."""

    name: str
    joint: int
    a: Array
    scanned: dict[str, Any]
    covariance: Array

    @property
    def active(self) -> Active:
        """With the effect of the library."""
        return Active(effect_named(self.name), self.joint, self.a, self.scanned, self.covariance)

    @property
    def word(self) -> str:
        """As a cell's file calls it."""
        return self.active.effect.title if self.name.startswith(PATCH) else self.name


def effect_of(table: Mapping[str, Any]) -> CellEffect:
    """The effect that an `[[effects]]` table describes. Raises ValueError, a sentence: unknown effect, joint or key, a value
    that is missing or of the wrong kind."""
    effect = _known_effect(str(table.get("effect", "")))
    joint = _joint(effect, table.get("joint"))
    keys = {p.key: p for p in effect.parameters}
    given = {key: value for key, value in table.items() if key not in RESERVED and value is not None}
    for key in given:
        if key not in keys:
            raise ValueError(f"effect '{effect.name}' has no key '{shown(key)}'; its keys are {', '.join(keys)}")
    values = {key: _value(effect, keys[key], value) for key, value in given.items()}
    try:
        a, scanned = effect.coefficients_of(values)
    except KeyError as missing:
        raise ValueError(f"effect '{effect.name}' needs the key '{missing.args[0]}'; add it") from None
    if not (np.isfinite(a).all() and all(np.isfinite(v) for v in scanned.values() if isinstance(v, float))):
        raise ValueError(f"effect '{effect.name}' has a value that is not a finite number; correct it")
    sd = table.get("sd") or {}
    for key in sd:
        if key not in values or keys[key].unit == "name" or key in scanned:
            raise ValueError(
                f"effect '{effect.name}' has sd.{shown(key)}, which is no value of this table that can have one; remove it"
            )
    return CellEffect(effect.name, joint, np.asarray(a, float), dict(scanned), _covariance(effect, values, sd))


def patch_effect_of(table: Mapping[str, Any]) -> CellEffect:
    """The patch that a `[[patches]]` table describes, as an effect of the cell. Raises ValueError, a sentence."""
    one = patch_of(table)
    return CellEffect(one.effect.name, one.joint, one.a, dict(one.scanned), one.covariance)


def table_of(active: Active) -> dict[str, Any]:
    """The `[[effects]]` table of an effect with values, sd included where there is a covariance."""
    table: dict[str, Any] = {"effect": active.effect.name}
    if active.joint:
        table["joint"] = active.joint
    table |= {key: _plain(value) for key, value in active.parameters.items()}
    sd = {key: _plain(value) for key, value in active.deviations.items() if np.any(np.asarray(value) > 0)}
    return table | ({"sd": sd} if sd else {})


def _known_effect(name: str) -> Effect:
    effects = library()
    if name not in effects:
        near = get_close_matches(name, effects, 3)
        own = f"one of your own is found in the folder that {OWN_EFFECTS} names; known: "
        told = "near it: " + ", ".join(near) if near else own + ", ".join(sorted(effects))
        raise ValueError(f"unknown effect '{shown(name)}'; {told}")
    return effects[name]


def _joint(effect: Effect, joint: Any) -> int:
    if not effect.joints:
        if joint is not None:
            raise ValueError(f"effect '{effect.name}' belongs to no joint; remove joint")
        return 0
    allowed = [j for j in effect.joints if j > 0]
    if joint is None and 0 in effect.joints:
        return 0
    if joint is None and len(allowed) == 1:
        return allowed[0]
    if joint not in allowed:
        told = "is missing" if joint is None else f"= {shown(joint)} is not possible"
        raise ValueError(f"effect '{effect.name}': joint {told}; give one of {', '.join(map(str, allowed))}")
    return int(joint)


def _value(effect: Effect, parameter: Parameter, value: Any) -> Any:
    if parameter.unit == "name":
        if not isinstance(value, str) or not value:
            raise ValueError(f"effect '{effect.name}': {parameter.key} = {shown(repr(value))} is not a name")
        return value
    numbers = value if isinstance(value, list | tuple) else [value]
    plain = all(isinstance(v, int | float) and not isinstance(v, bool) for v in numbers)
    listed, count = isinstance(value, list | tuple), parameter.length
    if not plain or listed != (count != 1) or (count > 0 and len(numbers) != count):
        wanted = "a number" if count == 1 else f"a list of {count or ''} numbers".replace("  ", " ")
        raise ValueError(f"effect '{effect.name}': {parameter.key} = {shown(repr(value))} is not {wanted}")
    most = _most(parameter)
    if len(numbers) > MOST_NUMBERS or any(abs(v) > most for v in numbers):
        raise ValueError(
            f"effect '{effect.name}': {parameter.key} = {shown(repr(value))} is beyond {most:g}, {UNUSUAL:g} times the usual; "
            "is it in SI units?"
        )
    return [float(v) for v in numbers] if listed else value


def _most(parameter: Parameter) -> float:
    """The largest value of a parameter, either sign."""
    return UNUSUAL * max(abs(parameter.low), abs(parameter.high))


def _covariance(effect: Effect, values: dict[str, Any], sd: Mapping[str, Any]) -> Array:
    """Covariance (m, m) of the coefficients when the keys' deviations are independent: by differences of the inverse."""
    out = np.zeros((effect.size, effect.size))
    most = {p.key: _most(p) for p in effect.parameters}
    for key, given in sd.items():
        size = np.atleast_1d(np.asarray(values[key], float)).size
        spread = np.broadcast_to(np.asarray(given, float), (size,))
        if not (np.isfinite(spread).all() and (spread >= 0).all() and (spread <= most[key]).all()):
            raise ValueError(
                f"effect '{effect.name}': sd.{key} = {shown(repr(given))} is not zero or above, or beyond {most[key]:g}"
            )
        for i in np.flatnonzero(spread > 0):
            moved = []
            for sign in (1.0, -1.0):
                other = np.atleast_1d(np.array(values[key], float))
                other[i] += sign * 1e-3 * spread[i]
                changed = other.tolist() if isinstance(values[key], list) else float(other[0])
                moved.append(effect.coefficients_of(values | {key: changed})[0])
            column = (moved[0] - moved[1]) / 2e-3
            out += np.outer(column, column)
    return out


def _plain(value: Any) -> Any:
    """Numbers and lists that TOML and JSON can hold."""
    if isinstance(value, np.ndarray | list | tuple):
        return [_plain(v) for v in value]
    return value.item() if isinstance(value, np.generic) else value
