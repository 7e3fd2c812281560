"""A blind check: where its files lie, and its labels, sealed with their hashes before any answer is made."""

import json
import os
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from ocp.blindtest.worlds.machines import BlindMachine, draw_machine
from ocp.blindtest.worlds.recipes import Recipe
from ocp.shell.cache import sha256
from ocp.simulate.twin.truth.planting import Planted, labels
from robots.errors import BadInput

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
        known = {"seed": self.seed, "kinds": list(self.kinds), "readings": self.readings, "blind": self.blind}
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
    return draw_machine(check.cell, check.seed, recipe, check.readings, check.blind, check.signals)


def label_path(check: Check, recipe: Recipe) -> Path:
    """Where the label of a world lies."""
    return check.folder / SEALED / f"{recipe.name}.json"


def write_whole(path: Path, text: str) -> None:
    """A file that is there whole or not at all."""
    path.parent.mkdir(parents=True, exist_ok=True)
    part = path.with_suffix(f".{os.getpid()}.part")
    part.write_text(text, encoding="utf-8")
    part.replace(path)


def write_label(path: Path, label: Label) -> None:
    """What was planted, as `read_label` opens it."""
    content = {
        "recipe": asdict(label.recipe),
        "labels": labels(label.effects),
        "planted": [asdict(p) for p in label.effects],
        "detectability": list(label.lam),
        "withheld": list(label.withheld),
    }
    write_whole(path, json.dumps(content, indent=1) + "\n")


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


def write_seal(check: Check, hashes: dict[str, str]) -> None:
    """Hashes of all labels."""
    (check.folder / SEAL).write_text(json.dumps(hashes, indent=1) + "\n", encoding="utf-8")


def read_seal(check: Check) -> dict[str, str]:
    """Hashes of the labels, empty where none were sealed."""
    path = check.folder / SEAL
    return dict(json.loads(path.read_text(encoding="utf-8"))) if path.is_file() else {}
