"""Folders of blind worlds: what the answers may read, and the labels, sealed with their hashes before any answer is made."""

import hashlib
import json
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from ocp.blindtest.worlds.drawing import Drawn, draw_effects
from ocp.blindtest.worlds.force_world import make_force_world, write_cell_with_blade
from ocp.blindtest.worlds.machines import HEAVY, Machine, draw_machine
from ocp.blindtest.worlds.outside_arm import arm_of
from ocp.blindtest.worlds.recipes import Recipe
from ocp.simulate.twin.truth.planting import Planted, labels
from ocp.simulate.twin.worlds import noise_stream, tracker_world, write_readings
from robots.errors import BadInput

WORLDS, SEALED, SEAL, CELL, WITHHELD = "worlds", "sealed", "seal.json", "cell.toml", "withheld.txt"


@dataclass(frozen=True)
class Check:
    """A blind check: its folder, seed, sizes of the campaigns, kinds of worlds and how many; signals: tracker, force or both."""

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

    def fixed(self) -> dict[str, Any]:
        """What may not change when a check is resumed."""
        told = {"seed": self.seed, "kinds": list(self.kinds), "readings": self.readings, "blind": self.blind}
        return told if self.signals == "tracker" else {**told, "signals": self.signals}


@dataclass(frozen=True)
class Label:
    """What was planted in a world, and the detectability of each effect given the others."""

    recipe: Recipe
    effects: tuple[Planted, ...]
    lam: tuple[float, ...]
    withheld: tuple[str, ...]


def write_cell(source: Path, path: Path, signals: str = "tracker") -> None:
    """The cell of the check: the one given, with a payload that is never measured where it has none; for force worlds with its
    blade. Raises BadInput: no blade for those."""
    if signals != "tracker":
        write_cell_with_blade(source, path)
        return
    text = source.read_text(encoding="utf-8-sig")
    path.write_text(text if "[payloads.heavy]" in text else text + HEAVY, encoding="utf-8")


def make_world(check: Check, recipe: Recipe) -> str:
    """Draw, write and seal a world that is not there yet; the hash of its label. Raises Infeasible of the drawing."""
    folder, label = check.folder / WORLDS / recipe.name, label_path(check, recipe)
    if not label.is_file():
        drawn = _made(check, recipe, folder)
        withheld = tuple(p.effect for p in drawn.effects) if recipe.kind == "left_out" else ()
        if withheld:
            (folder / WITHHELD).write_text("\n".join(withheld) + "\n", encoding="utf-8")
        _write_label(label, recipe, drawn, withheld)
    return digest(label)


def _made(check: Check, recipe: Recipe, folder: Path) -> Drawn:
    """What was planted in the world that is now in `folder`."""
    if check.signals != "tracker":
        both = check.signals == "both"
        return make_force_world(check.cell, check.seed, recipe, check.readings, check.blind, both, folder)
    machine = draw_machine(check.cell, check.seed, recipe, check.readings, check.blind)
    drawn = draw_effects(check.seed, recipe, machine)
    write_world(folder, check.cell, machine, drawn.effects)
    return drawn


def write_world(folder: Path, cell: Path, machine: Machine, effects: tuple[Planted, ...]) -> None:
    """The data set of a world, without its labels."""
    truth = machine.with_effects(effects)
    tracker_world(cell, folder, truth, machine.campaign, machine.sealed, label=False)
    arm = arm_of(machine.cell, truth, machine.campaign.targets)
    write_readings(folder / "tracker.csv", machine.cell, truth, arm, machine.campaign, noise_stream(truth.seed))


def label_path(check: Check, recipe: Recipe) -> Path:
    """Where the label of a world lies."""
    return check.folder / SEALED / f"{recipe.name}.json"


def _write_label(path: Path, recipe: Recipe, drawn: Drawn, withheld: tuple[str, ...]) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    content = {
        "recipe": asdict(recipe),
        "labels": labels(drawn.effects),
        "planted": [asdict(p) for p in drawn.effects],
        "detectability": list(drawn.lam),
        "withheld": list(withheld),
    }
    text = json.dumps(content, indent=1) + "\n"
    part = path.with_suffix(".part")
    part.write_text(text, encoding="utf-8")
    part.replace(path)  # whole or not at all


def read_label(check: Check, recipe: Recipe, seal: dict[str, str]) -> Label:
    """Open a label. Raises BadInput: it is not the one that was sealed."""
    path = label_path(check, recipe)
    if not path.is_file():
        raise BadInput(f"{path}: the label is missing; make the worlds anew with --overwrite")
    if seal.get(recipe.name) != digest(path):
        raise BadInput(f"{path}: is not what was sealed before the answers; make the worlds anew with --overwrite")
    content = json.loads(path.read_text(encoding="utf-8"))
    effects = []
    for p in content["planted"]:
        values = {k: tuple(v) if isinstance(v, list) else v for k, v in p["values"].items()}
        effects.append(Planted(p["effect"], p["joint"], values))
    return Label(recipe, tuple(effects), tuple(content["detectability"]), tuple(content["withheld"]))


def digest(path: Path) -> str:
    """SHA-256 of a file."""
    return hashlib.sha256(path.read_bytes()).hexdigest()


def write_seal(check: Check, hashes: dict[str, str]) -> None:
    """Hashes of all labels."""
    (check.folder / SEAL).write_text(json.dumps(hashes, indent=1) + "\n", encoding="utf-8")


def read_seal(check: Check) -> dict[str, str]:
    """Hashes of the labels, empty where none were sealed."""
    path = check.folder / SEAL
    return dict(json.loads(path.read_text(encoding="utf-8"))) if path.is_file() else {}
