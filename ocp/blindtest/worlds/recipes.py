"""What kinds of worlds a blind check holds, and in which order (every prefix of it holds the same mixture); and which effects a
kind may hold, what in an effect is a size, and how large sizes usually are.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from ocp.blindtest.worlds.outside import Outside
from ocp.blindtest.worlds.outside_lists import LATE, ON_ARM, ON_GRINDING
from ocp.simulate.twin.planting import ARM_KINDS, CONTACT_KINDS, EFFECT_KINDS, EffectKind, Key, Planted, Value
from robots.errors import BadInput

# Kind of world: how many of it in a round.
ROUND = {"single": 8, "none": 2, "none_background": 2, "pair": 2, "triple": 1, "outside": 2, "left_out": 2}
KINDS = tuple(ROUND)
ASKED = {"outside_late": 4}  # only where --kinds asks for it, so that runs with all kinds stay what they were
BEYOND = ("outside", "left_out", "outside_late")  # what the library that answers does not hold
WORDS = {
    "single": "one effect of the catalogue",
    "none": "no effect, and no ripple, play or gross readings either",
    "none_background": "no effect, on a machine as real ones are",
    "pair": "two effects at once",
    "triple": "three effects at once",
    "outside": "an effect outside the catalogue",
    "outside_late": "an effect of the second list outside the catalogue",
    "left_out": "an effect whose family is taken from the library",
}
BINS = ((15.0, 30.0), (30.0, 50.0), (50.0, 100.0), (100.0, 1000.0))
"""Ranges of the detectability index; the last is open in the tables."""
SEVERAL = (50.0, 400.0)  # of each of two or three effects, given the others
STRANGE = (100.0, 600.0)  # of an effect that the library does not hold


@dataclass(frozen=True)
class Recipe:
    """World `index` (from 1): its kind, the how-manieth of that kind (from 0), the range its detectability is drawn from."""

    index: int
    kind: str
    turn: int
    target: tuple[float, float] | None

    @property
    def name(self) -> str:
        """Of its folder."""
        return f"{self.index:05d}"

    @property
    def effects(self) -> int:
        """How many are planted."""
        return {"none": 0, "none_background": 0, "pair": 2, "triple": 3}.get(self.kind, 1)


def check_kinds(text: str, signals: str = "tracker") -> tuple[str, ...]:
    """Kinds of a list with commas. Raises BadInput: one that is not known, or that these signals do not have."""
    every = (*KINDS, *ASKED)
    kinds = tuple(dict.fromkeys(part.strip() for part in text.split(",") if part.strip()))
    for kind in kinds:
        if kind not in every:
            raise BadInput(f"--kinds: there is no kind '{kind}'; choose from {', '.join(every)}")
        if kind in ASKED and signals != "tracker":
            raise BadInput(f"--kinds: '{kind}' has no effects of the force log; leave it out or give --signals tracker")
    if not kinds:
        raise BadInput(f"--kinds is empty; choose from {', '.join(every)}")
    return kinds


def recipes(worlds: int, kinds: tuple[str, ...] = KINDS) -> list[Recipe]:
    """The first `worlds` recipes: kinds spread evenly over each round, single effects through all bins one after another."""
    # One round: the i-th of c worlds of a kind stands at (i + 1/2) / c of it.
    weights = ROUND | ASKED
    places = sorted(((i + 0.5) / weights[k], list(weights).index(k), k) for k in kinds for i in range(weights[k]))
    counts = dict.fromkeys(kinds, 0)
    found = []
    for index in range(worlds):
        kind = places[index % len(places)][2]
        found.append(Recipe(index + 1, kind, counts[kind], _target(kind, counts[kind])))
        counts[kind] += 1
    return found


def _target(kind: str, turn: int) -> tuple[float, float] | None:
    if kind == "single":
        return BINS[turn % len(BINS)]
    if kind in ("pair", "triple"):
        return SEVERAL
    return STRANGE if kind in BEYOND else None


def bin_of(value: float) -> int | None:
    """Index of the bin that a detectability falls into; None below the first."""
    return max((k for k, (low, _) in enumerate(BINS) if value >= low), default=None)


def bin_words(k: int) -> str:
    """A bin as the tables name it."""
    low, high = BINS[k]
    return f">= {low:g}" if k == len(BINS) - 1 else f"{low:g}-{high:g}"


SIGNALS = ("tracker", "force", "both")
# Keys that say where, when or how fast an effect acts; all others are sizes, and readings are linear in them to first order.
SHAPES = frozenset("phase_rad order source_joint target at_s lever_link1_m lever_arm_m hz tau leak torque_Nm".split())
PLANTABLE = tuple(kind for kind in ARM_KINDS if kind.name != "channel_delay")  # a tracker's reading at rest has no delay
# Of the arm's effects those that move a force log which was taught on the machine, and are no matter of registration.
IN_LOG = frozenset(
    "backlash load_backlash friction_windup joint_thermal link_thermal base_tilt wrist_coupling joint_coupling joint_compliance "
    "tool_flex".split()
)
OUTSIDE: dict[str, Outside] = {**ON_ARM, **ON_GRINDING, **LATE}
"""Every effect outside the catalogue, of both lists."""
_OF_ARM = frozenset(kind.name for kind in ARM_KINDS)


def pool_of(recipe: Recipe, signals: str) -> tuple[EffectKind, ...]:
    """Kinds that may be planted in a world of `recipe`."""
    if recipe.kind in ("outside", "outside_late"):
        first = ON_ARM if signals == "tracker" else ON_GRINDING
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
    sizes = [key for key in kind_of(planted.effect).keys if key.name not in SHAPES and key.unit != "name"]
    return all(np.linalg.norm(planted.vector(k.name)) <= upper_end(k, planted.joint) * (1 + 1e-9) for k in sizes)
