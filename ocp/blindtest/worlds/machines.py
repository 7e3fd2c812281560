"""Machines of blind worlds: drawn from a seed and a number, so that the scorer can draw the very same again."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from ocp.blindtest.worlds.outside_arm import arm_of
from ocp.blindtest.worlds.recipes import Recipe
from ocp.blindtest.worlds.scene import Scene, scene_of
from ocp.model.cell import Cell, read_cell
from ocp.simulate.twin.designs import Campaign, random_design, sealed_design
from ocp.simulate.twin.tracker import true_points
from ocp.simulate.twin.truth.machine import Truth
from ocp.simulate.twin.truth.planting import Planted
from ocp.simulate.twin.truth.truth import draw_truth
from robots.pose import Array

# Added to the cell of the blind worlds: a payload that no campaign measures and half of the sealed conditions carry.
HEAVY = "\n[payloads.heavy]\nmass_kg = 150.0\ncom_mm = [10, -10, 220]\n"
_MACHINE, _CAMPAIGN, _SEALED, _EFFECTS = range(4)  # streams of one world


@dataclass(frozen=True, eq=False)
class Machine:
    """A cell with its hidden numbers, nothing planted, and the campaigns on it: to learn from, and sealed."""

    cell: Cell
    truth: Truth
    campaign: Campaign
    sealed: Campaign

    def with_effects(self, effects: Sequence[Planted]) -> Truth:
        """The same machine with these effects."""
        return replace(self.truth, effects=tuple(effects))

    def points(self, effects: Sequence[Planted], sealed: bool = False) -> Array:
        """Points (n, 3) m that a tracker without noise would read."""
        campaign, truth = self.sealed if sealed else self.campaign, self.with_effects(effects)
        arm = arm_of(self.cell, truth, campaign.targets)
        return true_points(truth, self.cell, arm, campaign.moments, campaign.targets)

    def scene(self) -> Scene:
        """Of the campaign to learn from."""
        return scene_of(self.cell, self.truth, self.campaign)


def stream(seed: int, recipe: Recipe, part: int) -> np.random.Generator:
    """Random numbers of a part of a world."""
    return np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(recipe.index, part)))


def effects_stream(seed: int, recipe: Recipe) -> np.random.Generator:
    """Random numbers that the planted effects are drawn with."""
    return stream(seed, recipe, _EFFECTS)


def draw_machine(cell_path: Path, seed: int, recipe: Recipe, readings: int, blind: int) -> Machine:
    """The machine of a world. Every other world with effects, and every one that asks for it, has gross readings, ripple and
    play of its own; the rest have noise alone."""
    cell = read_cell(cell_path)
    truth = draw_truth(cell, int(stream(seed, recipe, _MACHINE).integers(2**31)), weight_bends="believed")
    if not background(recipe):
        truth = replace(truth, ripple=truth.ripple * [0.0, 1.0, 1.0], play=np.zeros(6), outliers=0.0)
    return Machine(
        cell,
        truth,
        random_design(cell, stream(seed, recipe, _CAMPAIGN), readings),
        sealed_design(cell, stream(seed, recipe, _SEALED), blind),
    )


def background(recipe: Recipe) -> bool:
    """Whether a world has outliers and a background of small effects."""
    if recipe.kind in ("none", "none_background"):
        return recipe.kind == "none_background"
    return (recipe.turn // 4 if recipe.kind == "single" else recipe.turn) % 2 == 1
