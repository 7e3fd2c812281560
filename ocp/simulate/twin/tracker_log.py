"""The tracker campaign of a simulated day: which postures, every nest in each, and what is kept back to be predicted."""

import csv
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ocp.model.cell import Cell
from ocp.simulate.twin.arm.arm import Arm, moments
from ocp.simulate.twin.designs import Campaign, design_from_poses, random_design, sealed_design
from ocp.simulate.twin.tracker import true_points
from ocp.simulate.twin.truth.machine import Truth
from ocp.simulate.twin.worlds import CONDITIONS, POINT, noise_stream, write_readings
from robots.errors import BadInput

MOST = 2000  # postures
BLIND = 60  # readings kept back
READING = 15.0  # s from one nest to the next in a posture
_DESIGN = 103  # stream of the postures, beside those of the machine and its instruments


@dataclass(frozen=True)
class TrackerLog:
    """Readings to take, and those to predict (None: nothing is kept back)."""

    design: Campaign
    sealed: Campaign | None

    @property
    def count(self) -> int:
        """Readings."""
        return len(self.design)


def tracker_log(poses: str, cell: Cell, seed: int, sealed: bool) -> TrackerLog:
    """The campaign of `poses`: a number of random postures, each with all nests on the flange and links, or a poses.csv or its
    folder.

    Raises BadInput: neither a number in range nor a file, a cell without nests, as `design_from_poses`.
    """
    rng = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(_DESIGN,)))
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


def every_nest(cell: Cell, design: Campaign) -> Campaign:
    """Each posture read once for every nest, one after the other."""
    table = cell.tables.tracker
    names = list(table.targets) if table is not None else []
    rows = np.repeat(np.arange(len(design)), len(names))
    m = design.moments
    payload = m.payload if isinstance(m.payload, str) else tuple(m.payload[k] for k in rows)
    time = np.maximum.accumulate(m.time_s[rows] + READING * np.tile(np.arange(len(names)), len(design)))
    repeated = moments(m.q[rows], payload, m.temperature_C[rows], m.approach[rows], time, visit=rows)
    return Campaign(repeated, tuple(names) * len(design))


def write_tracker(folder: Path, cell: Cell, truth: Truth, arm: Arm, log: TrackerLog) -> None:
    """tracker.csv; with a sealed part sealed_tracker.csv and its noise-free truth in labels/."""
    write_readings(folder / "tracker.csv", cell, truth, arm, log.design, noise_stream(truth.seed))
    if log.sealed is not None:
        (folder / "labels").mkdir(exist_ok=True)
        points = true_points(truth, cell, arm, log.sealed.moments, log.sealed.targets)
        rows = _conditions(log.sealed)
        _write(folder / "sealed_tracker.csv", CONDITIONS, rows)
        read = [[*row, *(f"{1e3 * v:.4f}" for v in point)] for row, point in zip(rows, points, strict=True)]
        _write(folder / "labels" / "sealed_tracker_truth.csv", (*CONDITIONS, *POINT), read)


def _conditions(design: Campaign) -> list[list[str]]:
    m = design.moments
    return [
        [f"{m.time_s[k]:.1f}", f"{m.temperature_C[k]:.2f}", m.payload if isinstance(m.payload, str) else m.payload[k], target,
         *(f"{v:.6f}" for v in np.degrees(m.q[k])), *(f"{s:.0f}" for s in m.approach[k])]
        for k, target in enumerate(design.targets)
    ]  # fmt: skip


def _write(path: Path, header: tuple[str, ...], rows: list[list[str]]) -> None:
    with path.open("w", newline="", encoding="ascii") as file:
        csv.writer(file, lineterminator="\n").writerows([header, *rows])
