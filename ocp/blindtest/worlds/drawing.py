"""Effects of a world: drawn, then brought to the detectability that its recipe asks for, all before anything is sealed."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from ocp.blindtest.oracle.detectability import Whitener, given_others, price, whitener
from ocp.blindtest.worlds.machines import Machine, effects_stream
from ocp.blindtest.worlds.outside import KINDS as OUTSIDE
from ocp.blindtest.worlds.outside_late import EVERY
from ocp.blindtest.worlds.outside_late import KINDS as LATE
from ocp.blindtest.worlds.recipes import Recipe
from ocp.blindtest.worlds.scene import Scene
from ocp.simulate.twin.truth.kinds_arm import KINDS as ARM
from ocp.simulate.twin.truth.planting import Kind, Planted, Value, draw_effect
from robots.errors import Infeasible
from robots.pose import Array

# Keys that say where, when or how fast an effect acts; all others are sizes, and readings are linear in them to first order.
SHAPES = (
    "phase_rad", "order", "source_joint", "target", "at_s", "lever_link1_m", "lever_arm_m", "hz", "tau", "leak",
)  # fmt: skip
PLANTABLE = tuple(kind for kind in ARM if kind.name != "channel_delay")  # a tracker's reading at rest has no delay
POOLS = {"outside": tuple(OUTSIDE.values()), "outside_late": tuple(LATE.values())}  # of kinds of worlds; else the catalogue
TRIES = 60
CLOSE = 0.25  # relative: how near the target the true lambda must come, sizes being scaled to first order only


@dataclass(frozen=True, eq=False)
class Drawn:
    """Effects with the detectability of each given the others, less the price of scanned families."""

    effects: tuple[Planted, ...]
    lam: tuple[float, ...]


def draw_effects(seed: int, recipe: Recipe, machine: Machine) -> Drawn:
    """Effects of a world of `recipe`. Raises Infeasible: none reach the detectability within their usual range."""
    if recipe.target is None:
        return Drawn((), ())
    rng = effects_stream(seed, recipe)
    scene = machine.scene()
    white = whitener(scene)
    for attempt in range(TRIES):
        effects = [_one(rng, kind, machine) for kind in _kinds(seed, recipe, rng, attempt)]
        if len({(p.effect, p.joint) for p in effects}) < len(effects):
            continue
        low, high = np.log(recipe.target)
        wanted = np.exp(rng.uniform(low, high, len(effects)))
        found = _brought(machine, scene, white, effects, wanted)
        if found is not None:
            return found
    raise Infeasible(f"world {recipe.index}: no effect reaches a detectability of {recipe.target[0]:g} within its usual range")


def detectabilities(machine: Machine, scene: Scene, white: Whitener, effects: Sequence[Planted]) -> Array:
    """Lambda (k,) of every effect given the others, less the price of its family: the reading with all less that without it."""
    whole = machine.points(effects)
    alone = [whole - machine.points([p for p in effects if p is not one]) for one in effects]
    found = given_others([white.apply(d) for d in alone])
    return found - [price(p.effect, scene) for p in effects]


def _kinds(seed: int, recipe: Recipe, rng: np.random.Generator, attempt: int) -> list[Kind]:
    """Kinds of effects to try: all kinds take turns from world to world, at random from the third attempt on."""
    pool = POOLS.get(recipe.kind, PLANTABLE)
    if recipe.effects == 1 and attempt < 3:
        block, place = divmod(recipe.turn // 4 + (recipe.turn % 4) * 5 if recipe.kind == "single" else recipe.turn, len(pool))
        order = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(0, block))).permutation(len(pool))
        return [pool[order[place]]]
    return [pool[k] for k in rng.choice(len(pool), recipe.effects, replace=False)]


def _one(rng: np.random.Generator, kind: Kind, machine: Machine) -> Planted:
    return draw_effect(rng, kind, targets=tuple(dict.fromkeys(machine.campaign.targets)))


def _brought(machine: Machine, scene: Scene, white: Whitener, effects: list[Planted], wanted: Array) -> Drawn | None:
    """The effects at sizes that give the wanted detectabilities; None where a size would leave its usual range."""
    for _ in range(3):
        lam = detectabilities(machine, scene, white, effects)
        dues = np.array([price(p.effect, scene) for p in effects])
        if (lam + dues <= 1e-3).any():
            return None
        if (np.abs(lam / wanted - 1.0) < 0.02).all():
            break
        factors = np.sqrt((wanted + dues) / (lam + dues))
        effects = [scaled(p, float(f)) for p, f in zip(effects, factors, strict=True)]
        if any(not usual(p) for p in effects):
            return None
    lam = detectabilities(machine, scene, white, effects)
    if (np.abs(lam / wanted - 1.0) > CLOSE).any():
        return None
    return Drawn(tuple(effects), tuple(float(v) for v in lam))


def scaled(planted: Planted, factor: float) -> Planted:
    """The effect with all its sizes times `factor`."""
    return replace(planted, values={k: v if k in SHAPES else _times(v, factor) for k, v in planted.values.items()})


def _times(value: Value, factor: float) -> Value:
    if isinstance(value, str):
        return value
    return tuple(factor * v for v in value) if isinstance(value, tuple) else factor * value


def usual(planted: Planted) -> bool:
    """Whether no size of an arm's or tracker's effect is above the upper end of its range."""
    return within(planted, EVERY.get(planted.effect) or next(k for k in ARM if k.name == planted.effect))


def within(planted: Planted, kind: Kind) -> bool:
    """Whether no size is above the upper end of its range; smaller ones are as likely as not (DIAGNOSIS, catalogue)."""
    for key in kind.keys:
        if key.name not in SHAPES and key.unit != "name":
            top = max(abs(key.low), abs(key.high)) * (key.scale[(planted.joint or 1) - 1] if key.scale else 1.0)
            if float(np.linalg.norm(planted.vector(key.name))) > top * (1 + 1e-9):
                return False
    return True
