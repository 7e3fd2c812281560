"""A blind check: where its files lie, the folders of its worlds (the cell, what was read, the conditions to predict; nothing of
what was planted), and its labels, sealed with their hashes before any answer is made.
"""

import json
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np

from ocp.blindtest.worlds import machines
from ocp.blindtest.worlds.bench import Log
from ocp.blindtest.worlds.machines import BlindMachine, GrindingMachine, TrackerMachine
from ocp.blindtest.worlds.recipes import Recipe, of_arm
from ocp.model.cell import read_cell
from ocp.shell.cache import sha256
from ocp.simulate.twin.contact.sensor import noise
from ocp.simulate.twin.dataset import FORCE_COLUMNS, copy_cell, log_rows, write_csv, write_sealed_force
from ocp.simulate.twin.planting import Planted, labels
from ocp.simulate.twin.run import GroundPasses
from ocp.simulate.twin.tracker import TrackerLog, tracker_world
from ocp.simulate.twin.truth import SENSOR_SIGMA
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
        return _write_tracker(folder, machine, effects)
    if machine.arm is not None:
        _write_tracker(folder, machine.arm, of_arm(effects))
    _write_force(folder, machine, effects)


def _write_tracker(folder: Path, machine: TrackerMachine, effects: tuple[Planted, ...]) -> None:
    """tracker.csv and sealed_tracker.csv."""
    truth = machine.with_effects(effects)
    arm = machines.arm_with_outside(machine.cell, truth, machine.campaign.targets)
    tracker_world(folder, machine.cell, truth, TrackerLog(machine.campaign, machine.sealed), arm)


def _write_force(folder: Path, machine: GrindingMachine, effects: tuple[Planted, ...]) -> None:
    """force.csv and sealed_force.csv."""
    folder.mkdir(parents=True, exist_ok=True)
    copy_cell(machine.bench.cell, folder)
    log = machine.log((*effects, *machine.small), unrest=True)
    rows, following = log_rows([_grinding(log, log.both + log_noise(machine, log))])
    write_csv(folder / "force.csv", FORCE_COLUMNS, rows)
    hidden, _ = log_rows([_grinding(machine.log((), sealed=True), None)], following, truth=True)
    write_sealed_force(folder, hidden)


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
    return GroundPasses(index, log.q, log.moments, log.result, fn, ft)


WORLDS, ANSWERS, SEALED, SEAL, CELL, WITHHELD = "worlds", "answers", "sealed", "seal.json", "cell.toml", "withheld.txt"


@dataclass(frozen=True)
class Check:
    """A blind check: folder, seed, how many worlds, of which kinds, readings of a campaign and sealed ones (blind); signals:
    tracker, force or both."""

    folder: Path
    seed: int
    worlds: int
    kinds: tuple[str, ...]
    readings: int = 150
    blind: int = 120
    signals: str = "tracker"

    @property
    def cell(self) -> Path:
        """The cell that all its worlds are machines of."""
        return self.folder / CELL

    def world(self, name: str) -> Path:
        """Folder of a world: all that an answer may read."""
        return self.folder / WORLDS / name

    def answer(self, name: str) -> Path:
        """Where the answer to a world lies."""
        return self.folder / ANSWERS / f"{name}.json"

    def fixed(self) -> dict[str, Any]:
        """What may not change when a check is resumed."""
        known = {
            "machines": machines.VERSION,
            "seed": self.seed,
            "kinds": list(self.kinds),
            "readings": self.readings,
            "blind": self.blind,
        }
        return known if self.signals == "tracker" else {**known, "signals": self.signals}


@dataclass(frozen=True)
class Label:
    """What was planted in a world, and the detectability of each effect given the others."""

    recipe: Recipe
    effects: tuple[Planted, ...]
    lam: tuple[float, ...]
    withheld: tuple[str, ...]


def machine_of(check: Check, recipe: Recipe) -> BlindMachine:
    """The machine of a world, drawn again from the check's seed."""
    asked = check.cell, check.seed, recipe, check.readings, check.blind
    if check.signals == "tracker":
        return machines.draw_tracker_machine(*asked)
    return machines.draw_grinding_machine(*asked, check.signals == "both")


def label_path(check: Check, recipe: Recipe) -> Path:
    """Where the label of a world lies."""
    return check.folder / SEALED / f"{recipe.name}.json"


def write_label(path: Path, label: Label) -> None:
    """What was planted, as `read_label` opens it."""
    content = {
        "recipe": asdict(label.recipe),
        "labels": labels(label.effects),
        "planted": [asdict(p) for p in label.effects],
        "detectability": list(label.lam),
        "withheld": list(label.withheld),
    }
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(json.dumps(content, indent=1) + "\n", encoding="utf-8")


def read_label(check: Check, recipe: Recipe, seal: dict[str, str]) -> Label:
    """Open a label. Raises BadInput: it is not the one that was sealed."""
    path = label_path(check, recipe)
    if not path.is_file():
        raise BadInput(f"{path}: the label is missing; make the worlds anew with --overwrite")
    if seal.get(recipe.name) != sha256(path):
        raise BadInput(f"{path}: is not what was sealed before the answers; make the worlds anew with --overwrite")
    content = json.loads(path.read_text(encoding="utf-8"))
    effects = []
    for p in content["planted"]:
        values = {k: tuple(v) if isinstance(v, list) else v for k, v in p["values"].items()}
        effects.append(Planted(p["effect"], p["joint"], values))
    return Label(recipe, tuple(effects), tuple(content["detectability"]), tuple(content["withheld"]))


def read_seal(check: Check) -> dict[str, str]:
    """Hashes of the labels, empty where none were sealed."""
    path = check.folder / SEAL
    return dict(json.loads(path.read_text(encoding="utf-8"))) if path.is_file() else {}
