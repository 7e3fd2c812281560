"""A data set folder in the form of FORMATS.md: cell.toml with what it names, logs, and what was planted."""

import csv
import json
import re
import shutil
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from ocp.model.cell import Cell
from ocp.simulate.twin.run import Grinding
from ocp.simulate.twin.truth.planting import labels
from ocp.simulate.twin.truth.truth import Truth
from robots.errors import BadInput

FORCE_COLUMNS = (
    "run", "time_s", "clock_s", *(f"q{i}_deg" for i in range(1, 7)), "px_mm", "py_mm", "pz_mm", "nx", "ny", "nz", "tx", "ty",
    "tz", "s_mm", "setpoint_N", "feed_mm_s", "belt_m_s", "line", "ground_before", "contact", "session", "temperature_C",
    "wheel_temperature_C", "fn_N", "ft_N",
)  # fmt: skip
READ = ("fn_N", "ft_N")
_FORMATS = {"run": "d", "line": "d", "ground_before": "d", "contact": "d", "fn_N": ".4f", "ft_N": ".4f", "temperature_C": ".2f",
            "wheel_temperature_C": ".2f", "time_s": ".4f", "clock_s": ".3f", "px_mm": ".5f", "py_mm": ".5f", "pz_mm": ".5f",
            "s_mm": ".4f", "setpoint_N": "g", "belt_m_s": "g", "feed_mm_s": ".3f"}  # fmt: skip


def copy_cell(cell: Cell, folder: Path) -> None:
    """cell.toml and the files it names into `folder`, names in it shortened to what stands beside it.

    Raises BadInput: a file that the cell names cannot be read.
    """
    text = cell.path.read_text(encoding="utf-8")
    calibration, model = cell.tables.robot.calibration, cell.tables.robot.model
    if cell.workpiece.stl is not None:
        text = _beside(text, "stl", cell.workpiece.stl, folder)
    if calibration is not None:
        file = cell.path.parent / calibration
        text = _beside(text, "calibration", file, folder)
        for partner in file.parent.glob(f"{file.stem}.npz"):
            shutil.copyfile(partner, folder / partner.name)
    if model.endswith(".toml") and (cell.path.parent / model).exists():
        text = _beside(text, "model", cell.path.parent / model, folder)
    (folder / "cell.toml").write_text(text, encoding="utf-8")


def _beside(text: str, key: str, file: Path, folder: Path) -> str:
    """Copy a file and let `key` name the copy."""
    try:
        shutil.copyfile(file, folder / file.name)
    except OSError as error:
        raise BadInput(f"{file}: cannot be copied beside the cell ({error.strerror})") from None
    name = json.dumps(file.name)
    return re.sub(rf"^(\s*{key}\s*=\s*)(\"[^\"\n]*\"|'[^'\n]*')", lambda found: found.group(1) + name, text, count=1, flags=re.M)


def force_rows(recordings: Sequence[Grinding], first_run: int = 0, truth: bool = False) -> tuple[list[list[str]], int]:
    """Rows of a force log, one recording a pass, and the number of the next recording; `truth`: noise-free forces."""
    rows: list[list[str]] = []
    number = first_run
    for recording in recordings:
        columns = _columns(recording, truth)
        for k in dict.fromkeys(recording.moments.run.tolist()):
            mine = np.flatnonzero(recording.moments.run == k)
            columns["run"] = np.full(len(recording.index), number)
            rows += [[_text(name, columns[name][i]) for name in FORCE_COLUMNS] for i in mine]
            number += 1
    return rows, number


def _columns(g: Grinding, truth: bool) -> dict[str, Any]:
    m = g.moments
    n = len(g.index)
    columns: dict[str, Any] = {"time_s": m.time_s, "clock_s": m.clock_s}
    columns |= {f"q{i + 1}_deg": np.degrees(g.q[:, i]) for i in range(6)}
    columns |= {f"p{a}_mm": 1e3 * m.p[:, i] for i, a in enumerate("xyz")}
    columns |= {f"{stem}{a}": v[:, i] for stem, v in (("n", m.n), ("t", m.t)) for i, a in enumerate("xyz")}
    columns |= {
        "s_mm": 1e3 * m.s, "setpoint_N": m.setpoint, "feed_mm_s": 1e3 * m.feed, "belt_m_s": m.belt, "line": m.line,
        "ground_before": m.ground_before, "contact": m.contact.astype(int), "session": np.full(n, g.conditions.session),
        "temperature_C": m.temperature_C, "wheel_temperature_C": m.wheel_temperature_C,
        "fn_N": g.result.force if truth else g.fn, "ft_N": g.result.tangential if truth else g.ft,
    }  # fmt: skip
    return columns


def _text(name: str, value: Any) -> str:
    if isinstance(value, str):
        return value
    form = _FORMATS.get(name, ".6f")
    text = format(int(value), "d") if form == "d" else format(float(value), form)
    return text.lstrip("-") if float(text) == 0 else text


def write_force(folder: Path, recordings: Sequence[Grinding], sealed: Sequence[Grinding]) -> int:
    """force.csv, and sealed_force.csv with its truth in labels/ where there is a sealed part; the number of rows logged."""
    rows, following = force_rows(recordings)
    write_csv(folder / "force.csv", FORCE_COLUMNS, rows)
    if sealed:
        hidden, _ = force_rows(sealed, following, truth=True)
        open_columns = [c for c in FORCE_COLUMNS if c not in READ]
        keep = [FORCE_COLUMNS.index(c) for c in open_columns]
        write_csv(folder / "sealed_force.csv", open_columns, [[row[i] for i in keep] for row in hidden])
        write_csv(folder / "labels" / "sealed_force_truth.csv", FORCE_COLUMNS, hidden)
    return len(rows)


def write_csv(path: Path, columns: Iterable[str], rows: Iterable[Sequence[str]]) -> None:
    """A CSV file with a header."""
    path.parent.mkdir(parents=True, exist_ok=True)
    with path.open("w", newline="", encoding="ascii") as file:
        csv.writer(file, lineterminator="\n").writerows([list(columns), *rows])


def write_labels(folder: Path, truth: Truth, machine: str) -> None:
    """labels/labels.json: what was planted, and the seed."""
    (folder / "labels").mkdir(exist_ok=True)
    content = {"seed": truth.seed, "machine": machine, "labels": labels(truth.effects)}
    (folder / "labels" / "labels.json").write_text(json.dumps(content, indent=1) + "\n", encoding="utf-8")
