"""What a logger in the cell knows of the plan: which contact belongs to a posture, from plan.csv and plan.json.

Joints never come from here. A sample of the driven program is matched to the plan by where its joints are (and, where the
program passes the same posture twice, by when); the contact point, its normal and the feed direction are then the plan's there.
"""

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from scipy.interpolate import CubicSpline
from scipy.spatial import cKDTree

from ocp.simulate.twin.controller.controller import Index, Track
from robots.csv_table import read_csv_table
from robots.errors import BadInput
from robots.pose import Array

AXES = tuple(f"q{i}_deg" for i in range(1, 7))
CONTACT = ("px_mm", "py_mm", "pz_mm", "nx", "ny", "nz", "tx", "ty", "tz", "s_mm", "feed_mm_s", "fn_N", "interference_mm")
FINE = 0.002  # s between the plan's points that are looked at
ORDER = 2e-3  # rad that the whole program's time counts for when postures repeat
FAR = np.radians(0.05)  # rad; a posture farther from the plan than this is not the plan's
AWAY, NEAR, GRINDING = 0, 1, 2  # travel; engage and retreat; the planned contact


@dataclass(frozen=True)
class PlanTable:
    """The rows of plan.csv in SI, m points: time s, q (m, 6) rad, line, phase (AWAY, NEAR, GRINDING); values (m, 13) of the
    columns CONTACT, nan off contact; `segment` (m,) number of the leg."""

    path: Path
    time: Array
    q: Array
    line: Index
    phase: Index
    values: Array
    segment: Index


@dataclass(frozen=True)
class Matched:
    """The plan along a driven program, n samples: phase, line, number of the pass (-1 off contact); p, n, t (n, 3) in m and unit,
    s m, feed m/s, force N, interference m (nan off contact); `off` (n,) rad from the plan's joints."""

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
    off: Array


def read_plan_table(folder: Path) -> PlanTable:
    """plan.csv of a plan folder. Raises BadInput as `read_csv_table`, and where nothing is in contact."""
    table = read_csv_table(folder / "plan.csv", ("time_s", "line", "contact", *AXES, *CONTACT), gaps=CONTACT)
    line, contact = table.numbers["line"].astype(int), table.numbers["contact"] > 0.5
    phase = np.where(contact, GRINDING, np.where(line > 0, NEAR, AWAY))
    values = table.stack(CONTACT) * ([1e-3] * 3 + [1.0] * 6 + [1e-3, 1e-3, 1.0, 1e-3])
    if not contact.any():
        raise BadInput(f"{table.path}: no row is in contact; give the plan of a grinding program")
    if np.isnan(values[contact]).any():
        raise BadInput(f"{table.path}: rows in contact lack their contact point; write the plan anew")
    change = (np.diff(line) != 0) | (np.diff(phase) != 0)
    segment = np.concatenate([[0], np.cumsum(change)])
    return PlanTable(table.path, table.numbers["time_s"], np.radians(table.stack(AXES)), line, phase, values, segment)


def read_summary(folder: Path) -> dict[str, Any]:
    """plan.json, empty where the folder has none. Raises BadInput: not JSON."""
    path = folder / "plan.json"
    if not path.exists():
        return {}
    try:
        found = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError) as error:
        raise BadInput(f"{path}: cannot be read as JSON ({str(error)[:80]}); write the plan anew") from None
    if not isinstance(found, dict):
        raise BadInput(f"{path}: holds no summary of a plan; write the plan anew")
    return found


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
    phase = np.where(off > FAR + moves, AWAY, fine.phase[index])
    grinding = phase == GRINDING
    values = np.full((len(index), len(CONTACT)), np.nan)
    run = np.full(len(index), -1)
    for k, segment in enumerate(np.unique(plan.segment[plan.phase == GRINDING])):
        rows = grinding & (fine.segment[index] == segment)
        if rows.any():
            values[rows] = _at(plan, segment, _refined(fine, segment, index[rows], track.q[rows]))
            run[rows] = k
    return Matched(phase, np.where(phase == AWAY, 0, fine.line[index]), run, values[:, :3], values[:, 3:6], values[:, 6:9],
                   values[:, 9], values[:, 10], values[:, 11], values[:, 12], off)  # fmt: skip


def _dense(plan: PlanTable) -> PlanTable:
    """The plan's legs at FINE steps, joints by cubic splines; contact columns are left to `_at`."""
    parts = []
    for segment in np.unique(plan.segment):
        rows = _leg(plan, segment)
        t = plan.time[rows]
        fine = np.append(np.arange(t[0], t[-1], FINE), t[-1])
        q = CubicSpline(t, plan.q[rows])(fine) if len(t) > 3 else np.stack([np.interp(fine, t, c) for c in plan.q[rows].T], 1)
        parts.append(
            (
                fine,
                q,
                np.full(len(fine), plan.line[rows[0]]),
                np.full(len(fine), plan.phase[rows[0]]),
                np.full(len(fine), segment),
            )
        )
    time, q, line, phase, segments = (np.concatenate(columns) for columns in zip(*parts, strict=True))
    return PlanTable(plan.path, time, q, line, phase, np.empty((len(time), 0)), segments)


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
