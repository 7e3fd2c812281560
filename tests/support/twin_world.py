"""A whole world of the virtual tracker, of one seed: machine, campaign, what is kept back, and what was planted."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from ocp.model.cell import read_cell
from ocp.simulate.twin.arm import make_arm
from ocp.simulate.twin.dataset import write_labels
from ocp.simulate.twin.planting import Planted
from ocp.simulate.twin.tracker import TrackerLog, random_design, sealed_design, tracker_world, write_tracker_truth
from ocp.simulate.twin.truth import Truth, draw_truth

_DESIGN = 102  # stream beside those of the truth


def random_world(
    cell_path: Path,
    folder: Path,
    seed: int,
    effects: Sequence[Planted] = (),
    readings: int = 150,
    blind: int = 120,
    weight_bends: str = "believed",
) -> Truth:
    """The truth that was written. Weight bends only the joints that the cell believes in, unless asked: the labels then hold all
    there is to name."""
    cell = read_cell(cell_path)
    truth = draw_truth(cell, seed, effects, weight_bends=weight_bends)
    rng = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(_DESIGN,)))
    sealed = random_design(cell, rng, readings), sealed_design(cell, rng, blind)
    tracker_world(folder, cell, truth, TrackerLog(*sealed))
    write_labels(folder, truth, "drawn")
    write_tracker_truth(folder, cell, truth, make_arm(cell, truth), sealed[1])
    return truth
