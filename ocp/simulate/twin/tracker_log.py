"""A tracker campaign: the postures, payloads, nests, approaches, times and temperatures of every reading, what is kept back to be
predicted, and the files of it in the form of FORMATS.md.
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
from ocp.simulate.twin.arm import Moments, VirtualArm, arm_moments, make_arm
from ocp.simulate.twin.planting import Planted, labels
from ocp.simulate.twin.tracker import TURN_SIGMA, measure, measure_turns, true_points
from ocp.simulate.twin.truth import Truth, draw_truth
from robots.csv_table import read_csv_table
from robots.errors import BadInput
from robots.pose import Array

AXES = tuple(f"q{i}_deg" for i in range(1, 7))
APPROACH = tuple(f"approach{i}" for i in range(1, 7))
HEAVY = "heavy"  # by convention the payload that only sealed conditions carry
# Box of postures, deg: in front of the robot, wrist turns that spare the cables.
_FRONT, _WRIST = 92.0, 175.0
_MARGIN = np.radians(0.5)  # from the axes' limits
# Where the flange may be, m per metre of the arm's reach: off the column, above the floor.
_COLUMN, _FLOOR = 0.22, 0.06
WARM_UP, WARM_TIME = 9.0, 4000.0  # K that a day's work heats the structure, s to reach 63 % of it
CAMPAIGN, SEALED_AFTER, SEALED_SPAN, SEALED_WARMTH = 10800.0, 500.0, 3700.0, 4.0  # s, s, s, K


@dataclass(frozen=True)
class TrackerCampaign:
    """Readings to take: their conditions, and the nest of each."""

    moments: Moments
    targets: tuple[str, ...]

    def __len__(self) -> int:
        return len(self.targets)


def random_design(
    cell: Cell,
    rng: np.random.Generator,
    n: int = 150,
    repeats: int = 6,
    payloads: Sequence[str] | None = None,
    targets: Sequence[str] | None = None,
    warm_up: float = WARM_UP,
    duration: float = CAMPAIGN,
) -> TrackerCampaign:
    """n readings as campaigns have them: the payloads one after another (three of the cell's, without "heavy"), nests and
    approaches at random, `repeats` of them a second time, while the structure warms up by `warm_up` K.

    Raises BadInput: the cell has no nests, or a payload is unknown.
    """
    hung = _payloads(cell, payloads)
    q = _postures(cell, rng, n)
    approach = rng.choice([-1.0, 1.0], (n, 6))
    blocks = np.sort(np.arange(n) % len(hung))
    label = rng.permutation(len(hung))[blocks]
    names = _targets(cell, targets)
    nest = rng.integers(len(names), size=n)
    for k in rng.choice(np.arange(1, n), min(repeats, n - 1), replace=False) if n > 1 else ():
        before = np.flatnonzero(label[:k] == label[k])
        if len(before):
            first = int(rng.choice(before))
            q[k], approach[k], nest[k] = q[first], approach[first], nest[first]
    time = np.sort(rng.uniform(0, duration, n)).round(1)
    temperature = cell.tables.reference_temperature_C + warm_up * (1 - np.exp(-time / WARM_TIME))
    m = arm_moments(q, tuple(hung[i] for i in label), temperature.round(2), approach, time)
    return TrackerCampaign(m, tuple(names[i] for i in nest))


def sealed_design(
    cell: Cell,
    rng: np.random.Generator,
    n: int = 120,
    payloads: Sequence[str] | None = None,
    targets: Sequence[str] | None = None,
) -> TrackerCampaign:
    """n conditions to predict blind, after the campaign: half with the workpiece's payload, half with one that was not measured
    ("heavy", else the heaviest), at another temperature."""
    known = list(cell.tables.payloads)
    if payloads is None and known:
        mass = [cell.tables.payloads[name].mass_kg for name in known]
        table = cell.tables.workpiece
        own = table.payload if table is not None and table.payload is not None else known[0]
        payloads = list(dict.fromkeys([own, HEAVY if HEAVY in known else known[int(np.argmax(mass))]]))
    hung, names = _payloads(cell, payloads), _targets(cell, targets)
    q = _postures(cell, rng, n)
    label = rng.permutation(len(hung))[np.sort(np.arange(n) % len(hung))]
    start = CAMPAIGN + SEALED_AFTER
    time = np.sort(rng.uniform(start, start + SEALED_SPAN, n)).round(1)
    temperature = cell.tables.reference_temperature_C + SEALED_WARMTH
    m = arm_moments(q, tuple(hung[i] for i in label), round(temperature, 2), rng.choice([-1.0, 1.0], (n, 6)), time)
    return TrackerCampaign(m, tuple(names[i] for i in rng.integers(len(names), size=n)))


def design_from_poses(cell: Cell, path: str | Path, seconds: float = 40.0, warm_up: float = 0.0) -> TrackerCampaign:
    """The readings of a poses.csv (columns q1_deg..q6_deg; target, payload, approach1..6 where known), `seconds` apart.

    Raises BadInput: as `read_csv_table`, a value that the cell does not know.
    """
    table = read_csv_table(path, AXES, ("target", "payload", *APPROACH), words=("target", "payload"))
    n = len(table)
    targets, payloads = _targets(cell, None), list(cell.tables.payloads)
    for column, known in (("target", targets), ("payload", payloads)):
        for row, name in enumerate(table.words.get(column, ())):
            if name not in known:
                raise table.refuse(row, column, f"is not in {cell.path.name} ({', '.join(known) or 'none'})")
    approach = table.stack(APPROACH) if all(c in table.numbers for c in APPROACH) else np.zeros((n, 6))
    time = seconds * np.arange(1, n + 1)
    temperature = cell.tables.reference_temperature_C + warm_up * (1 - np.exp(-time / WARM_TIME))
    hung = tuple(table.words.get("payload", [payloads[0] if payloads else ""] * n))
    m = arm_moments(np.radians(table.stack(AXES)), hung, temperature.round(2), approach, time)
    return TrackerCampaign(m, tuple(table.words.get("target", [targets[0]] * n)))


def _payloads(cell: Cell, asked: Sequence[str] | None) -> list[str]:
    known = list(cell.tables.payloads)
    unknown = [name for name in asked or () if name not in known]
    if unknown:
        raise BadInput(f"{cell.path}: payload '{unknown[0]}' is not among [payloads] ({', '.join(known) or 'none'})")
    return list(asked) if asked else [name for name in known if name != HEAVY][:3] or known[:1] or [""]


def _targets(cell: Cell, asked: Sequence[str] | None) -> list[str]:
    table = cell.tables.tracker
    known = list(table.targets) if table is not None else []
    if not known:
        raise BadInput(f"{cell.path}: the cell has no [tracker.targets]; name at least one reflector nest")
    return list(asked) if asked else known


def _postures(cell: Cell, rng: np.random.Generator, n: int) -> Array:
    """Axes (n, 6) rad in front of the robot with the flange off the column and the floor, rounded as files hold them."""
    robot = cell.robot
    box = np.radians([_FRONT, np.inf, np.inf, _WRIST, np.inf, _WRIST])
    low, high = np.maximum(robot.q_min + _MARGIN, -box), np.minimum(robot.q_max - _MARGIN, box)
    arm = make_arm(cell, draw_truth(cell, 0, mode="believed"))
    reach = float(np.abs(robot.mdh[:, 1:3]).sum())
    found, count = [np.empty((0, 6))], 0
    while count < n:
        q = rng.uniform(low, high, (n + 50, 6))
        links = arm.links(arm_moments(q, "", cell.tables.reference_temperature_C))[:, 4:, :3, 3]
        free = (np.hypot(links[..., 0], links[..., 1]) > _COLUMN * reach) & (links[..., 2] > _FLOOR * reach)
        kept = q[free.all(axis=1)]
        count += len(kept)
        found.append(kept)
    return np.asarray(np.radians(np.degrees(np.concatenate(found)[:n]).round(6)))


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
