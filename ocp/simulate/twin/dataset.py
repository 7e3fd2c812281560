"""The files of a data set in the form of FORMATS.md: cell.toml with what it names, force.csv, joints.csv, and what was planted.

In joints.csv the gap between motor and link side is what gears, heat and springs do; a link-side encoder sees it without any
tracker, and without the geometry. Its own errors here are noise alone: scale and mounting of a good encoder are below that.
"""

import csv
import json
import re
import shutil
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from ocp.model.cell import Cell
from ocp.simulate.twin.arm import AxisState, Moments, VirtualArm, motor_side
from ocp.simulate.twin.contact.sensor import delayed
from ocp.simulate.twin.planting import labels
from ocp.simulate.twin.run import GroundPasses
from ocp.simulate.twin.truth import Truth
from robots.errors import BadInput
from robots.pose import Array

FORCE_COLUMNS = tuple(
    "run time_s clock_s q1_deg q2_deg q3_deg q4_deg q5_deg q6_deg px_mm py_mm pz_mm nx ny nz tx ty tz s_mm setpoint_N feed_mm_s "
    "belt_m_s line ground_before contact session temperature_C wheel_temperature_C fn_N ft_N".split()
)
READ = ("fn_N", "ft_N")
_BY_FORMAT = {
    "d": "run line ground_before contact",
    "g": "setpoint_N belt_m_s",
    ".2f": "temperature_C wheel_temperature_C",
    ".3f": "clock_s feed_mm_s",
    ".4f": "time_s s_mm fn_N ft_N",
    ".5f": "px_mm py_mm pz_mm",
}
_FORMATS = {name: form for form, names in _BY_FORMAT.items() for name in names.split()}


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
        content = file.read_bytes()
    except OSError as error:
        raise BadInput(f"{file}: cannot be copied beside the cell ({error.strerror}); give a file that can be read") from None
    (folder / file.name).write_bytes(content)
    name = json.dumps(file.name)
    return re.sub(rf"^(\s*{key}\s*=\s*)(\"[^\"\n]*\"|'[^'\n]*')", lambda found: found.group(1) + name, text, count=1, flags=re.M)


def log_rows(recordings: Sequence[GroundPasses], first_run: int = 0, truth: bool = False) -> tuple[list[list[str]], int]:
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


def _columns(g: GroundPasses, truth: bool) -> dict[str, Any]:
    m = g.moments
    n = len(g.index)
    columns: dict[str, Any] = {"time_s": m.time_s, "clock_s": m.clock_s}
    columns |= {f"q{i + 1}_deg": np.degrees(g.q[:, i]) for i in range(6)}
    columns |= {f"p{a}_mm": 1e3 * m.p[:, i] for i, a in enumerate("xyz")}
    columns |= {f"{stem}{a}": v[:, i] for stem, v in (("n", m.n), ("t", m.t)) for i, a in enumerate("xyz")}
    columns |= {
        "s_mm": 1e3 * m.s,
        "setpoint_N": m.setpoint,
        "feed_mm_s": 1e3 * m.feed,
        "belt_m_s": m.belt,
        "line": m.line,
        "ground_before": m.ground_before,
        "contact": m.contact.astype(int),
        "session": ["1"] * n,
        "temperature_C": m.temperature_C,
        "wheel_temperature_C": m.wheel_temperature_C,
        "fn_N": g.result.force if truth else g.fn,
        "ft_N": g.result.tangential if truth else g.ft,
    }
    return columns


def _text(name: str, value: Any) -> str:
    if isinstance(value, str):
        return value
    form = _FORMATS.get(name, ".6f")
    text = format(int(value), "d") if form == "d" else format(float(value), form)
    return text.lstrip("-") if float(text) == 0 else text


def write_force(folder: Path, recordings: Sequence[GroundPasses], sealed: Sequence[GroundPasses]) -> int:
    """force.csv, and sealed_force.csv with its truth in labels/ where there is a sealed part; the number of rows logged."""
    rows, following = log_rows(recordings)
    write_csv(folder / "force.csv", FORCE_COLUMNS, rows)
    if sealed:
        hidden, _ = log_rows(sealed, following, truth=True)
        write_sealed_force(folder, hidden)
        write_csv(folder / "labels" / "sealed_force_truth.csv", FORCE_COLUMNS, hidden)
    return len(rows)


def write_removal(folder: Path, p: Array, depth: Array, sd: float, clock: float) -> None:
    """removal.csv: depths (k,) m measured at places p (k, 3) m of the blade, one sigma m, when the campaign's clock showed s."""
    told = f"{1e6 * sd:.3f}", f"{clock:.1f}"
    rows = [[*(f"{1e3 * v:.4f}" for v in place), f"{1e6 * one:.3f}", *told] for place, one in zip(p, depth, strict=True)]
    write_csv(folder / "removal.csv", ("px_mm", "py_mm", "pz_mm", "removal_um", "sd_um", "clock_s"), rows)


def write_sealed_force(folder: Path, rows: Sequence[Sequence[str]]) -> None:
    """sealed_force.csv: the rows of `log_rows` without what was read."""
    keep = [k for k, name in enumerate(FORCE_COLUMNS) if name not in READ]
    write_csv(folder / "sealed_force.csv", [FORCE_COLUMNS[k] for k in keep], [[row[k] for k in keep] for row in rows])


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


# One sigma: a good link-side encoder (1 arcsec), a motor current as torque.
LINK_SIGMA, TORQUE_SIGMA = 4.8e-6, 4.0  # rad, N m


def joint_log(arm: VirtualArm, truth: Truth, m: Moments, run: Array, time_s: Array, rng: np.random.Generator) -> dict[str, Array]:
    """Columns of joints.csv (FORMATS) for instants in time order inside each run: run (n,), time_s (n,) s since its start.

    q: motor side through the ratio, as commanded; link: what the axis does, with gear errors, heat, play and the spring's
    give; tau: motor torque on the link side. A planted channel_delay records the link side later: of its joint, or of all.
    """
    settled = arm.settled(m)
    warmth = m.temperature_C - arm.reference_C
    link = motor_side(truth, AxisState(m.q, m.approach, warmth, arm.robot)) + settled.bent[:, :6]
    tau = settled.motor_torque
    for planted in truth.planted("channel_delay"):
        late = range(6) if planted.joint is None else [planted.joint - 1]
        for j in late:
            link[:, j] = delayed(link[:, j], run, time_s, planted.number("s"))
    link = link + rng.normal(size=link.shape) * LINK_SIGMA
    tau = tau + rng.normal(size=tau.shape) * TORQUE_SIGMA
    columns = {"run": np.asarray(run, float), "time_s": np.asarray(time_s, float)}
    for name, values, factor in (("q{}_deg", m.q, 180 / np.pi), ("link{}_deg", link, 180 / np.pi), ("tau{}_Nm", tau, 1.0)):
        columns |= {name.format(j + 1): factor * values[:, j] for j in range(6)}
    return columns


def write_joint_log(path: Path, columns: dict[str, Array]) -> None:
    """Write columns (n,) as joints.csv: angles to 1e-7 deg, torques to 0.01 N m, times to 0.1 ms."""
    digits = {"run": 0, "time_s": 4}
    forms = [digits.get(name, 2 if name.startswith("tau") else 7) for name in columns]
    rows = zip(*columns.values(), strict=True)
    write_csv(path, columns, ([f"{value:.{form}f}" for value, form in zip(row, forms, strict=True)] for row in rows))
