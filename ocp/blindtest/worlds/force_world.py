"""Folders of force worlds: the cell with its blade, the log, conditions to predict, a tracker's readings where there are any."""

from pathlib import Path

import numpy as np

from ocp.blindtest.oracle.force_detectability import on_arm, sight_of
from ocp.blindtest.worlds.drawing import Drawn
from ocp.blindtest.worlds.force_drawing import draw_effects
from ocp.blindtest.worlds.force_machines import WILD, WILD_N, GrindingMachine, draw_grinding, small
from ocp.blindtest.worlds.grinder import Log
from ocp.blindtest.worlds.machines import HEAVY, Machine
from ocp.blindtest.worlds.outside_arm import arm_of
from ocp.blindtest.worlds.recipes import Recipe
from ocp.model.cell import read_cell
from ocp.simulate.twin.contact.sensor import noise
from ocp.simulate.twin.dataset import FORCE_COLUMNS, READ, copy_cell, force_rows, write_csv
from ocp.simulate.twin.run import Conditions, Grinding
from ocp.simulate.twin.truth.machine import SENSOR_SIGMA
from ocp.simulate.twin.truth.planting import Planted
from ocp.simulate.twin.worlds import noise_stream, tracker_world, write_readings
from robots.errors import BadInput
from robots.pose import Array


def write_cell_with_blade(source: Path, path: Path) -> None:
    """The cell of a check with its blade beside it, and a payload that is never measured. Raises BadInput: no blade."""
    cell = read_cell(source)
    if cell.workpiece.stl is None:
        raise BadInput(f"{source}: names no blade; force worlds need one as workpiece.stl")
    path.parent.mkdir(parents=True, exist_ok=True)
    copy_cell(cell, path.parent)
    text = (path.parent / "cell.toml").read_text(encoding="utf-8")
    path.write_text(text if "[payloads.heavy]" in text else text + HEAVY, encoding="utf-8")


def make_force_world(cell: Path, seed: int, recipe: Recipe, readings: int, blind: int, both: bool, folder: Path) -> Drawn:
    """Draw the machine and its effects, write the world. Raises Infeasible of the drawing."""
    machine = draw_grinding(cell, seed, recipe, readings, blind, both)
    drawn = draw_effects(seed, recipe, sight_of(machine)) if recipe.target is not None else Drawn((), ())
    write_force_world(folder, machine, drawn.effects)
    return drawn


def write_force_world(folder: Path, machine: GrindingMachine, effects: tuple[Planted, ...]) -> None:
    """The data set of a world, without its labels."""
    if machine.arm is not None:
        write_tracker(folder, machine.arm, effects)
    folder.mkdir(parents=True, exist_ok=True)
    copy_cell(machine.bench.cell, folder)
    log = machine.log((*effects, *small(machine)), unrest=True)
    rows, following = force_rows([_grinding(log, log.both + log_noise(machine, log))])
    write_csv(folder / "force.csv", FORCE_COLUMNS, rows)
    hidden, _ = force_rows([_grinding(machine.log((), sealed=True), None)], following, truth=True)
    keep = [k for k, c in enumerate(FORCE_COLUMNS) if c not in READ]
    write_csv(folder / "sealed_force.csv", [FORCE_COLUMNS[k] for k in keep], [[row[k] for k in keep] for row in hidden])


def write_tracker(folder: Path, arm: Machine, effects: tuple[Planted, ...]) -> None:
    """tracker.csv and sealed_tracker.csv of the same arm."""
    truth = arm.with_effects([p for p in effects if on_arm(p)])
    tracker_world(arm.cell.path, folder, truth, arm.campaign, arm.sealed, label=False)
    mounted = arm_of(arm.cell, truth, arm.campaign.targets)
    write_readings(folder / "tracker.csv", arm.cell, truth, mounted, arm.campaign, noise_stream(truth.seed))


def log_noise(machine: GrindingMachine, log: Log) -> Array:
    """Noise (2, n) N of the readings of a world, wild rows of the normal one included."""
    rng = np.random.default_rng([machine.seed, 3])
    found = np.stack([noise(SENSOR_SIGMA, log.moments, rng) for _ in range(2)])
    if machine.background:
        n = found.shape[1]
        found[0] += (rng.uniform(size=n) < WILD) * rng.uniform(*WILD_N, n) * rng.choice([-1.0, 1.0], n)
    return found


def _grinding(log: Log, read: Array | None) -> Grinding:
    """A log in the virtual cell's own form."""
    fn, ft = (log.result.force, log.result.tangential) if read is None else read
    index = np.arange(len(log.fn))
    return Grinding(Conditions(0.0, 0.0), index, log.q, log.moments, log.result, fn, ft)
