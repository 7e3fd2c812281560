"""Depth against force at stations of the blade, solved once for every posture on a lattice and kept for all virtual cells; and
the depth curves of every instant of a log between two of its stations.

A node is a planned contact (p, n, t) with a posture rounded to a lattice; its curve depth(force) holds for modulus 1 (force over
modulus), so that stiffness, temperature and law act on the force scale alone. Between lattice points the curve is moved by its
derivatives: tilt, turn and shift along the belt follow from the moments of the pressure (docs/virtual_grinding.md, eq. 6), the
shift across the wheel and the second order along the belt from solutions beside. A node depends on nothing but its key, so a
store may be shared, pickled and filled in any order without a reading changing.
"""

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline, PchipInterpolator

from ocp.model.cell import Cell
from ocp.simulate.twin.contact import ContactMoments, Index
from ocp.simulate.twin.contact.rubber import CELLS_PER_PATCH, Rubber, cell_size, make_rubber, press
from ocp.simulate.twin.contact.surface import Facets, facets, gap, near, wheel_on_blade
from robots.pose import Array
from trajectories.blade import Blade

LEVELS = np.array([0.0, 0.08, 0.3, 0.65, 1.05, 1.7, 3.0, 6.0])  # loads solved, in process forces
BESIDE = np.array([2, 3, 4, 5, 7])  # levels at which the wheel is moved across
LATTICE = np.array([2e-3, 1e-3, 1e-2, 2e-2])  # m along, m across, rad tilt, rad turn
PROCESS = 4  # level nearest to the process force
ALONG_STEP = 1e-3  # m for the second derivative along the belt, at PROCESS
REACH = 1.5  # half-lengths of the largest patch that the window shows
BATCH, TOGETHER = 6, 80  # nodes, and single contacts, solved side by side
PATCH = (1.05, 1.3)  # semi-axes of the patch on the blade's solid, along the feed and across, in those of a Hertz patch
EDGE_ZONE = 6e-3  # m from the blade's edge inside which it crowds the contact
SHARP = 50.0  # 1/m: curvature, a radius of 20 mm, at which the blade crowds the contact by half
ABSENT = 1.0  # m of depth to touch where there is no blade: never reached


OTHERS = [0, 2, 3]  # of the lattice's coordinates, those along which the pressure's moments are derivatives
Node = tuple[Array, Array, Array, Array, float]  # one row of `Curves`


@dataclass(frozen=True)
class Curves:
    """Depth m of k nodes at the loads, and how it changes off the lattice point.

    value (k, levels); slope (k, levels, 4) in the lattice's coordinates; bend (k, levels, 2): second derivatives along and
    across, 1/m; mixed (k, levels, 3): of across with OTHERS; crowding (k,): 0 on a flat, 1 at an edge (belt_tension).
    """

    value: Array
    slope: Array
    bend: Array
    mixed: Array
    crowding: Array

    def at(self, index: NDArray[np.int64], off: Array) -> Array:
        """Depth (n, levels) of nodes (n,) at postures `off` (n, 4) from their lattice point."""
        depth = self.value[index] + np.einsum("klj,kj->kl", self.slope[index], off)
        depth += np.einsum("klj,kj->kl", self.mixed[index], off[:, OTHERS] * off[:, 1:2])
        return np.asarray(depth + 0.5 * np.einsum("klj,kj->kl", self.bend[index], off[:, :2] ** 2))


@dataclass
class Tables:
    """Solved nodes by content; shared by every virtual cell of one blade and one wheel. Pickles with what it has."""

    rubber: Rubber
    surface: Facets
    load: float
    patch: tuple[float, float]
    nodes: dict[bytes, Node] = field(default_factory=dict)
    solid: dict[bytes, Array] = field(default_factory=dict)

    def compliance(self, at: "SolvedStations", solve: Callable[[tuple[float, float]], Array]) -> Array:
        """Of the blade's solid at stations m/N, (k, 3); `solve`, for a patch, is asked for all where one is not known."""
        keys = [row.tobytes() for row in _exact(at.p, at.n, at.t)]
        if not all(key in self.solid for key in keys):
            self.solid.update(zip(keys, solve(self.patch), strict=True))
        return np.array([self.solid[key] for key in keys])

    def curves(self, p: Array, n: Array, t: Array, lattice: NDArray[np.int64]) -> Curves:
        """Curves of k nodes: contacts (k, 3) and lattice points (k, 4); solves those that are not known."""
        keys = [row.tobytes() for row in np.concatenate([_exact(p, n, t), lattice], axis=1)]
        missing = {key: k for k, key in enumerate(keys) if key not in self.nodes}
        order = list(missing.values())
        for start in range(0, len(order), BATCH):
            part = np.array(order[start : start + BATCH])
            for k, node in zip(part, self._solve(p[part], n[part], t[part], lattice[part] * LATTICE), strict=True):
                self.nodes[keys[k]] = node
        return Curves(*(np.array(part) for part in zip(*(self.nodes[key] for key in keys), strict=True)))

    def shares(self, p: Array, n: Array, t: Array, shape: Array) -> NDArray[np.float32]:
        """Share of the force on the cells of the rubber's grid near the process force (k, nx, ny), at contacts (k, 3) in postures
        (k, 4) as they are, not on the lattice: on a flat blade a few milliradians move the pressure by millimetres. Zero where
        there is no blade."""
        grid, parts = self.rubber.grid, []
        reach = np.hypot(grid.x[-1], 0.5 * self.rubber.width) + grid.dy
        for some in np.array_split(np.arange(len(p)), len(p) // TOGETHER + 1):
            gaps = []
            for k in some:
                around = near(self.surface, p[k], reach + np.abs(shape[k, :2]).sum())
                gaps.append((self._gap(around, p[k], n[k], t[k], shape[k], grid.y), LEVELS[PROCESS]))
            if gaps:
                forces = self._press(gaps)[1]
                parts.append((forces / np.maximum(forces.sum(axis=(0, 1)), 1e-30)).astype(np.float32))
        empty = np.zeros((len(grid.x), len(grid.y), 0), np.float32)
        return np.ascontiguousarray(np.concatenate([empty, *parts], axis=2).transpose(2, 0, 1))

    def _solve(self, p: Array, n: Array, t: Array, shape: Array) -> list[Node]:
        """Value, slope, bend and crowding of nodes (k, 3), (k, 4)."""
        grid = self.rubber.grid
        rows = len(grid.y)
        reach = np.hypot(grid.x[-1] + ALONG_STEP, 0.5 * self.rubber.width) + grid.dy
        wide = np.concatenate([[grid.y[0] - grid.dy], grid.y, [grid.y[-1] + grid.dy]])
        step = np.array([ALONG_STEP, 0.0, 0.0, 0.0])
        gaps, moved, crowding = [], [], []
        for one in zip(p, n, t, shape, strict=True):
            around = near(self.surface, one[0], reach + np.abs(one[3][:2]).sum())
            gaps.append(self._gap(around, *one, wide))
            moved.append(self._gap(around, one[0], one[1], one[2], one[3] + step, grid.y))
            crowding.append(_crowding(gaps[-1][:, 1:-1], grid.x, grid.y - one[3][1], self.rubber.radius))
        base, forces = self._press([(whole[:, 1:-1], k) for whole in gaps for k in LEVELS[1:]])
        # Beside: one row of cells to each side at some levels, a step along the belt at process force.
        beside: list[tuple[Array, float]] = []
        for whole, ahead in zip(gaps, moved, strict=True):
            beside += [(g, k) for g in (whole[:, :rows], whole[:, 2:]) for k in LEVELS[BESIDE]] + [(ahead, LEVELS[PROCESS])]
        like = np.concatenate([BESIDE, BESIDE, [PROCESS]]) - 1
        count = len(LEVELS) - 1
        start = np.concatenate([forces[:, :, k * count + like] for k in range(len(gaps))], axis=2)
        around_it, pressing = self._press(beside, start)
        there = zip(base.reshape(-1, count), np.split(forces, len(gaps), axis=2), strict=True)
        about = zip(around_it.reshape(-1, len(like)), np.split(pressing, len(gaps), axis=2), strict=True)
        parts = zip(gaps, shape, there, about, crowding, strict=True)
        return [self._node(here, at, *own, *other, crowded) for here, at, own, other, crowded in parts]

    def _press(self, tasks: list[tuple[Array, float]], start: Array | None = None) -> tuple[Array, Array]:
        """Depth (k,) m and cell forces (nx, ny, k) of gaps under loads in process forces; ABSENT where there is no blade."""
        there = np.flatnonzero([np.isfinite(g).any() for g, _ in tasks])
        depth = np.full(len(tasks), ABSENT)
        forces = np.zeros((*tasks[0][0].shape, len(tasks)))
        if len(there):
            gaps = np.stack([tasks[k][0] for k in there], axis=2)
            loads = np.array([tasks[k][1] for k in there]) * self.load
            solved = press(self.rubber, gaps, loads, None if start is None else start[:, :, there])
            depth[there], forces[:, :, there] = solved.approach, solved.forces
        return depth, forces

    def _gap(self, around: Facets, p: Array, n: Array, t: Array, shape: Array, y: Array) -> Array:
        frame, middle = wheel_on_blade(p, n, t, shape, self.rubber.radius)
        grid = self.rubber.grid
        return gap(around, frame, middle, self.rubber.radius, grid.x, y, grid.dx, grid.dy)

    def _node(
        self, here: Array, shape: Array, base: Array, forces: Array, beside: Array, pressing: Array, crowding: float
    ) -> Node:
        """One node from its gap with a row more on both sides, the depths at the levels with their cell forces, and the depths
        and cell forces beside in the order of `_solve`."""
        value = np.concatenate([[_first(self.rubber, here[:, 1:-1])], base])
        sideways = len(BESIDE)
        # The wheel's rows one cell up: it stands one cell farther along its axis, so the contact lies one cell lower on it.
        down = np.concatenate([[_first(self.rubber, here[:, :-2])], beside[:sideways]])
        up = np.concatenate([[_first(self.rubber, here[:, 2:])], beside[sideways : 2 * sideways]])
        cell, known = self.rubber.grid.dy, np.concatenate([[0], BESIDE])
        across = np.stack([(down - up) / (2 * cell), (down + up - 2 * value[known]) / cell**2], axis=1)
        level = LEVELS ** (2 / 3)
        across = PchipInterpolator(level[known], across)(level)
        slope, bend = np.zeros((len(LEVELS), 4)), np.zeros((len(LEVELS), 2))
        slope[:, OTHERS] = self._moments(forces, shape[1], LEVELS)
        mixed = self._moments(pressing[:, :, :sideways], shape[1] + cell, LEVELS[known])
        mixed = (mixed - self._moments(pressing[:, :, sideways : 2 * sideways], shape[1] - cell, LEVELS[known])) / (2 * cell)
        slope[:, 1], bend[:, 1] = across.T
        bend[:, 0] = 2 * (beside[-1] - value[PROCESS] - slope[PROCESS, 0] * ALONG_STEP) / ALONG_STEP**2
        if not (np.concatenate([value, beside, down, up]) < 0.5 * ABSENT).all():
            slope[:], bend[:], mixed[:] = 0.0, 0.0, 0.0
        return value, slope, bend, mixed, crowding

    def _moments(self, forces: Array, across: float, levels: Array) -> Array:
        """Derivatives (LEVELS, 3) of the depth in along, tilt, turn: how the moments of the pressure grow with the load. `forces`
        are those at `levels` but the first, where there are none."""
        grid = self.rubber.grid
        tangent = np.tan(grid.x / self.rubber.radius)[:, None]
        lever = (grid.y - across)[None, :]
        arms = np.stack([-tangent + 0 * lever, lever + 0 * tangent, -tangent * lever])
        moments = np.einsum("axy,xyl->la", arms, forces) / self.load
        return np.asarray(PchipInterpolator(levels, np.vstack([np.zeros(3), moments])).derivative()(LEVELS))


_KEPT: dict[tuple[object, ...], Tables] = {}
KEPT = 4  # stores kept in a process


def make_tables(cell: Cell, blade: Blade) -> Tables:
    """The store of the cell's wheel and blade: the one this process has, or an empty one.

    It knows the design wheel and the design blade: what a truth changes are scales and shifts.
    """
    wheel, piece, force = cell.wheel, cell.workpiece, cell.process.force
    size = cell_size(wheel.radius, wheel.width, wheel.cover_modulus, wheel.cover_poisson, force)
    patch = CELLS_PER_PATCH * size
    reach = min(REACH * patch * LEVELS[-1] ** (1 / 3), 0.8 * wheel.radius)
    of_wheel = (wheel.radius, wheel.width, wheel.cover_thickness, wheel.cover_poisson, wheel.cover_modulus, force)
    of_piece = (*piece.clamp_normal, piece.clamp_offset, piece.youngs_modulus, piece.poisson)
    key = (blade.sha256, *map(float, (np.ptp(blade.vertices), *of_wheel, *of_piece)))
    if key not in _KEPT:
        while len(_KEPT) >= KEPT:
            _KEPT.pop(next(iter(_KEPT)))
        rubber = make_rubber(wheel.radius, wheel.width, wheel.cover_thickness, wheel.cover_poisson, size, reach)
        ellipse = (round(PATCH[0] * patch, 4), round(min(PATCH[1] * patch, 0.45 * wheel.width), 4))
        _KEPT[key] = Tables(rubber, facets(blade), force / wheel.cover_modulus, ellipse)
    return _KEPT[key]


def _exact(p: Array, n: Array, t: Array) -> NDArray[np.int64]:
    """Contacts (k, 9) in tenths of a micrometre and microradians."""
    return np.round(np.concatenate([p * 1e7, n * 1e6, t * 1e6], axis=1)).astype(np.int64)


def _first(rubber: Rubber, here: Array) -> float:
    """Depth m at which wheel and blade touch."""
    first = float((here / rubber.cosine[:, None]).min())
    return first if np.isfinite(first) else ABSENT


def _crowding(here: Array, x: Array, y: Array, radius: float) -> float:
    """Share 0..1 to which an edge of the blade or its curvature crowds the contact.

    The larger of: 1 where the blade ends at the contact, falling to 0 at EDGE_ZONE; and k / (k + SHARP), k its largest curvature.
    """
    there = np.isfinite(here)
    if not there.any():
        return 0.0
    far = np.where(there, np.inf, np.hypot(x[:, None], y[None, :]))
    edge = max(0.0, 1.0 - float(far.min()) / EDGE_ZONE)
    near_by = there & (np.abs(x)[:, None] < 3e-3) & (np.abs(y)[None, :] < 3e-3)
    if near_by.sum() < 12:
        return edge
    X, Y = np.broadcast_arrays(x[:, None], y[None, :])
    terms = np.stack([np.ones(near_by.sum()), X[near_by], Y[near_by], X[near_by] ** 2, X[near_by] * Y[near_by], Y[near_by] ** 2])
    fit = np.linalg.lstsq(terms.T, here[near_by], rcond=None)[0]
    hessian = np.array([[2 * fit[3] - 1 / radius, fit[4]], [fit[4], 2 * fit[5]]])
    bent = max(float(np.linalg.eigvalsh(hessian)[-1]), 0.0)
    return max(edge, bent / (bent + SHARP))


SPACING, END_SPACING, END_ZONE = 2.5e-3, 1.25e-3, 6e-3  # m; the blade's edges come under the wheel at the ends of a line
SPARSE = 1.5e-3  # m between rows of a line above which the rows themselves are the stations
SAME = 1e-6  # m: rows this close in s are the same place
DIFFERENT = 5e-5  # m: points this far apart are not


@dataclass(frozen=True)
class PlannedLines:
    """Lines of n instants: which one a row is of, its arc length m, point m, normal and feed of the blade."""

    line: Index
    s: Array
    p: Array
    n: Array
    t: Array


@dataclass(frozen=True)
class SolvedStations(PlannedLines):
    """Places where contacts are solved; for each of n instants the stations on both sides with the share of the second."""

    left: Index
    right: Index
    share: Array


def place_stations(
    planned: ContactMoments | PlannedLines, rows: Index, now: Array, known: PlannedLines | None = None
) -> SolvedStations:
    """Stations on the lines of the planned instants `rows`, seen from arc lengths `now` (rows,) m; on `known` lines where given.

    Where rows are dense the places do not depend on how they are spaced. Raises ValueError: a line has two places at one s.
    """
    left, right = np.zeros(len(rows), np.int64), np.zeros(len(rows), np.int64)
    share = np.zeros(len(rows))
    parts: list[tuple[Array, Array]] = []
    line: list[Index] = []
    start = 0
    for number in np.unique(planned.line[rows]):
        own = np.flatnonzero(planned.line[rows] == number)
        source, at = (planned, rows[own]) if known is None else (known, np.flatnonzero(known.line == number))
        s, frames = _line(source.s[at], np.hstack([source.p[at], source.n[at], source.t[at]]))
        i = np.clip(np.searchsorted(s, now[own]) - 1, 0, max(len(s) - 2, 0))
        j = np.minimum(i + 1, len(s) - 1)
        gap = s[j] - s[i]
        share[own] = np.clip(np.divide(now[own] - s[i], gap, out=np.zeros(len(own)), where=gap > 0), 0.0, 1.0)
        left[own], right[own] = start + i, start + j
        parts.append((s, frames))
        line.append(np.full(len(s), number, np.int64))
        start += len(s)
    frames = np.vstack([f for _, f in parts])
    n = frames[:, 3:6] / np.linalg.norm(frames[:, 3:6], axis=1, keepdims=True)
    t = frames[:, 6:] - n * np.sum(frames[:, 6:] * n, axis=1, keepdims=True)
    t /= np.linalg.norm(t, axis=1, keepdims=True)
    s = np.concatenate([s for s, _ in parts])
    return SolvedStations(np.concatenate(line), s, frames[:, :3], n, t, left, right, share)


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


def contact_patches(tables: Tables, stations: SolvedStations, shape: Array) -> tuple[NDArray[np.float32], Index, Array]:
    """`Tables.shares` of the nearer stations (k, nx, ny), each in the posture of the instant that is nearest to it; which of them
    each instant has (n,), and where its planned point lies on their grid, along the belt and across (n, 2) m. A station that is
    passed in different postures counts as several, told apart by the lattice."""
    lattice = np.rint(shape / LATTICE).astype(np.int64)
    side = np.where(stations.share < 0.5, stations.left, stations.right)
    away = np.minimum(stations.share, 1.0 - stations.share)
    order = np.argsort(away, kind="stable")
    nodes = np.concatenate([side[:, None], lattice], axis=1)
    _, first, inside = np.unique(nodes[order], axis=0, return_index=True, return_inverse=True)
    nearest, index = order[first], np.empty(len(shape), np.int64)
    index[order] = np.asarray(inside).ravel()
    at = side[nearest]
    share = tables.shares(stations.p[at], stations.n[at], stations.t[at], shape[nearest])
    # Along the belt the pressure goes with the wheel, across with the blade's own curvature.
    return share, index, np.column_stack([-shape[:, 0], shape[nearest, 1][index]])


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
