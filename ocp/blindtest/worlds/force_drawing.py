"""Effects of a force world: drawn, then brought to the detectability that its recipe asks for, before anything is sealed.

As `ocp.blindtest.worlds.drawing` does for tracker worlds, with the catalogue's second table and those effects of the arm that a
log shows.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from ocp.blindtest.oracle.force_detectability import Sight, detectabilities
from ocp.blindtest.worlds.drawing import CLOSE, TRIES, Drawn, scaled, within
from ocp.blindtest.worlds.drawing import PLANTABLE as ON_ARM
from ocp.blindtest.worlds.force_outside import KINDS as OUTSIDE
from ocp.blindtest.worlds.machines import effects_stream
from ocp.blindtest.worlds.recipes import BINS, Recipe
from ocp.simulate.twin.truth.kinds_contact import KINDS as ON_CONTACT
from ocp.simulate.twin.truth.planting import Kind, Planted, draw_effect
from robots.errors import Infeasible
from robots.pose import Array

# Of the arm's effects those that move a force log which was taught on the machine, and are no matter of registration.
IN_LOG = ("backlash", "friction_windup", "joint_thermal", "link_thermal", "base_tilt", "wrist_coupling", "joint_compliance")
SAME_KIND = 2  # attempts with a kind, then it is the turn of the next
AT = (0.15, 0.9)  # of the campaign's time, when steps happen


def pool_of(recipe: Recipe, both: bool) -> tuple[Kind, ...]:
    """Kinds that may be planted."""
    if recipe.kind == "outside":
        return tuple(OUTSIDE.values())
    arm = tuple(k for k in ON_ARM if both or k.name in IN_LOG)
    return (*ON_CONTACT, *arm)


def draw_effects(seed: int, recipe: Recipe, sight: Sight) -> Drawn:
    """Effects of a world of `recipe`. Raises Infeasible: none reach the detectability within their usual range."""
    if recipe.target is None:
        return Drawn((), ())
    rng = effects_stream(seed, recipe)
    pool = pool_of(recipe, sight.scene is not None)
    for attempt in range(TRIES):
        effects = [_one(rng, kind, sight) for kind in _kinds(seed, recipe, rng, attempt, pool)]
        if len({(p.effect, p.joint) for p in effects}) < len(effects):
            continue
        low, high = np.log(recipe.target)
        found = _brought(sight, effects, np.exp(rng.uniform(low, high, len(effects))))
        if found is not None:
            return found
    raise Infeasible(f"world {recipe.index}: no effect reaches a detectability of {recipe.target[0]:g} within its usual range")


def _kinds(seed: int, recipe: Recipe, rng: np.random.Generator, attempt: int, pool: tuple[Kind, ...]) -> list[Kind]:
    """Kinds to try: in every bin all take turns; one that cannot be brought to the bin leaves its place to the next."""
    if recipe.effects == 1:
        stream, turn = (recipe.turn % len(BINS), recipe.turn // len(BINS)) if recipe.kind == "single" else (9, recipe.turn)
        block, place = divmod(turn, len(pool))
        order = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(1, stream, block))).permutation(len(pool))
        return [pool[order[(place + attempt // SAME_KIND) % len(pool)]]]
    return [pool[k] for k in rng.choice(len(pool), recipe.effects, replace=False)]


def _one(rng: np.random.Generator, kind: Kind, sight: Sight) -> Planted:
    arm = sight.machine.arm
    targets = ("T1",) if arm is None else tuple(dict.fromkeys(arm.campaign.targets))
    planted = draw_effect(rng, kind, targets=targets)
    if "at_s" not in planted.values:
        return planted
    if arm is not None and kind in ON_ARM:
        return planted
    clock = sight.machine.rows.clock
    at = float(clock[0] + rng.uniform(*AT) * (clock[-1] - clock[0]))
    return replace(planted, values={**planted.values, "at_s": at})


def _brought(sight: Sight, effects: list[Planted], wanted: Array) -> Drawn | None:
    """The effects at sizes that give the wanted detectabilities; None where a size would leave its usual range."""
    dues = np.array([sight.price(p.effect, p.joint) for p in effects])
    for _ in range(4):
        lam = detectabilities(sight, effects)
        if (lam + dues <= 1e-2).any():
            return None
        if (np.abs(lam / wanted - 1.0) < 0.02).all():
            return Drawn(tuple(effects), tuple(float(v) for v in lam))
        factors = np.sqrt((wanted + dues) / (lam + dues))
        effects = [scaled(p, float(f)) for p, f in zip(effects, factors, strict=True)]
        if any(not usual(p) for p in effects):
            return None
    lam = detectabilities(sight, effects)
    if (np.abs(lam / wanted - 1.0) > CLOSE).any():
        return None
    return Drawn(tuple(effects), tuple(float(v) for v in lam))


def usual(planted: Planted) -> bool:
    """Whether no size is above the upper end of its range."""
    return within(planted, kind_of(planted.effect))


def kind_of(effect: str) -> Kind:
    """The kind of an effect of any of the pools."""
    known: Sequence[Kind] = (*OUTSIDE.values(), *ON_CONTACT, *ON_ARM)
    return next(kind for kind in known if kind.name == effect)
