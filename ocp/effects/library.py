"""All effects: every module of this package that defines EFFECT."""

import importlib
import pkgutil
from functools import cache

import ocp.effects
from ocp.effects.effect import Effect


@cache
def library() -> dict[str, Effect]:
    """Effects by name, in alphabetical order of their files. A new file is enough to add one."""
    found = {}
    for module in sorted(m.name for m in pkgutil.iter_modules(ocp.effects.__path__)):
        effect = getattr(importlib.import_module(f"ocp.effects.{module}"), "EFFECT", None)
        if effect is not None:
            found[effect.name] = effect
    return found
