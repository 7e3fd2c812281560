"""The virtual laser tracker: where it sees a reflector, with its own noise, its faults and what was planted in it; and a
campaign of it: postures, payloads, nests, approaches, times and temperatures of every reading, what is kept back to be predicted,
and its files in the form of FORMATS.md.
"""

import re
import shutil
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from ocp.model.cell import Cell
from ocp.simulate.twin.arm import Moments, VirtualArm, arm_moments, make_arm
from ocp.simulate.twin.collide import height_over_floor
from ocp.simulate.twin.dataset import write_csv
from ocp.simulate.twin.truth import Truth, draw_truth
from robots.csv_table import read_csv_table
from robots.errors import BadInput, Infeasible, shown
from robots.pose import Array, apply

# A gross reading: a beam that was cut, a reflector not seated, a ghost. Distance m, log-evenly, any direction.
GROSS = (3e-4, 1e-2)
TURN_SIGMA = 1.5e-4  # rad, 0.01 deg of a 6D target


def nest_links(cell: Cell, names: Sequence[str]) -> Array:
    """Link (n,) 0..6 of every nest. Raises BadInput: a name that the cell does not have."""
    table = cell.tables.tracker
    known = table.targets if table is not None else {}
    unknown = next((name for name in names if name not in known), None)
    if unknown is not None:
        raise BadInput(f"{cell.path}: target '{unknown}' is not among [tracker.targets] ({', '.join(known) or 'none'})")
    links = {name: 6 if isinstance(target, tuple) else target.link for name, target in known.items()}
    return np.array([links[name] for name in names], np.int64)


def true_points(
    truth: Truth, cell: Cell, arm: VirtualArm, m: Moments, names: Sequence[str], rng: np.random.Generator | None = None
) -> Array:
    """Reflectors (n, 3) m in the tracker's frame, planted effects included and noise not; names: the nest of each instant.

    With rng the joints repeat as well as they do. Tracker effects: a nest that moves at a time, a frame that drifts and
    turns about the head with time, an azimuth circle, a scale that may go with the temperature.
    """
    links = arm.links(m, rng)
    nest = np.array([truth.nests[name] for name in names]).reshape(-1, 3)
    label = np.array(names)
    for planted in truth.planted("target_shift"):
        moved = (label == planted.word("target")) & (m.time_s >= planted.number("at_s"))
        nest = nest + np.where(moved[:, None], planted.vector("shift_m"), 0.0)
    on = links[np.arange(len(m)), nest_links(cell, names)]
    points = apply(truth.T_tracker_base, apply(on, nest))
    hours = m.time_s[:, None] / 3600.0
    for planted in truth.planted("tracker_drift"):
        turn = Rotation.from_rotvec(hours * planted.vector("rad_per_h"))
        points = turn.apply(points) + hours * planted.vector("m_per_h")
    for planted in truth.planted("azimuth_harmonic"):
        azimuth = np.arctan2(points[:, 1], points[:, 0])
        turned = planted.number("rad") * np.cos(planted.number("order") * azimuth + planted.number("phase_rad"))
        points = Rotation.from_rotvec(turned[:, None] * [0.0, 0.0, 1.0]).apply(points)
    warmth = m.temperature_C - cell.tables.reference_temperature_C
    scale = truth.total("tracker_scale", "scale") + truth.total("air_scale", "per_K") * warmth
    return np.asarray(points * (1 + scale)[:, None])


def measure(truth: Truth, cell: Cell, arm: VirtualArm, m: Moments, names: Sequence[str], rng: np.random.Generator) -> Array:
    """Readings (n, 3) m in the tracker's frame: joints repeat, range and two angles scatter, a share is grossly wrong."""
    return instrument(cell, truth.outliers, true_points(truth, cell, arm, m, names, rng), rng, truth.tails)


def instrument_noise(cell: Cell) -> tuple[float, float]:
    """One sigma along the beam m, and of the transverse noise m per metre of range."""
    table = cell.tables.tracker
    um, um_per_m = (8.0, 3.0) if table is None else (table.range_noise_um, table.transverse_noise_um_per_m)
    return 1e-6 * um, 1e-6 * um_per_m


def instrument(cell: Cell, outliers: float, points: Array, rng: np.random.Generator, tails: float = np.inf) -> Array:
    """What the instrument reads of points (n, 3) m: azimuth, elevation and range, each with its own noise.

    One sigma along the beam is the cell's range noise; across it, in both angles, range noise plus the transverse noise per
    metre of range, taken as the angle it is (FORMATS, [tracker]). tails: degrees of freedom of Student's law, the same factor for
    all three of a reading; inf: normal.
    """
    along, per_metre = instrument_noise(cell)
    n = len(points)
    flat = np.hypot(points[:, 0], points[:, 1])
    distance = np.hypot(flat, points[:, 2])
    across = (along + per_metre * distance) / distance
    z = rng.normal(size=(n, 3))
    if np.isfinite(tails):
        z *= np.sqrt(tails / rng.chisquare(tails, (n, 1)))
    elevation = np.arctan2(points[:, 2], flat) + across * z[:, 1]
    azimuth = np.arctan2(points[:, 1], points[:, 0]) + across * distance / np.maximum(flat, 1e-3) * z[:, 2]
    reach = distance + along * z[:, 0]
    level = reach * np.cos(elevation)
    read = np.stack([level * np.cos(azimuth), level * np.sin(azimuth), reach * np.sin(elevation)], axis=1)
    gross = rng.random(n) < outliers
    direction = rng.normal(size=(n, 3))
    size = np.exp(rng.uniform(np.log(GROSS[0]), np.log(GROSS[1]), n)) / np.linalg.norm(direction, axis=1)
    return np.asarray(np.where(gross[:, None], read + size[:, None] * direction, read))


def measure_turns(
    truth: Truth, cell: Cell, arm: VirtualArm, m: Moments, names: Sequence[str], rng: np.random.Generator | None
) -> tuple[Array, Array]:
    """Orientations (n, 3, 3) of 6D targets in the tracker's frame and which rows (n,) have one; without rng free of noise."""
    links = arm.links(m)
    on = links[np.arange(len(m)), nest_links(cell, names), :3, :3]
    turned = np.array([name in truth.nest_turns for name in names])
    mount = Rotation.from_rotvec([truth.nest_turns.get(name, np.zeros(3)) for name in names]).as_matrix()
    noise = Rotation.from_rotvec(rng.normal(size=(len(m), 3)) * TURN_SIGMA).as_matrix() if rng is not None else np.eye(3)
    return np.asarray(truth.T_tracker_base[:3, :3] @ on @ mount @ noise), turned


AXES = tuple(f"q{i}_deg" for i in range(1, 7))
APPROACH = tuple(f"approach{i}" for i in range(1, 7))
HEAVY = "heavy"  # by convention the payload that only sealed conditions carry
# Box of postures, deg: in front of the robot, wrist turns that spare the cables.
_FRONT, _WRIST = 92.0, 175.0
_MARGIN = np.radians(0.5)  # from the axes' limits
# Where the flange may be, m per metre of the arm's reach: off the column, above the floor.
_COLUMN, _FLOOR = 0.22, 0.06
_TRIES = 40  # times so many postures are drawn as are asked for; one in three is free of a floor at the base
WARM_UP, WARM_TIME = 9.0, 4000.0  # K that a day's work heats the structure, s to reach 63 % of it
BETWEEN = 40.0  # s from one posture of a poses.csv to the next
CAMPAIGN, SEALED_AFTER, SEALED_SPAN, SEALED_WARMTH = 10800.0, 500.0, 3700.0, 4.0  # s, s, s, K


@dataclass(frozen=True)
class TrackerCampaign:
    """Readings to take: their conditions, and the nest of each."""

    moments: Moments
    targets: tuple[str, ...]

    def __len__(self) -> int:
        return len(self.targets)


def random_design(
    cell: Cell, rng: np.random.Generator, n: int = 150, repeats: int = 6, warm_up: float = WARM_UP
) -> TrackerCampaign:
    """n readings as campaigns have them: the payloads one after another (three of the cell's, without "heavy"), nests and
    approaches at random, `repeats` of them a second time, while the structure warms up by `warm_up` K.

    Raises BadInput: the cell has no nests.
    """
    known = list(cell.tables.payloads)
    hung = [name for name in known if name != HEAVY][:3] or known[:1] or [""]
    q = _postures(cell, rng, n)
    approach = rng.choice([-1.0, 1.0], (n, 6))
    blocks = np.sort(np.arange(n) % len(hung))
    label = rng.permutation(len(hung))[blocks]
    names = _targets(cell)
    nest = rng.integers(len(names), size=n)
    for k in rng.choice(np.arange(1, n), min(repeats, n - 1), replace=False) if n > 1 else ():
        before = np.flatnonzero(label[:k] == label[k])
        if len(before):
            first = int(rng.choice(before))
            q[k], approach[k], nest[k] = q[first], approach[first], nest[first]
    time = np.sort(rng.uniform(0, CAMPAIGN, n)).round(1)
    temperature = cell.tables.reference_temperature_C + warm_up * (1 - np.exp(-time / WARM_TIME))
    m = arm_moments(q, tuple(hung[i] for i in label), temperature.round(2), approach, time)
    return TrackerCampaign(m, tuple(names[i] for i in nest))


def sealed_design(cell: Cell, rng: np.random.Generator, n: int = 120) -> TrackerCampaign:
    """n conditions to predict blind, after the campaign: half with the workpiece's payload, half with one that was not measured
    ("heavy", else the heaviest), at another temperature."""
    known, hung = cell.tables.payloads, [""]
    if known:
        table = cell.tables.workpiece
        own = table.payload if table is not None and table.payload is not None else next(iter(known))
        hung = list(dict.fromkeys([own, HEAVY if HEAVY in known else max(known, key=lambda name: known[name].mass_kg)]))
    names = _targets(cell)
    q = _postures(cell, rng, n)
    label = rng.permutation(len(hung))[np.sort(np.arange(n) % len(hung))]
    start = CAMPAIGN + SEALED_AFTER
    time = np.sort(rng.uniform(start, start + SEALED_SPAN, n)).round(1)
    temperature = cell.tables.reference_temperature_C + SEALED_WARMTH
    m = arm_moments(q, tuple(hung[i] for i in label), round(temperature, 2), rng.choice([-1.0, 1.0], (n, 6)), time)
    return TrackerCampaign(m, tuple(names[i] for i in rng.integers(len(names), size=n)))


def design_from_poses(cell: Cell, path: str | Path) -> TrackerCampaign:
    """The readings of a poses.csv (columns q1_deg..q6_deg; target, payload, approach1..6 where known), BETWEEN s apart.

    Raises BadInput: as `read_csv_table`, a value that the cell does not know.
    """
    table = read_csv_table(path, AXES, ("target", "payload", *APPROACH), words=("target", "payload"))
    n = len(table)
    targets, payloads = _targets(cell), list(cell.tables.payloads)
    for column, known in (("target", targets), ("payload", payloads)):
        for row, name in enumerate(table.words.get(column, ())):
            if name not in known:
                raise table.refuse(row, column, f"is not in {cell.path.name} ({', '.join(known) or 'none'})")
    approach = table.stack(APPROACH) if all(c in table.numbers for c in APPROACH) else np.zeros((n, 6))
    arm, T0 = make_arm(cell, draw_truth(cell, 0, mode="believed")), cell.tables.reference_temperature_C
    height = height_over_floor(cell, arm.links(arm_moments(np.radians(table.stack(AXES)), "", T0)))
    if (height < 0).any():
        row = int(np.argmin(height))
        raise table.refuse(row, "q2_deg", f"puts the arm {-1e3 * height[row]:.0f} mm into the floor of {cell.path.name}")
    time = BETWEEN * np.arange(1, n + 1)
    hung = tuple(table.words.get("payload", [payloads[0] if payloads else ""] * n))
    m = arm_moments(np.radians(table.stack(AXES)), hung, round(cell.tables.reference_temperature_C, 2), approach, time)
    return TrackerCampaign(m, tuple(table.words.get("target", [targets[0]] * n)))


def _targets(cell: Cell) -> list[str]:
    table = cell.tables.tracker
    known = list(table.targets) if table is not None else []
    if not known:
        raise BadInput(f"{cell.path}: the cell has no [tracker.targets]; name at least one reflector nest")
    return known


def _postures(cell: Cell, rng: np.random.Generator, n: int) -> Array:
    """Axes (n, 6) rad in front of the robot with the flange off the column and the floor, rounded as files hold them.

    Raises Infeasible: hardly any posture does.
    """
    robot = cell.robot
    box = np.radians([_FRONT, np.inf, np.inf, _WRIST, np.inf, _WRIST])
    low, high = np.maximum(robot.q_min + _MARGIN, -box), np.minimum(robot.q_max - _MARGIN, box)
    arm = make_arm(cell, draw_truth(cell, 0, mode="believed"))
    reach = float(np.abs(robot.mdh[:, 1:3]).sum())
    found, count = [np.empty((0, 6))], 0
    for _ in range(_TRIES):
        if count >= n:
            break
        q = rng.uniform(low, high, (n + 50, 6))
        links = arm.links(arm_moments(q, "", cell.tables.reference_temperature_C))
        x, y, z = np.moveaxis(links[:, 4:, :3, 3], 2, 0)
        free = (np.hypot(x, y) > _COLUMN * reach) & (z > _FLOOR * reach)
        kept = q[free.all(axis=1) & (height_over_floor(cell, links) > 0)]
        count += len(kept)
        found.append(kept)
    if count < n:
        raise Infeasible(
            f"{cell.path}: of {_TRIES * (n + 50)} postures drawn {count} keep off the column and the floor; correct floor.z_mm "
            "(height above the base's origin) or robot.gravity_direction, or give poses of your own"
        )
    return np.asarray(np.radians(np.degrees(np.concatenate(found)[:n]).round(6)))


CONDITIONS = ("time_s", "temperature_C", "payload", "target", *AXES, *APPROACH)
POINT = ("x_mm", "y_mm", "z_mm")
TURN = ("rx_deg", "ry_deg", "rz_deg", "sigma_rot_deg")
_NOISE, _POSTURES = 101, 103  # streams beside those of the truth


@dataclass(frozen=True)
class TrackerLog:
    """Readings to take, and those to predict (None: nothing is kept back)."""

    design: TrackerCampaign
    sealed: TrackerCampaign | None


def tracker_world(folder: Path, cell: Cell, truth: Truth, log: TrackerLog, arm: VirtualArm | None = None) -> None:
    """Write a campaign into `folder`: the cell as believed before any calibration, with the robot's file where it has one of its
    own, tracker.csv, and sealed_tracker.csv where something is kept back; arm: None: the cell's own."""
    folder.mkdir(parents=True, exist_ok=True)
    text = re.sub(r"(?m)^\s*calibration\s*=.*\n", "", cell.path.read_text(encoding="utf-8-sig"))
    (folder / "cell.toml").write_text(text, encoding="utf-8")
    model = cell.path.parent / cell.tables.robot.model
    if model.suffix == ".toml" and model.exists():
        shutil.copy(model, folder / model.name)
    write_tracker(folder, cell, truth, make_arm(cell, truth) if arm is None else arm, log)


def _write(path: Path, design: TrackerCampaign, points: Array | None = None, turns: Array | None = None) -> None:
    """One row a reading; columns of measurements where they are given."""
    m, q = design.moments, np.degrees(design.moments.q)
    rows = []
    for k, target in enumerate(design.targets):
        row = [f"{m.time_s[k]:.1f}", f"{m.temperature_C[k]:.2f}", m.payload[k], target]
        row += [f"{v:.6f}" for v in q[k]] + [f"{s:.0f}" for s in m.approach[k]]
        if points is not None:
            row += [f"{1e3 * v:.4f}" for v in points[k]]
        if turns is not None:
            blank = bool(np.isnan(turns[k]).any())
            row += [""] * 4 if blank else [*(f"{v:.5f}" for v in turns[k]), f"{np.degrees(TURN_SIGMA):.5f}"]
        rows.append(row)
    write_csv(path, (*CONDITIONS, *(POINT if points is not None else ()), *(TURN if turns is not None else ())), rows)


MOST = 2000  # postures
BLIND = 60  # readings kept back
READING = 15.0  # s from one nest to the next in a posture


def tracker_log(poses: str, cell: Cell, seed: int, sealed: bool) -> TrackerLog:
    """The campaign of `poses`: a number of random postures, each with all nests on the flange and links, or a poses.csv or its
    folder.

    Raises BadInput: neither a number in range nor a file, a cell without nests, as `design_from_poses`.
    """
    rng = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(_POSTURES,)))
    if re.fullmatch(r"-?\d{1,9}", poses, re.ASCII):
        n = int(poses)
        if not 4 <= n <= MOST:
            raise BadInput(f"--poses {n}: give 4 to {MOST} postures, 0 for no campaign, or the folder that ocp.poses wrote")
        design = every_nest(cell, random_design(cell, rng, n, repeats=min(6, n // 8)))
    else:
        path = Path(poses)
        file = path / "poses.csv" if path.is_dir() else path
        if not file.is_file():
            raise BadInput(f"--poses '{shown(poses)}': is neither a number nor a folder of ocp.poses; give one of them")
        design = design_from_poses(cell, file)
    return TrackerLog(design, sealed_design(cell, rng, BLIND) if sealed else None)


def every_nest(cell: Cell, design: TrackerCampaign) -> TrackerCampaign:
    """Each posture read once for every nest, one after the other."""
    table = cell.tables.tracker
    names = list(table.targets) if table is not None else []
    rows = np.repeat(np.arange(len(design)), len(names))
    m = design.moments
    payload = tuple(m.payload[k] for k in rows)
    time = np.maximum.accumulate(m.time_s[rows] + READING * np.tile(np.arange(len(names)), len(design)))
    repeated = arm_moments(m.q[rows], payload, m.temperature_C[rows], m.approach[rows], time, visit=rows)
    return TrackerCampaign(repeated, tuple(names) * len(design))


def write_tracker(folder: Path, cell: Cell, truth: Truth, arm: VirtualArm, log: TrackerLog) -> None:
    """Take the readings and write tracker.csv, orientations too where a nest is a 6D target; sealed_tracker.csv where something
    is kept back. The random numbers of the instrument and of repeatability are apart from those of the machine."""
    rng = np.random.default_rng(np.random.SeedSequence(truth.seed, spawn_key=(_NOISE,)))
    m, names = log.design.moments, log.design.targets
    points, turns = measure(truth, cell, arm, m, names, rng), None
    if any(name in truth.nest_turns for name in names):
        R, turned = measure_turns(truth, cell, arm, m, names, rng)
        turns = np.where(turned[:, None], Rotation.from_matrix(R).as_euler("xyz", degrees=True), np.nan)
    _write(folder / "tracker.csv", log.design, points, turns)
    if log.sealed is not None:
        _write(folder / "sealed_tracker.csv", log.sealed)


def write_tracker_truth(folder: Path, cell: Cell, truth: Truth, arm: VirtualArm, sealed: TrackerCampaign) -> None:
    """labels/sealed_tracker_truth.csv: what is kept back, free of noise with effects included."""
    (folder / "labels").mkdir(exist_ok=True)
    points = true_points(truth, cell, arm, sealed.moments, sealed.targets)
    _write(folder / "labels" / "sealed_tracker_truth.csv", sealed, points)
