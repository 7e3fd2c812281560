"""Which effects worlds may hold, by kind of world and signals; what in an effect is a size, and how large sizes usually are."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from ocp.blindtest.worlds import outside_first
from ocp.blindtest.worlds.outside import Outside
from ocp.blindtest.worlds.outside_late import LATE
from ocp.blindtest.worlds.recipes import Recipe
from ocp.simulate.twin.truth.kinds import ARM_KINDS, CONTACT_KINDS, EFFECT_KINDS, EffectKind, Key
from ocp.simulate.twin.truth.planting import Planted, Value

SIGNALS = ("tracker", "force", "both")
# Keys that say where, when or how fast an effect acts; all others are sizes, and readings are linear in them to first order.
SHAPES = ("phase_rad", "order", "source_joint", "target", "at_s", "lever_link1_m", "lever_arm_m", "hz", "tau", "leak")
PLANTABLE = tuple(kind for kind in ARM_KINDS if kind.name != "channel_delay")  # a tracker's reading at rest has no delay
# Of the arm's effects those that move a force log which was taught on the machine, and are no matter of registration.
IN_LOG = ("backlash", "friction_windup", "joint_thermal", "link_thermal", "base_tilt", "wrist_coupling", "joint_compliance")
OUTSIDE: dict[str, Outside] = {**outside_first.ON_ARM, **outside_first.ON_GRINDING, **LATE}
"""Every effect outside the catalogue, of both lists."""
_OF_ARM = frozenset(kind.name for kind in ARM_KINDS)


def pool_of(recipe: Recipe, signals: str) -> tuple[EffectKind, ...]:
    """Kinds that may be planted in a world of `recipe`."""
    if recipe.kind in ("outside", "outside_late"):
        first = outside_first.ON_ARM if signals == "tracker" else outside_first.ON_GRINDING
        return tuple(one.kind for one in (LATE if recipe.kind == "outside_late" else first).values())
    if signals == "tracker":
        return PLANTABLE
    return (*CONTACT_KINDS, *(k for k in PLANTABLE if signals == "both" or k.name in IN_LOG))


def kind_of(effect: str) -> EffectKind:
    """The kind of an effect inside or outside the catalogue."""
    return OUTSIDE[effect].kind if effect in OUTSIDE else EFFECT_KINDS[effect]


def of_arm(effects: Sequence[Planted]) -> tuple[Planted, ...]:
    """Those of the catalogue's effects that a tracker sees."""
    return tuple(p for p in effects if p.effect in _OF_ARM)


def upper_end(key: Key, joint: int | None) -> float:
    """Upper end of a key's usual range at a joint."""
    return max(abs(key.low), abs(key.high)) * (key.scale[(joint or 1) - 1] if key.scale else 1.0)


def share_of_range(planted: Planted) -> float:
    """Size of an effect's first key as a share of its upper end."""
    key = kind_of(planted.effect).keys[0]
    return float(np.linalg.norm(planted.vector(key.name))) / upper_end(key, planted.joint)


def is_wave(effect: str) -> bool:
    """Whether an effect has an amplitude and a phase: two coefficients."""
    return any(key.name == "phase_rad" for key in kind_of(effect).keys)


def coefficient_count(effect: str) -> int:
    """How many coefficients an effect's size has: two of a wave, three of a vector."""
    return 2 if is_wave(effect) else kind_of(effect).keys[0].length


def scaled(planted: Planted, factor: float) -> Planted:
    """The effect with all its sizes times `factor`."""
    return replace(planted, values={k: v if k in SHAPES else _times(v, factor) for k, v in planted.values.items()})


def _times(value: Value, factor: float) -> Value:
    if isinstance(value, str):
        return value
    return tuple(factor * v for v in value) if isinstance(value, tuple) else factor * value


def within_range(planted: Planted) -> bool:
    """Whether no size is above the upper end of its range; smaller ones are as likely as not (DIAGNOSIS, catalogue)."""
    for key in kind_of(planted.effect).keys:
        if key.name not in SHAPES and key.unit != "name":
            if float(np.linalg.norm(planted.vector(key.name))) > upper_end(key, planted.joint) * (1 + 1e-9):
                return False
    return True
