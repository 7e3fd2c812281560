"""The files of a tracker campaign in the form of FORMATS.md: postures with every nest in each, readings, what is kept back to be
predicted, and what was planted.
"""

import csv
import json
import re
import shutil
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import numpy as np
from scipy.spatial.transform import Rotation

from ocp.model.cell import Cell, read_cell
from ocp.simulate.twin.arm.arm import VirtualArm, arm_moments, make_arm
from ocp.simulate.twin.designs import APPROACH, AXES, TrackerCampaign, design_from_poses, random_design, sealed_design
from ocp.simulate.twin.tracker import TURN_SIGMA, measure, measure_turns, true_points
from ocp.simulate.twin.truth.planting import Planted, labels
from ocp.simulate.twin.truth.truth import Truth, draw_truth
from robots.errors import BadInput
from robots.pose import Array

CONDITIONS = ("time_s", "temperature_C", "payload", "target", *AXES, *APPROACH)
LOAD = ("fx_N", "fy_N", "fz_N", "mx_Nm", "my_Nm", "mz_Nm", "load_link", "lx_mm", "ly_mm", "lz_mm")
POINT = ("x_mm", "y_mm", "z_mm")
TURN = ("rx_deg", "ry_deg", "rz_deg", "sigma_rot_deg")
_NOISE, _DESIGN, _POSTURES = 101, 102, 103  # streams beside those of the truth


def tracker_world(
    cell_path: str | Path,
    folder: str | Path,
    truth: Truth,
    design: TrackerCampaign,
    sealed: TrackerCampaign | None = None,
    label: bool = True,
) -> None:
    """Write cell.toml and tracker.csv of a campaign into `folder`; with `sealed` also sealed_tracker.csv; with `label` the
    folder labels/: labels.json (seed, what was planted) and sealed_tracker_truth.csv, free of noise with effects included."""
    folder = Path(folder)
    folder.mkdir(parents=True, exist_ok=True)
    cell = read_cell(cell_path)
    _copy_cell(Path(cell_path), cell, folder)
    arm = make_arm(cell, truth)
    write_readings(folder / "tracker.csv", cell, truth, arm, design, noise_stream(truth.seed))
    if sealed is not None:
        _write(folder / "sealed_tracker.csv", sealed)
    if label:
        (folder / "labels").mkdir(exist_ok=True)
        content = {"seed": truth.seed, "labels": labels(truth.effects)}
        (folder / "labels" / "labels.json").write_text(json.dumps(content, indent=1) + "\n", encoding="utf-8")
        if sealed is not None:
            _write_truth(folder, cell, truth, arm, sealed)


def random_world(
    cell_path: str | Path,
    folder: str | Path,
    seed: int,
    effects: Sequence[Planted] = (),
    readings: int = 150,
    blind: int = 120,
    weight_bends: Literal["all", "believed"] = "believed",
) -> Truth:
    """A whole world of one seed: machine, campaign and sealed conditions; the truth that was written.

    Weight bends only the joints that the cell believes in, unless asked: the labels then hold all there is to name.
    """
    cell = read_cell(cell_path)
    truth = draw_truth(cell, seed, effects, weight_bends=weight_bends)
    rng = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(_DESIGN,)))
    tracker_world(cell_path, folder, truth, random_design(cell, rng, readings), sealed_design(cell, rng, blind))
    return truth


def noise_stream(seed: int) -> np.random.Generator:
    """The random numbers of the instrument and of repeatability, apart from those of the machine."""
    return np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(_NOISE,)))


def write_readings(
    path: Path, cell: Cell, truth: Truth, arm: VirtualArm, design: TrackerCampaign, rng: np.random.Generator
) -> None:
    """Take the readings of a campaign and write them; orientations too where a nest is a 6D target."""
    m, names = design.moments, design.targets
    points = measure(truth, cell, arm, m, names, rng)
    turns = None
    if any(name in truth.nest_turns for name in names):
        R, turned = measure_turns(truth, cell, arm, m, names, rng)
        turns = np.where(turned[:, None], Rotation.from_matrix(R).as_euler("xyz", degrees=True), np.nan)
    _write(path, design, points, turns)


def _write(path: Path, design: TrackerCampaign, points: Array | None = None, turns: Array | None = None) -> None:
    """One row a reading; columns of loads where there are any, of measurements where they are given."""
    m = design.moments
    loaded = bool(m.load.any())
    header = [
        *CONDITIONS,
        *(LOAD if loaded else ()),
        *(POINT if points is not None else ()),
        *(TURN if turns is not None else ()),
    ]
    with path.open("w", newline="", encoding="ascii") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(header)
        q = np.degrees(m.q)
        for k, target in enumerate(design.targets):
            payload = m.payload if isinstance(m.payload, str) else m.payload[k]
            row = [f"{m.time_s[k]:.1f}", f"{m.temperature_C[k]:.2f}", payload, target]
            row += [f"{v:.6f}" for v in q[k]] + [f"{s:.0f}" for s in m.approach[k]]
            if loaded:
                row += [f"{v:.3f}" for v in m.load[k]] + [f"{m.load_link[k]}"] + [f"{1e3 * v:.3f}" for v in m.load_place[k]]
            if points is not None:
                row += [f"{1e3 * v:.4f}" for v in points[k]]
            if turns is not None:
                blank = bool(np.isnan(turns[k]).any())
                row += [""] * 4 if blank else [*(f"{v:.5f}" for v in turns[k]), f"{np.degrees(TURN_SIGMA):.5f}"]
            writer.writerow(row)


def _copy_cell(path: Path, cell: Cell, folder: Path) -> None:
    """The cell as believed before any calibration, with the robot's file where it has one of its own."""
    text = re.sub(r"(?m)^\s*calibration\s*=.*\n", "", path.read_text(encoding="utf-8-sig"))
    (folder / "cell.toml").write_text(text, encoding="utf-8")
    model = path.parent / cell.tables.robot.model
    if model.suffix == ".toml" and model.exists():
        shutil.copy(model, folder / model.name)


MOST = 2000  # postures
BLIND = 60  # readings kept back
READING = 15.0  # s from one nest to the next in a posture


@dataclass(frozen=True)
class TrackerLog:
    """Readings to take, and those to predict (None: nothing is kept back)."""

    design: TrackerCampaign
    sealed: TrackerCampaign | None

    @property
    def count(self) -> int:
        """Readings."""
        return len(self.design)


def tracker_log(poses: str, cell: Cell, seed: int, sealed: bool) -> TrackerLog:
    """The campaign of `poses`: a number of random postures, each with all nests on the flange and links, or a poses.csv or its
    folder.

    Raises BadInput: neither a number in range nor a file, a cell without nests, as `design_from_poses`.
    """
    rng = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(_POSTURES,)))
    if poses.lstrip("-").isdecimal():
        n = int(poses)
        if not 4 <= n <= MOST:
            raise BadInput(f"--poses {n}: give 4 to {MOST} postures, 0 for no campaign, or the folder that ocp.poses wrote")
        design = every_nest(cell, random_design(cell, rng, n, repeats=min(6, n // 8)))
    else:
        path = Path(poses)
        file = path / "poses.csv" if path.is_dir() else path
        if not file.is_file():
            raise BadInput(f"--poses '{poses}': is neither a number nor a folder of ocp.poses; give one of them")
        design = design_from_poses(cell, file)
    return TrackerLog(design, sealed_design(cell, rng, BLIND) if sealed else None)


def every_nest(cell: Cell, design: TrackerCampaign) -> TrackerCampaign:
    """Each posture read once for every nest, one after the other."""
    table = cell.tables.tracker
    names = list(table.targets) if table is not None else []
    rows = np.repeat(np.arange(len(design)), len(names))
    m = design.moments
    payload = m.payload if isinstance(m.payload, str) else tuple(m.payload[k] for k in rows)
    time = np.maximum.accumulate(m.time_s[rows] + READING * np.tile(np.arange(len(names)), len(design)))
    repeated = arm_moments(m.q[rows], payload, m.temperature_C[rows], m.approach[rows], time, visit=rows)
    return TrackerCampaign(repeated, tuple(names) * len(design))


def write_tracker(folder: Path, cell: Cell, truth: Truth, arm: VirtualArm, log: TrackerLog) -> None:
    """tracker.csv; with a sealed part sealed_tracker.csv and its noise-free truth in labels/."""
    write_readings(folder / "tracker.csv", cell, truth, arm, log.design, noise_stream(truth.seed))
    if log.sealed is not None:
        _write(folder / "sealed_tracker.csv", log.sealed)
        _write_truth(folder, cell, truth, arm, log.sealed)


def _write_truth(folder: Path, cell: Cell, truth: Truth, arm: VirtualArm, sealed: TrackerCampaign) -> None:
    """labels/sealed_tracker_truth.csv."""
    (folder / "labels").mkdir(exist_ok=True)
    points = true_points(truth, cell, arm, sealed.moments, sealed.targets)
    _write(folder / "labels" / "sealed_tracker_truth.csv", sealed, points)
