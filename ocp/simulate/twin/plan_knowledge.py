"""What is known of a plan beside its program: which cell it belongs to, and which contact belongs to a posture.

A logger in the cell knows the contacts from plan.csv and plan.json. Joints never come from there: a sample of the driven program
is matched to the plan by where its joints are (and, where the program passes the same posture twice, by when); the contact
point, its normal and the feed direction are then the plan's there. Frames and hashes tell whether a program belongs to a cell.
"""

import hashlib
import json
import re
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from glob import escape
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline
from scipy.spatial import cKDTree
from scipy.spatial.transform import Rotation

from ocp.model.cell import Cell, named_files
from ocp.simulate.twin.controller import Index, Track
from ocp.simulate.twin.krl_text import DrivenMotion, KrlProgram
from robots.bounds import MEGABYTE, read_whole
from robots.csv_table import read_csv_table
from robots.errors import BadInput, shown
from robots.pose import Array, Stacked, abc_from_rotation, invert

AXES = tuple(f"q{i}_deg" for i in range(1, 7))
CONTACT = ("px_mm", "py_mm", "pz_mm", "nx", "ny", "nz", "tx", "ty", "tz", "s_mm", "feed_mm_s", "fn_N", "interference_mm")
MOST_SUMMARY = 20 * MEGABYTE
LONGEST_PLAN = 4 * 3600.0  # s; a blade takes some minutes, and the plan is laid out every FINE
FINE = 0.002  # s between the plan's points that are looked at
ORDER = 2e-3  # rad that the whole program's time counts for when postures repeat
FAR = np.radians(0.05)  # rad; a posture farther from the plan than this is not the plan's
END_DIGIT = 1e-5  # s, the last of a time block
IN_TIME = np.radians(0.01)  # rad; of a timed program at the plan's times: samples every 4 ms miss a bend by a tenth of that
PASS = "pass"  # of the column `phase`, where a plan has it: the line itself
AWAY, NEAR, GRINDING = 0, 1, 2  # travel between passes; approach and lift of a pass; planned contact, from touch to lift


@dataclass(frozen=True)
class PlanTable:
    """The rows of plan.csv in SI, m points: time s, q (m, 6) rad, line, phase (AWAY, NEAR, GRINDING); values (m, 13) of the
    columns CONTACT, nan off contact; `segment` (m,) number of the leg; `planned` (m,) rows of a pass itself, neither led in nor
    out; setpoint (m,) N that the program sets, nan where the plan does not tell."""

    path: Path
    time: Array
    q: Array
    line: Index
    phase: Index
    values: Array
    segment: Index
    planned: NDArray[np.bool_]
    setpoint: Array


@dataclass(frozen=True)
class Matched(Stacked):
    """The plan along a driven program, n samples: phase, line, number of the pass (-1 off contact); p, n, t (n, 3) in m and unit,
    s m, feed m/s, force N, interference m (nan off contact); whether it is the pass itself; setpoint N (nan: not told)."""

    phase: Index
    line: Index
    run: Index
    p: Array
    n: Array
    t: Array
    s: Array
    feed: Array
    force: Array
    interference: Array
    planned: NDArray[np.bool_]
    setpoint: Array


def read_plan_table(folder: Path) -> PlanTable:
    """plan.csv of a plan folder. Raises BadInput as `read_csv_table`, and where nothing is in contact."""
    needed, told = ("time_s", "line", "contact", *AXES, *CONTACT), ("setpoint_N", "phase")
    table = read_csv_table(folder / "plan.csv", needed, told, words=("phase",), gaps=(*CONTACT, "setpoint_N"))
    line, contact = table.numbers["line"].astype(int), table.numbers["contact"] > 0.5
    phase = np.where(contact, GRINDING, np.where(line > 0, NEAR, AWAY))
    values = table.stack(CONTACT) * ([1e-3] * 3 + [1.0] * 6 + [1e-3, 1e-3, 1.0, 1e-3])
    if not contact.any():
        raise BadInput(f"{table.path}: no row is in contact; give the plan of a grinding program")
    if np.isnan(values[contact]).any():
        raise BadInput(f"{table.path}: rows in contact lack their contact point; write the plan anew")
    time = table.numbers["time_s"]
    if not (late := np.ptp(time)) <= LONGEST_PLAN:
        raise BadInput(f"{table.path}: reaches over {late:g} s, the limit is {LONGEST_PLAN:g} s; write the plan anew")
    change = (np.diff(line) != 0) | (np.diff(phase) != 0)
    segment = np.concatenate([[0], np.cumsum(change)])
    words = np.array(table.words.get("phase", [PASS] * len(time)))
    setpoint = table.numbers.get("setpoint_N", np.full(len(time), np.nan))
    planned = contact & (words == PASS)
    if not planned.any():
        raise BadInput(f"{table.path}: no row in contact has the phase '{PASS}'; write the plan anew")
    return PlanTable(table.path, time, np.radians(table.stack(AXES)), line, phase, values, segment, planned, setpoint)


def read_summary(folder: Path) -> dict[str, Any]:
    """plan.json, empty where the folder has none. Raises BadInput: not JSON."""
    path = folder / "plan.json"
    if not path.exists():
        return {}
    try:
        found = json.loads(read_whole(path, MOST_SUMMARY, "a plan's summary"))
    except (ValueError, RecursionError) as error:
        raise BadInput(f"{path}: cannot be read as JSON ({shown(error, 80)}); write the plan anew") from None
    inputs = found.get("inputs", []) if isinstance(found, dict) else None
    if not isinstance(inputs, list) or not all(isinstance(item, dict) for item in inputs):
        raise BadInput(f"{path}: holds no summary of a plan; write the plan anew")
    for item in inputs:
        name, digest = item.get("name"), item.get("sha256")
        if not isinstance(name, str) or Path(name).name != name or not name.isprintable() or len(name.encode()) > 255:
            raise BadInput(f"{path}: inputs name = {shown(repr(name))} is no file's name; write the plan anew")
        if not isinstance(digest, str) or not re.fullmatch("[0-9a-f]{64}", digest):
            raise BadInput(f"{path}: inputs sha256 = {shown(repr(digest))} is no hash of a file; write the plan anew")
    return found


def refuse_other_times(track: Track, plan: PlanTable) -> None:
    """Refuse (BadInput) a program of timed blocks whose axes are elsewhere than the plan's at the plan's times.

    The end of every block is printed up to END_DIGIT late: what has added up by then, at the speed of the axes, is allowed.
    """
    driven = np.stack([np.interp(plan.time, track.time, column) for column in track.q.T], axis=1)
    speed = np.abs(np.gradient(driven, plan.time + 1e-9 * np.arange(len(plan.time)), axis=0))
    off = np.max(np.abs(driven - plan.q) - speed * END_DIGIT * (plan.segment[:, None] + 1), axis=1)
    k = int(np.argmax(off))
    if off[k] > IN_TIME:
        raise BadInput(
            f"{plan.path}: at {plan.time[k]:.2f} s the axes of the program beside it are {np.degrees(off[k]):.2f} deg from where "
            "the plan has them; plan anew"
        )


def match(track: Track, plan: PlanTable) -> Matched:
    """Which contact of the plan belongs to each sample. Raises BadInput: the program drives nowhere near the plan."""
    fine = _dense(plan)
    weight = ORDER / max(plan.time[-1], 1e-9)
    share = track.time * (plan.time[-1] / max(track.duration, 1e-9))
    tree = cKDTree(np.column_stack([fine.q, weight * fine.time]))
    _, index = tree.query(np.column_stack([track.q, weight * share]))
    index = np.asarray(index)
    off = np.abs(track.q - fine.q[index]).max(axis=1)
    moves = np.abs(np.diff(fine.q, axis=0)).max() if len(fine.q) > 1 else 0.0
    if np.mean(off[fine.phase[index] == GRINDING] > FAR + moves) > 0.1 or not (fine.phase[index] == GRINDING).any():
        raise BadInput(f"{plan.path}: does not belong to the program beside it, whose axes go elsewhere; plan anew")
    for at, word in ((0, "begins"), (-1, "ends")):
        away = np.degrees(np.abs(track.q[at] - plan.q[at]).max())
        if away > np.degrees(FAR):
            raise BadInput(f"{plan.path}: the program beside it {word} {away:.2f} deg from where the plan {word}; plan anew")
    phase = np.where(off > FAR + moves, AWAY, fine.phase[index])
    grinding = phase == GRINDING
    values = np.full((len(index), len(CONTACT)), np.nan)
    run = np.full(len(index), -1)
    for k, segment in enumerate(np.unique(plan.segment[plan.phase == GRINDING])):
        rows = grinding & (fine.segment[index] == segment)
        if rows.any():
            values[rows] = _at(plan, segment, _refined(fine, segment, index[rows], track.q[rows]))
            run[rows] = k
        _refuse_order(plan, segment, run, k)
    p, n, t, (s, feed, force, interference) = values[:, :3], values[:, 3:6], values[:, 6:9], values[:, 9:].T
    line = np.where(phase == AWAY, 0, fine.line[index])
    planned, setpoint = fine.planned[index] & (run >= 0), fine.setpoint[index]
    return Matched(phase, line, run, p, n, t, s, feed, force, interference, planned, setpoint)


def _refuse_order(plan: PlanTable, segment: int, run: Index, k: int) -> None:
    """Refuse a pass that the program does not drive whole, once, and after those before it."""
    rows = np.flatnonzero(run == k)
    name = f"the pass of line {plan.line[_leg(plan, segment)[0]]} that begins at {plan.time[_leg(plan, segment)[0]]:.2f} s"
    if len(rows) == 0:
        raise BadInput(f"{plan.path}: the program beside it leaves out {name}; plan anew")
    if (run[rows[0] :] < k).any() and (run[rows[0] :][run[rows[0] :] >= 0] < k).any():
        raise BadInput(f"{plan.path}: the program beside it drives {name} out of turn; plan anew")
    stretches = np.split(rows, np.flatnonzero(np.diff(rows) > 1) + 1)
    if len([s for s in stretches if len(s) > 0.2 * max(map(len, stretches))]) > 1:
        raise BadInput(f"{plan.path}: the program beside it drives {name} more than once; plan anew")


def _dense(plan: PlanTable) -> PlanTable:
    """The plan's legs at FINE steps, joints by cubic splines, without gaps: what lies between the last row of a leg and the first
    of the next is of the one that does not grind, or the first. Contact columns are left to `_at`."""
    parts = []
    for segment in np.unique(plan.segment):
        rows = _between(plan, _leg(plan, segment))
        t = plan.time[rows]
        fine = np.append(np.arange(t[0], t[-1], FINE), t[-1])
        q = CubicSpline(t, plan.q[rows])(fine) if len(t) > 3 else np.stack([np.interp(fine, t, c) for c in plan.q[rows].T], 1)
        own = int(np.argmax(plan.segment == segment))
        same = (np.full(len(fine), value) for value in (plan.line[own], plan.phase[own], segment))
        nearest = rows[np.argmin(np.abs(np.subtract.outer(fine, t)), axis=1)]
        parts.append((fine, q, *same, plan.planned[nearest], np.interp(fine, t, plan.setpoint[rows])))
    time, q, line, phase, segments, planned, setpoint = (np.concatenate(columns) for columns in zip(*parts, strict=True))
    return PlanTable(plan.path, time, q, line, phase, np.empty((len(time), 0)), segments, planned, setpoint)


def _between(plan: PlanTable, rows: Index) -> Index:
    """The rows of a leg with those of its neighbours between which and itself the time is its own."""
    first, last, grinds = rows[0], rows[-1], plan.phase == GRINDING
    if grinds[first]:
        return rows
    before = [first - 1] if first > 0 and grinds[first - 1] and plan.time[first] > plan.time[first - 1] + 1e-9 else []
    after = [last + 1] if last + 1 < len(plan.time) and plan.time[last + 1] > plan.time[last] + 1e-9 else []
    return np.concatenate([before, rows, after]).astype(np.int64)


def _leg(plan: PlanTable, segment: int) -> Index:
    """Rows of a leg with rising times."""
    rows = np.flatnonzero(plan.segment == segment)
    return np.asarray(rows[np.concatenate([[True], np.diff(plan.time[rows]) > 1e-9])])


def _refined(fine: PlanTable, segment: int, index: Index, q: Array) -> Array:
    """Times on the plan (n,) s between the dense points: where the joints' difference stands square to the motion."""
    inside = np.flatnonzero(fine.segment == segment)
    index = np.clip(index, inside[0] + 1, inside[-1] - 1)
    way = fine.q[index + 1] - fine.q[index - 1]
    share = np.einsum("ij,ij->i", q - fine.q[index], way) / np.maximum(np.einsum("ij,ij->i", way, way), 1e-30)
    step = fine.time[index + 1] - fine.time[index - 1]
    time = fine.time[index] + np.clip(share, -1.0, 1.0) * step
    return np.asarray(np.clip(time, fine.time[inside[0]], fine.time[inside[-1]]))


def _at(plan: PlanTable, segment: int, time: Array) -> Array:
    """The contact columns of a pass at plan times, vectors of unit length."""
    rows = _leg(plan, segment)
    values = CubicSpline(plan.time[rows], plan.values[rows])(time)
    for k in (3, 6):
        values[:, k : k + 3] /= np.linalg.norm(values[:, k : k + 3], axis=1, keepdims=True)
    return np.asarray(values)


LOAD_PRINTED = np.array([1e-3, *[1e-6] * 3, *[1e-4] * 3])  # kg, m, kg m^2: what printing $LOAD may round
PRINTED = (2e-5, np.radians(2e-3))  # m, rad: what printing a frame may round
REGISTERED = (5e-4, np.radians(0.2))  # m, rad, on top of 5 sd: what a calibration may have moved a frame by
SDS = 5.0


def file_hash(path: Path) -> str:
    """Hash of a file's bytes."""
    return hashlib.sha256(path.read_bytes()).hexdigest()


def with_hash(files: Iterable[Path], digest: str) -> Path | None:
    """The first of the files whose bytes have this hash."""
    return next((file for file in files if file.is_file() and file_hash(file) == digest), None)


def recorded_input(summary: dict[str, Any], role: str) -> tuple[str, str] | None:
    """Name and hash of an input of the plan, None where plan.json does not tell it."""
    for item in summary.get("inputs", []):
        if item.get("role") == role:
            return item["name"], item["sha256"]
    return None


def cell_of_plan(summary: dict[str, Any], folder: Path, places: Sequence[Path], bundled: Path) -> Path:
    """The cell file that a plan was made with, by its hash: in `places`, the bundled one, or one folder below `places`.

    Raises BadInput: plan.json names a cell that is nowhere; another one is never taken in its place.
    """
    known = recorded_input(summary, "cell")
    if known is None:
        raise BadInput(f"{folder}: plan.json does not tell which cell the plan was made with; give it with --cell")
    name, digest = known
    below = (file for place in places for file in sorted(place.glob(f"*/{escape(name)}")))
    looked = [*(place / name for place in places), bundled, *below]
    if found := with_hash(looked, digest):
        return found
    raise BadInput(f"{folder}: was made with a cell '{name}' that is not found near it; give that file with --cell")


def refuse_stranger(program: KrlProgram, cell: Cell, summary: dict[str, Any], folder: Path) -> tuple[str, ...]:
    """Notices about a program that belongs to the cell.

    Raises BadInput: tool or base frame differ from the cell's by more than printing, or where a calibration moved them by more
    than that can; another blade; a robot file that is not as it was.
    """
    blade, stl = recorded_input(summary, "blade"), cell.workpiece.stl
    if stl is not None and not stl.is_file():
        raise BadInput(f"{cell.path}: its blade {stl} cannot be read; put the file there or give another with --blade")
    if blade is not None and stl is not None and file_hash(stl) != blade[1]:
        raise BadInput(f"{folder}: was planned for another blade '{blade[0]}' than {stl}; give that with --blade, or plan anew")
    arm, file = recorded_input(summary, "robot"), named_files(cell.path, cell.tables).get("robot")
    if arm is not None and (file is None or file_hash(file) != arm[1]):
        raise BadInput(
            f"{folder}: was planned with another version of the robot file '{arm[0]}' than {cell.path} names, whose arm need not "
            "stand, reach and bend as planned; plan anew"
        )
    moved = cell.calibration is not None or recorded_input(summary, "calibration") is not None
    piece, wheel = cell.workpiece, cell.wheel
    for motion in program.motions:
        if program.planned:
            _compare_load(motion, cell)
        if motion.kind == "PTP" and not motion.frames.held:
            continue
        tool_sd, base_sd = ((piece.xyz_sd, piece.abc_sd), (wheel.centre_sd, wheel.axis_sd)) if moved else (None, None)
        _compare(motion, "$TOOL", motion.frames.tool, piece.T_flange_blade, tool_sd, cell)
        _compare(motion, "$BASE", motion.frames.base, wheel_place(cell), base_sd, cell)
        if not motion.frames.held:
            raise BadInput(f"{motion.file}, line {motion.line}: $IPO_MODE is #BASE, but in {cell.path} the robot holds the blade")
    known = recorded_input(summary, "cell")
    if known is not None and file_hash(cell.path) != known[1]:
        alike = "frames, load and blade agree, what is cut, pressed and limited need not"
        return (f"the plan was made with another version of {known[0]} than {cell.path}: {alike}",)
    return ()


def wheel_place(cell: Cell) -> Array:
    """T_base_wheel (4, 4): where the wheel touches at arc zero, x along the belt, y along the axis (docs/krl.md)."""
    w = cell.wheel
    T = np.eye(4)
    T[:3, :3] = np.stack([np.cross(w.axis, w.contact_direction), w.axis, w.contact_direction], axis=1)
    T[:3, 3] = w.centre + w.radius * w.contact_direction
    return T


def _compare_load(motion: DrivenMotion, cell: Cell) -> None:
    load = cell.workpiece.payload
    believed = np.concatenate([[load.mass], load.com, load.inertia])
    assert motion.frames.load is not None
    off = np.abs(motion.frames.load - believed)
    if (off > LOAD_PRINTED).any():
        raise BadInput(
            f"{motion.file}, line {motion.line}: $LOAD has {motion.frames.load[0]:.3f} kg at "
            f"{np.array2string(1e3 * motion.frames.load[1:4], precision=1)} mm and that of {cell.path} is {load.mass:.3f} kg at "
            f"{np.array2string(1e3 * np.asarray(load.com), precision=1)} mm; the program was changed or belongs to another cell"
        )


def _compare(motion: DrivenMotion, name: str, found: Array, expected: Array, sd: tuple[float, float] | None, cell: Cell) -> None:
    off = invert(expected) @ found
    way, turn = float(np.linalg.norm(off[:3, 3])), float(np.linalg.norm(Rotation.from_matrix(off[:3, :3]).as_rotvec()))
    most = PRINTED if sd is None else (REGISTERED[0] + SDS * sd[0] * 3**0.5, REGISTERED[1] + SDS * sd[1] * 3**0.5)
    if way > most[0] or turn > most[1]:
        x, y, z = 1e3 * expected[:3, 3]
        a, b, c = np.degrees(abc_from_rotation(expected[:3, :3]))
        raise BadInput(
            f"{motion.file}, line {motion.line}: {name} lies {1e3 * way:.3f} mm and {np.degrees(turn):.4f} deg from that of "
            f"{cell.path} (X {x:.2f}, Y {y:.2f}, Z {z:.2f}, A {a:.3f}, B {b:.3f}, C {c:.3f}); the program belongs to another cell"
        )
