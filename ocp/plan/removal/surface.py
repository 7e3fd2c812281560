"""The blade's surface as cells, which of them are asked to be ground, and what rows of contact take off them."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from ocp.plan.removal.footprint import LinePatches
from robots.pose import Array
from trajectories.blade import AerofoilShape
from trajectories.blade.window import Window
from trajectories.passes import BladePath

Mask = NDArray[np.bool_]
Index = NDArray[np.int64]
GRID = 7e-4  # m between cells: a fifth of a usual half axis
FACING = 0.5  # smallest cosine between a cell's normal and the contact's for it to be reached: the other wall looks away
LEAST_ROW = 1e-9  # of the force there is: rows with less take nothing off


@dataclass(frozen=True)
class SideCells:
    """Cells of one flank on an even grid of its parameters, (i, j) along the chord and the span.

    points, normals (i, j, 3) m, blade frame; area (i, j) m^2; asked (i, j): between the margins; along (i, j) m on the surface
    from the root's end, across (i, j) m from the leading edge's.
    """

    side: str
    points: Array
    normals: Array
    area: Array
    asked: Mask
    along: Array
    across: Array


def flank_cells(shape: AerofoilShape, windows: Mapping[str, Window], paths: Sequence[BladePath], strip: float) -> list[SideCells]:
    """The flanks that are ground, in cells of about GRID. Asked is what lies in the `windows` (by side); without any, what lies
    within `strip` m of the `paths` and looks their way. A path round an edge may leave none."""
    names = [name for name in shape.sides if name in windows or not windows]
    found = [_cells(shape, name, windows.get(name), paths, strip) for name in names]
    return [one for one in found if one.asked.any()]


def _cells(shape: AerofoilShape, name: str, window: Window | None, paths: Sequence[BladePath], strip: float) -> SideCells:
    side = shape.sides[name]
    n_u = int(np.ceil(side.width.max() / GRID))
    n_v = int(np.ceil((shape.v[1] - shape.v[0]) / GRID))
    u_step, v_step = 1.0 / n_u, (shape.v[1] - shape.v[0]) / n_v
    u, v = np.meshgrid((np.arange(n_u) + 0.5) * u_step, shape.v[0] + (np.arange(n_v) + 0.5) * v_step, indexing="ij")
    flat = u.ravel(), v.ravel()
    points, normals = (x.reshape(n_u, n_v, 3) for x in (side.surface(*flat), side.normal(*flat)))
    along_u, along_v = (side.surface(*flat, *order).reshape(n_u, n_v, 3) for order in ((1, 0), (0, 1)))
    area = np.linalg.norm(np.cross(along_u, along_v), axis=2) * u_step * v_step
    if window is not None:
        asked = (u >= np.interp(v, window.v, window.u_lo)) & (u <= np.interp(v, window.v, window.u_hi))
        asked &= (v >= np.interp(u, window.u, window.v_lo)) & (v <= np.interp(u, window.u, window.v_hi))
    else:
        distance, nearest = cKDTree(np.vstack([path.p for path in paths])).query(points)
        facing = np.sum(np.vstack([path.n for path in paths])[nearest] * normals, axis=2) > FACING
        asked = (distance <= strip) & facing
    along = np.cumsum(np.linalg.norm(along_v, axis=2), axis=1) * v_step
    across = np.cumsum(np.linalg.norm(along_u, axis=2), axis=0) * u_step
    return SideCells(name, points, normals, area, asked, along, across)


def core_cells(cells: SideCells, paths: Sequence[BladePath], half_length: Sequence[float] | Array) -> Mask:
    """Asked cells (i, j) between the outermost lines of the side and at least a patch's half-length m (one a path) inside both
    ends of the line nearest to them."""
    own = [k for k, path in enumerate(paths) if path.side == cells.side]
    flat = cells.points.reshape(-1, 3)
    inside = np.zeros(len(flat), bool)
    numbers = list(dict.fromkeys(paths[k].line for k in own))
    if len(numbers) < 2:
        return inside.reshape(cells.asked.shape)
    found = [cKDTree(paths[k].p).query(flat) for k in own]
    nearest = np.argmin([distance for distance, _ in found], axis=0)
    outer = _outermost({line: np.vstack([paths[k].p for k in own if paths[k].line == line]).mean(axis=0) for line in numbers})
    for k, number in enumerate(own):
        path, mine = paths[number], np.flatnonzero(nearest == k)
        at = found[k][1][mine]
        kept = (path.s[at] >= half_length[number]) & (path.s[at] <= path.s[-1] - half_length[number])
        if path.line in outer:
            offset, neighbour = flat[mine] - path.p[at], outer[path.line] - path.p[at]
            b = np.cross(path.n[at], path.t[at])
            kept &= np.sum(offset * b, axis=1) * np.sum(neighbour * b, axis=1) >= 0.0
        inside[mine] = kept
    return inside.reshape(cells.asked.shape) & cells.asked


def _outermost(middles: Mapping[int, Array]) -> dict[int, Array]:
    """Which of the lines, by number with the middle (3,) of all their pieces, have all others on one side; with the middle of the
    line next to them."""
    numbers, places = list(middles), np.array(list(middles.values()))
    spread = places - places.mean(axis=0)
    order = np.argsort(spread @ np.linalg.svd(spread, full_matrices=False)[2][0])
    ends = {order[0]: order[1], order[-1]: order[-2]}
    return {numbers[end]: places[neighbour] for end, neighbour in ends.items()}


@dataclass(frozen=True)
class ContactRows:
    """Moments of contact, n rows: line's `place` in driving order (n,); p, n, t (n, 3) blade frame; s (n,) m along the line;
    force (n,) N; slide (n,) m of belt that passes in the row's share of time, against the moving blade."""

    place: NDArray[np.int64]
    p: Array
    n: Array
    t: Array
    s: Array
    force: Array
    slide: Array

    def of(self, place: int) -> "ContactRows":
        """The rows of one line that bear."""
        mine = (self.place == place) & (self.force > LEAST_ROW * self.force.max(initial=1.0))
        return ContactRows(*(getattr(self, name)[mine] for name in ContactRows.__dataclass_fields__))


def work_done(points: Array, normals: Array, rows: ContactRows, patches: Sequence[LinePatches]) -> Array:
    """Pressure times slid length, N/m, at surface points (m, 3) with normals (m, 3), of all rows summed: (m,).

    patches: of each line, in driving order. Preston's coefficient makes it a depth (docs/process.md, eq. 1).
    """
    tree = cKDTree(points)
    return np.asarray(sum(work_of(tree, normals, rows.of(place), one) for place, one in enumerate(patches)))


def work_of(tree: cKDTree, normals: Array, rows: ContactRows, patches: LinePatches) -> Array:
    """`work_done` of one line at the points of the tree: its `rows` are `ContactRows.of`."""
    row, index, pressure = pressures(tree, normals, rows, patches)
    return np.bincount(index, pressure * (rows.force * rows.slide)[row], minlength=tree.n).astype(float)


def pressures(tree: cKDTree, normals: Array, rows: ContactRows, patches: LinePatches) -> tuple[Index, Index, Array]:
    """Which of the `rows` of one line presses on which point of the tree (with `normals`), and with what pressure per newton:
    three times (k,)."""
    if not len(rows.s):
        return np.zeros(0, np.int64), np.zeros(0, np.int64), np.zeros(0)
    reach = patches.reach * float(patches.size(rows.s, rows.force).max())
    near = cKDTree(rows.p).sparse_distance_matrix(tree, reach, output_type="ndarray")
    row, index = (np.ascontiguousarray(near[name]) for name in "ij")
    facing = _dots(_gathered(normals, index), _gathered(rows.n, row)) > FACING
    row, index = row[facing], index[facing]
    offset = [there - here for there, here in zip(_gathered(tree.data, index), _gathered(rows.p, row), strict=True)]
    along, across = (_dots(offset, _gathered(axis, row)) for axis in (rows.t, np.cross(rows.n, rows.t)))
    return row, index, patches.pressure(rows.s[row], along, across, rows.force[row])


def _gathered(vectors: Array, index: Index) -> list[Array]:
    """Components x, y, z (k,) of vectors (n, 3) at an index (k,): a million triples are gathered in a third of the time."""
    return [np.ascontiguousarray(component).take(index) for component in vectors.T]


def _dots(one: Sequence[Array], other: Sequence[Array]) -> Array:
    """Products of vectors given by their components."""
    (x, y, z), (u, v, w) = one, other
    return x * u + y * v + z * w


def row_times(duration: float, feed: float, step: float = 5e-4) -> Array:
    """Times (n,) s from 0 to `duration`, a row every `step` m at `feed` m/s."""
    return np.linspace(0.0, duration, max(int(np.ceil(duration * feed / step)), 8) + 1)


def shares_of_time(time: Array) -> Array:
    """Seconds (n,) that each row of rising times (n,) stands for, trapezoid rule."""
    gaps = np.array([b - a for a, b in pairwise(time)])
    return 0.5 * (np.concatenate([gaps, [0.0]]) + np.concatenate([[0.0], gaps]))
