"""The catalogue: all effects by name, and as text for the commands, their help and the site's page of effects."""

import importlib
import os
import pkgutil
import traceback
from collections.abc import Iterable
from dataclasses import replace
from functools import cache
from pathlib import Path

import ocp.effects
from ocp.effects.effect import Effect
from ocp.shell.cache import OWN_EFFECTS
from robots.errors import BadInput, shown

HOOKS = ("joint", "torque", "twist", "reading", "overlap", "push", "sensor", "shear", "along", "along_shear")


def library() -> dict[str, Effect]:
    """Effects by name, in alphabetical order of their files: every module of this package that defines EFFECT, and of the folder
    that the environment names. A new file is enough to add one.

    Raises BadInput: the folder of own effects is none, has a file or an effect named as one of the catalogue's, one that fails,
    or one without EFFECT (a helper's name begins with an underscore).
    """
    return _library(os.environ.get(OWN_EFFECTS, ""), tuple(ocp.effects.__path__))


@cache
def _library(own: str, places: tuple[str, ...]) -> dict[str, Effect]:
    names = {m.name for m in pkgutil.iter_modules(places)}
    added: set[str] = set()
    if own:
        if not Path(own).is_dir():
            raise BadInput(f"{OWN_EFFECTS}={own}: no such folder; give the folder that holds your effects' files")
        added = {m.name for m in pkgutil.iter_modules([own])}
        if own not in places and (twice := sorted(names & added)):
            raise BadInput(f"{Path(own) / twice[0]}.py: the catalogue has a file of this name; give yours another")
        if own not in places:
            ocp.effects.__path__.append(own)
    found: dict[str, Effect] = {}
    for module in sorted(names - added):
        if (effect := _effect_of(module)) is not None:
            found[effect.name] = effect
    for module in sorted(name for name in added if name[0] != "_"):
        effect = _own_effect(Path(own) / f"{module}.py")
        if effect.name in found:
            raise BadInput(f"{Path(own) / module}.py: there is an effect '{effect.name}' already; give yours another name")
        found[effect.name] = effect
    return found if not added else dict(sorted(found.items()))


def _effect_of(name: str) -> Effect | None:
    """EFFECT of a module of this package, its physics where it tells none the module's docstring; None without one."""
    module = importlib.import_module(f"ocp.effects.{name}")
    effect = getattr(module, "EFFECT", None)
    return replace(effect, physics=effect.physics or module.__doc__ or "") if isinstance(effect, Effect) else None


def _own_effect(file: Path) -> Effect:
    """EFFECT of a file that somebody wrote. Raises BadInput: it has a fault, or none is defined."""
    try:
        effect = _effect_of(file.stem)
    except Exception as error:  # whatever that file does
        own = [frame.lineno for frame in traceback.extract_tb(error.__traceback__) if Path(frame.filename) == file]
        line = error.lineno if isinstance(error, SyntaxError) else next(iter(own), None)
        told = error.msg if isinstance(error, SyntaxError) else f"{type(error).__name__}: {error}"
        raise BadInput(f"{file}, line {line}: {shown(told, 200)}; correct it") from error
    if effect is None:
        raise BadInput(f"{file}: defines no EFFECT; define one, or begin the name of a file of helpers with an underscore")
    return effect


def forget_library() -> None:
    """The next caller reads the files anew."""
    _library.cache_clear()


def effects_table() -> str:
    """Markdown: what every effect is, its keys with usual ranges, where it enters the model, its physics and their source."""
    lines = ["| effect, joints | keys, usual range | enters by (column needed) | what it is |", "|---|---|---|---|"]
    for effect in library().values():
        hooks = ", ".join(h for h in HOOKS if getattr(effect, h) is not None)
        needs = f" ({', '.join(effect.needs)})" if effect.needs else ""
        physics = " ".join((effect.physics.partition("\n\n")[2] or effect.physics).split())  # below a docstring's first line
        joints = joint_range(effect.joints, least_run=3, between=", ")
        joints = (f" {joints}" if joints else "") + (" or common" if 0 in effect.joints else "")
        lines.append(f"| {effect.name}{joints} | {'; '.join(_usual(effect))} | {hooks}{needs} | {physics} |")
    return "\n".join(line.replace("|tau|", "abs(tau)").replace("|b - a|", "abs(b - a)") for line in lines)


def effect_list() -> str:
    """One line an effect for a terminal: name and joints, signals that may show it, keys with usual ranges."""
    rows = []
    for effect in library().values():
        joints = joint_range(effect.joints, least_run=2, between=",")
        rows.append((effect.name + (f":{joints}" if joints else ""), _signals(effect), "; ".join(_usual(effect))))
    width = max(len(row[0]) for row in rows)
    return "\n".join(f"{name:<{width}}  {signals:<22}  {keys}" for name, signals, keys in rows)


def _usual(effect: Effect) -> list[str]:
    """Its keys with usual ranges and units."""
    return [key_range(p.key, p.low, p.high, p.signed and p.low >= 0, p.length, p.unit) for p in effect.parameters]


def key_range(key: str, low: float, high: float, either_sign: bool, length: int = 1, unit: str = "1") -> str:
    """A key with its usual range: 'per_K +-5e-06..0.0002 1/K', without a unit that ends its name; the key alone where it holds a
    name."""
    if high == 0:
        return key
    count, sign = f" ({length})" if length > 1 else "", "+-" if either_sign else ""
    known = unit == "1" or key.replace("_per_", "/") == unit or key.endswith("_" + unit)
    return f"{key}{count} {sign}{low:g}..{high:g}" + ("" if known else f" {unit}")


def joint_range(joints: Iterable[int], least_run: int, between: str) -> str:
    """Joints above zero as '1-6' where at least `least_run` of them follow each other, else one by one; '' for none."""
    own = [j for j in joints if j > 0]
    run = len(own) >= least_run and own == list(range(own[0], own[-1] + 1))
    return f"{own[0]}-{own[-1]}" if run else between.join(map(str, own))


def _signals(effect: Effect) -> str:
    """Signals that may show an effect."""
    signals = ["tracker", "force"] if effect.on_arm else []
    signals += ["joints"] if effect.joint is not None else []
    signals += ["tracker"] if effect.reading is not None and not effect.on_arm else []
    return " ".join(dict.fromkeys(signals + (["force"] if effect.on_contact else [])))
