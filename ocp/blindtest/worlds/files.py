"""Folders of blind worlds: the cell, what was read, the conditions to predict; nothing of what was planted."""

from pathlib import Path

import numpy as np

from ocp.blindtest.worlds.bench import Log
from ocp.blindtest.worlds.machines import BlindMachine, GrindingMachine, TrackerMachine, arm_with_outside
from ocp.blindtest.worlds.pools import of_arm
from ocp.model.cell import read_cell
from ocp.simulate.twin.contact.sensor import noise
from ocp.simulate.twin.dataset import FORCE_COLUMNS, READ, copy_cell, log_rows, write_csv
from ocp.simulate.twin.run import GrindingConditions, GroundPasses
from ocp.simulate.twin.tracker_log import noise_stream, tracker_world, write_readings
from ocp.simulate.twin.truth.planting import Planted
from ocp.simulate.twin.truth.truth import SENSOR_SIGMA
from robots.errors import BadInput
from robots.pose import Array

# Added to the cell of the blind worlds: a payload that no campaign measures and half of the sealed conditions carry.
HEAVY = "\n[payloads.heavy]\nmass_kg = 150.0\ncom_mm = [10, -10, 220]\n"
WILD, WILD_N = 0.01, (1.5, 8.0)  # of a background: share of wild rows, their size N


def write_cell(source: Path, path: Path, signals: str = "tracker") -> None:
    """The cell of the check: the one given, with a payload that is never measured where it has none; for force worlds with its
    blade. Raises BadInput: no blade for those."""
    text = source.read_text(encoding="utf-8-sig")
    if signals != "tracker":
        cell = read_cell(source)
        if cell.workpiece.stl is None:
            raise BadInput(f"{source}: names no blade; force worlds need one as workpiece.stl")
        path.parent.mkdir(parents=True, exist_ok=True)
        copy_cell(cell, path.parent)
        text = (path.parent / "cell.toml").read_text(encoding="utf-8")
    path.write_text(text if "[payloads.heavy]" in text else text + HEAVY, encoding="utf-8")


def write_world(folder: Path, machine: BlindMachine, effects: tuple[Planted, ...]) -> None:
    """The data set of a world, without its labels."""
    if isinstance(machine, TrackerMachine):
        _write_tracker(folder, machine, effects)
    else:
        _write_force(folder, machine, effects)


def _write_tracker(folder: Path, machine: TrackerMachine, effects: tuple[Planted, ...]) -> None:
    """tracker.csv and sealed_tracker.csv."""
    truth = machine.with_effects(effects)
    tracker_world(machine.cell.path, folder, truth, machine.campaign, machine.sealed, label=False)
    arm = arm_with_outside(machine.cell, truth, machine.campaign.targets)
    write_readings(folder / "tracker.csv", machine.cell, truth, arm, machine.campaign, noise_stream(truth.seed))


def _write_force(folder: Path, machine: GrindingMachine, effects: tuple[Planted, ...]) -> None:
    """force.csv and sealed_force.csv, and those of the tracker where one measured the arm."""
    if machine.arm is not None:
        _write_tracker(folder, machine.arm, of_arm(effects))
    folder.mkdir(parents=True, exist_ok=True)
    copy_cell(machine.bench.cell, folder)
    log = machine.log((*effects, *machine.small), unrest=True)
    rows, following = log_rows([_grinding(log, log.both + log_noise(machine, log))])
    write_csv(folder / "force.csv", FORCE_COLUMNS, rows)
    hidden, _ = log_rows([_grinding(machine.log((), sealed=True), None)], following, truth=True)
    keep = [k for k, c in enumerate(FORCE_COLUMNS) if c not in READ]
    write_csv(folder / "sealed_force.csv", [FORCE_COLUMNS[k] for k in keep], [[row[k] for k in keep] for row in hidden])


def log_noise(machine: GrindingMachine, log: Log) -> Array:
    """Noise (2, n) N of the readings of a world, wild rows of the normal one included."""
    rng = np.random.default_rng([machine.seed, 3])
    found = np.stack([noise(SENSOR_SIGMA, log.moments, rng) for _ in range(2)])
    if machine.background:
        n = found.shape[1]
        found[0] += (rng.uniform(size=n) < WILD) * rng.uniform(*WILD_N, n) * rng.choice([-1.0, 1.0], n)
    return found


def _grinding(log: Log, read: Array | None) -> GroundPasses:
    """A log in the virtual cell's own form."""
    fn, ft = (log.result.force, log.result.tangential) if read is None else read
    index = np.arange(len(log.fn))
    return GroundPasses(GrindingConditions(0.0, 0.0), index, log.q, log.moments, log.result, fn, ft)
