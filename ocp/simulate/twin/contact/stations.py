"""Stations along the lines of a log: where contacts are solved, and the depth curves of every instant between two of them."""

from dataclasses import dataclass

import numpy as np
from scipy.interpolate import CubicSpline

from ocp.simulate.twin.contact.contact_instants import ContactMoments, Index
from ocp.simulate.twin.contact.table import LATTICE, Tables
from robots.pose import Array

SPACING, END_SPACING, END_ZONE = 2.5e-3, 1.25e-3, 6e-3  # m; the blade's edges come under the wheel at the ends of a line
SPARSE = 1.5e-3  # m between rows of a line above which the rows themselves are the stations
SAME = 1e-6  # m: rows this close in s are the same place
DIFFERENT = 5e-5  # m: points this far apart are not


@dataclass(frozen=True)
class SolvedStations:
    """Places p, n, t (k, 3) where contacts are solved, with their s (k,) m and line (k,); for each of n instants the stations on
    both sides with the share of the second."""

    p: Array
    n: Array
    t: Array
    s: Array
    line: Index
    left: Index
    right: Index
    share: Array


def place_stations(planned: ContactMoments, rows: Index, now: Array) -> SolvedStations:
    """Stations on the lines of the planned instants `rows`, seen from arc lengths `now` (rows,) m.

    Where rows are dense the places do not depend on how they are spaced. Raises ValueError: a line has two places at one s.
    """
    left, right = np.zeros(len(rows), np.int64), np.zeros(len(rows), np.int64)
    share = np.zeros(len(rows))
    parts: list[tuple[Array, Array]] = []
    line: list[Index] = []
    start = 0
    for number in np.unique(planned.line[rows]):
        own = np.flatnonzero(planned.line[rows] == number)
        at = rows[own]
        s, frames = _line(planned.s[at], np.hstack([planned.p[at], planned.n[at], planned.t[at]]))
        i = np.clip(np.searchsorted(s, now[own]) - 1, 0, max(len(s) - 2, 0))
        j = np.minimum(i + 1, len(s) - 1)
        gap = s[j] - s[i]
        share[own] = np.clip(np.divide(now[own] - s[i], gap, out=np.zeros(len(at)), where=gap > 0), 0.0, 1.0)
        left[own], right[own] = start + i, start + j
        parts.append((s, frames))
        line.append(np.full(len(s), number, np.int64))
        start += len(s)
    frames = np.vstack([f for _, f in parts])
    n = frames[:, 3:6] / np.linalg.norm(frames[:, 3:6], axis=1, keepdims=True)
    t = frames[:, 6:] - n * np.sum(frames[:, 6:] * n, axis=1, keepdims=True)
    t /= np.linalg.norm(t, axis=1, keepdims=True)
    return SolvedStations(frames[:, :3], n, t, np.concatenate([s for s, _ in parts]), np.concatenate(line), left, right, share)


def _line(s: Array, frames: Array) -> tuple[Array, Array]:
    """Stations s (k,) of one line with p, n, t (k, 9), from rows in any order."""
    order = np.argsort(s, kind="stable")
    kept = order[np.concatenate([[True], np.diff(s[order]) > SAME])]
    group = np.searchsorted(s[kept], s, side="right") - 1
    if np.abs(frames[kept][np.maximum(group, 0), :3] - frames[:, :3]).max() > DIFFERENT:
        raise ValueError(
            "a line of the log has different contact points at the same arc length s; give every line a number of its own"
        )
    known, frames = s[kept], frames[kept]
    if len(known) < 4 or np.median(np.diff(known)) > SPARSE:
        return known, frames
    # Every 0.3 mm is enough for the path and keeps the text's rounding out of the spline's curvature.
    thin = np.concatenate([[0], 1 + np.flatnonzero(np.diff(np.floor((known[1:-1] - known[0]) / 3e-4)) > 0), [len(known) - 1]])
    thin = np.unique(thin)
    first, last = known[0], known[-1]
    inner = SPACING * np.arange(np.ceil((first + END_ZONE) / SPACING), np.floor((last - END_ZONE) / SPACING) + 1)
    ends = END_SPACING * np.arange(np.ceil(first / END_SPACING), np.floor(last / END_SPACING) + 1)
    ends = ends[(ends < first + END_ZONE) | (ends > last - END_ZONE)]
    wanted = np.concatenate([[first, last], ends, inner])
    wanted = np.unique(np.round(wanted[(wanted >= first) & (wanted <= last)], 7))
    wanted = np.clip(wanted, first, last)
    path = CubicSpline(known[thin], frames[thin]) if len(thin) > 3 else CubicSpline(known, frames)
    return wanted, path(wanted)


def depth_curves(tables: Tables, stations: SolvedStations, shape: Array) -> tuple[Array, Array]:
    """Depth (n, levels) m at the tables' loads and crowding (n,) for postures `shape` (n, 4) at the instants of `stations`."""
    lattice = np.rint(shape / LATTICE).astype(np.int64)
    off = shape - lattice * LATTICE
    sides = np.concatenate([stations.left, stations.right])
    wanted = np.concatenate([sides[:, None], np.vstack([lattice, lattice])], axis=1)
    nodes, index = np.unique(wanted, axis=0, return_inverse=True)
    index = np.asarray(index).ravel()
    at = nodes[:, 0]
    curves = tables.curves(stations.p[at], stations.n[at], stations.t[at], nodes[:, 1:])
    count = len(shape)
    depth = (1 - stations.share)[:, None] * curves.at(index[:count], off)
    depth += stations.share[:, None] * curves.at(index[count:], off)
    crowding = (1 - stations.share) * curves.crowding[index[:count]] + stations.share * curves.crowding[index[count:]]
    return depth, crowding
