"""Effects of a world: drawn, then brought to the detectability that its recipe asks for, all before anything is sealed."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from ocp.blindtest.oracle.detectability import ExactView, detectabilities
from ocp.blindtest.worlds.machines import effects_stream
from ocp.blindtest.worlds.pools import pool_of, scaled, within_range
from ocp.blindtest.worlds.recipes import BINS, Recipe
from ocp.simulate.twin.truth.kinds import EffectKind
from ocp.simulate.twin.truth.planting import Planted, draw_effect
from robots.errors import Infeasible
from robots.pose import Array

TRIES = 60
IN_TURN = 3  # attempts of a tracker world with the kind whose turn it is, then kinds are drawn
SAME_KIND = 2  # attempts of a force world with a kind, then it is the turn of the next
CLOSE, ENOUGH = 0.25, 0.02  # relative: how near the target the true lambda must come, and where sizes are changed no further
STEPS = {"tracker": 3, "force": 4, "both": 4}  # how often sizes are changed: readings are linear in them to first order only
FAINT = {"tracker": 1e-3, "force": 1e-2, "both": 1e-2}  # lambda with its price below which readings do not show the effect


@dataclass(frozen=True, eq=False)
class Drawn:
    """Effects with the detectability of each given the others, less the price of scanned families."""

    effects: tuple[Planted, ...]
    lam: tuple[float, ...]


def draw_effects(seed: int, recipe: Recipe, view: ExactView, signals: str) -> Drawn:
    """Effects of a world of a `recipe` that plants some. Raises Infeasible: none reach the detectability within their usual
    range."""
    assert recipe.target is not None
    rng, pool = effects_stream(seed, recipe), pool_of(recipe, signals)
    for attempt in range(TRIES):
        kinds = _kinds(seed, recipe, rng, attempt, pool, signals)
        effects = [_one(rng, kind, view) for kind in kinds]
        if len({(p.effect, p.joint) for p in effects}) < len(effects):
            continue
        low, high = np.log(recipe.target)
        found = _brought(view, effects, np.exp(rng.uniform(low, high, len(effects))), signals)
        if found is not None:
            return found
    raise Infeasible(f"world {recipe.index}: no effect reaches a detectability of {recipe.target[0]:g} within its usual range")


def _kinds(
    seed: int, recipe: Recipe, rng: np.random.Generator, attempt: int, pool: Sequence[EffectKind], signals: str
) -> list[EffectKind]:
    """Kinds to try. Of single effects all kinds take turns from world to world, of force worlds in every bin of its own; one that
    cannot be brought to its detectability leaves its place."""
    single, tracker = recipe.kind == "single", signals == "tracker"
    if recipe.effects > 1 or (tracker and attempt >= IN_TURN):
        return [pool[k] for k in rng.choice(len(pool), recipe.effects, replace=False)]
    key: tuple[int, ...]
    if tracker:
        key, turn, skipped = (0,), recipe.turn // 4 + (recipe.turn % 4) * 5 if single else recipe.turn, 0
    else:
        bin_, turn = (recipe.turn % len(BINS), recipe.turn // len(BINS)) if single else (9, recipe.turn)
        key, skipped = (1, bin_), attempt // SAME_KIND
    block, place = divmod(turn, len(pool))
    order = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(*key, block))).permutation(len(pool))
    return [pool[order[(place + skipped) % len(pool)]]]


def _one(rng: np.random.Generator, kind: EffectKind, view: ExactView) -> Planted:
    planted = draw_effect(rng, kind, targets=view.targets)
    at = view.instant(planted, rng) if "at_s" in planted.values else None
    return planted if at is None else replace(planted, values={**planted.values, "at_s": at})


def _brought(view: ExactView, effects: list[Planted], wanted: Array, signals: str) -> Drawn | None:
    """The effects at sizes that give the wanted detectabilities; None where a size would leave its usual range."""
    dues = np.array([view.price(p.effect, p.joint) for p in effects])
    for _ in range(STEPS[signals]):
        lam = detectabilities(view, effects)
        if (lam + dues <= FAINT[signals]).any():
            return None
        if (np.abs(lam / wanted - 1.0) < ENOUGH).all():
            break
        factors = np.sqrt((wanted + dues) / (lam + dues))
        effects = [scaled(p, float(f)) for p, f in zip(effects, factors, strict=True)]
        if not all(within_range(p) for p in effects):
            return None
    else:
        lam = detectabilities(view, effects)
    if (np.abs(lam / wanted - 1.0) > CLOSE).any():
        return None
    return Drawn(tuple(effects), tuple(float(v) for v in lam))
