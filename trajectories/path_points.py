"""Contact frames that come from elsewhere, put onto the surface of a blade and completed into passes; also those of a path.csv,
read and checked line by line."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
import trimesh
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline
from scipy.spatial import cKDTree

from robots.csv_table import read_csv_table
from robots.errors import BadInput
from robots.pose import Array
from trajectories.blade.fit import SideSurface
from trajectories.blade.mesh import Blade, area_weighted_normals, place_mm
from trajectories.blade.nearest import nearest_on_facets
from trajectories.blade.shape import AerofoilShape
from trajectories.blade.spline import nearest_parameters
from trajectories.blade.surroundings import MAX_TURN
from trajectories.passes import MOST_WAYPOINTS, BladePath, ContactFrames, describe

OFF_SURFACE = 0.2e-3  # m: points farther off than this are refused
NORMAL_LIMIT = np.deg2rad(15.0)  # a normal that differs more from the surface's is refused
FEED_LIMIT = np.deg2rad(60.0)  # a feed direction that differs more from the way to the next point is refused
IN_METRES = 1e-6, 3e-4  # m between the points farthest apart: passes in metres taken as millimetres; no pass is as short
_NEIGHBOURS = 40  # mesh vertices of a local quadric
_LARGEST_EXTENT = 0.05  # m: extents are not followed farther than this


def paths_from_points(
    blade: Blade,
    shape: AerofoilShape,
    line: NDArray[np.int64],
    p: Array,
    n: Array,
    t: Array,
    feed: Array,
    force: Array,
    source: str,
    places: list[str],
    step: float,
) -> tuple[list[BladePath], list[str]]:
    """Passes through given contact frames, and notices.

    line (m,): number of the pass of each point, equal numbers in one stretch; p (m, 3) m; n, t (m, 3) unit to 1 %;
    feed (m,) m/s; force (m,) N; source: file, places (m,): what to call each point in messages.
    Points are moved onto the surface and take its normals; t loses its part along n. Where points of a pass stand farther than
    `step` m apart others come between them.
    Raises: BadInput for points in metres, off the surface, wrong normals or feed directions, passes of fewer than 3 points, a way
    between points that leaves the surface.
    """
    _refuse_lengths(source, places, n, t)
    refuse_metres(p, f"{source}, {places[0]}")
    name, u, v, foot, normal, gap = feet_on_blade(blade, shape, p, lambda k: f"{source}, {places[k]}")
    angle = angles_to_surface(n, normal, lambda k: f"{source}, {places[k]}")
    paths, waypoints = [], 0
    starts = np.flatnonzero(np.concatenate([[True], line[1:] != line[:-1]]))
    for i, j in zip(starts, [*starts[1:], len(line)], strict=True):
        rows = np.arange(i, j)
        s, feed_direction = _along(source, places, rows, foot[rows], normal[rows], t[rows], int(line[i]))
        at = ContactFrames(int(line[i]), foot[rows], normal[rows], feed_direction, s, feed[rows], force[rows])
        at, names, on_u, on_v = _filled(
            blade, shape, at, name[rows], u[rows], v[rows], step, [f"{source}, {places[k]}" for k in rows]
        )
        waypoints += len(at.s)
        if waypoints > MOST_WAYPOINTS:
            raise BadInput(
                f"{source}: {waypoints} waypoints up to line {at.line}, the limit is {MOST_WAYPOINTS}; take a longer step"
            )
        sides = set(names)
        if sides <= set(shape.sides) and len(sides) == 1:
            paths.append(describe(shape, shape.sides[sides.pop()], on_u, on_v, at))
        else:
            paths.append(describe_off_flank(blade, shape, at))
    return paths, _notices(source, gap, angle, name)


def _filled(
    blade: Blade,
    shape: AerofoilShape,
    at: ContactFrames,
    name: NDArray[np.str_],
    u: Array,
    v: Array,
    step: float,
    places: list[str],
) -> tuple[ContactFrames, NDArray[np.str_], Array, Array]:
    """A pass with points about `step` m apart where its own stand farther from each other, on the surface below a cubic through
    these; of all of them side name or "edge" and parameters, as of its own, which `places` names."""
    more = np.maximum(np.round(np.diff(at.s) / step).astype(np.int64) - 1, 0)
    if not more.any():
        return at, name, u, v
    before = np.repeat(np.arange(len(more)), more)
    part = np.concatenate([np.arange(1, k + 1) / (k + 1) for k in more])
    between = at.s[before] + part * np.diff(at.s)[before]
    found = feet_on_blade(
        blade, shape, CubicSpline(at.s, at.p)(between), lambda k: f"{places[before[k]]}, on the way to the next point"
    )
    order = np.argsort(np.concatenate([at.s, between]), kind="stable")
    name, u, v, p, n = (np.concatenate(both)[order] for both in zip((name, u, v, at.p, at.n), found[:5], strict=True))
    s = np.concatenate([at.s, between])[order]
    t = np.stack([np.interp(s, at.s, column) for column in at.t.T], axis=1)
    feed, force = np.interp(s, at.s, at.feed), np.interp(s, at.s, at.force)
    t -= np.einsum("ni,ni->n", t, n)[:, None] * n
    t /= np.maximum(np.linalg.norm(t, axis=1, keepdims=True), 1e-12)
    s = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(p, axis=0), axis=1))])
    return ContactFrames(at.line, p, n, t, s, feed, force), name, u, v


def _notices(source: str, gap: Array, angle: Array, name: NDArray[np.str_]) -> list[str]:
    notices = []
    if gap.max() > 1e-6 or angle.max() > np.deg2rad(0.05):
        notices.append(
            f"{source}: points were moved onto the surface by up to {1e3 * gap.max():.3f} mm and normals turned "
            f"by up to {np.rad2deg(angle.max()):.2f} deg."
        )
    edge = int((name == "edge").sum())
    if edge:
        notices.append(
            f"{source}: {edge} points lie on an edge, a fillet or the block; passes with such points take their "
            f"curvature from the facets nearby, which is rough."
        )
    return notices


def _refuse_lengths(source: str, places: list[str], n: Array, t: Array) -> None:
    for what, vectors in (("n", n), ("t", t)):
        length = np.linalg.norm(vectors, axis=1)
        bad = np.abs(length - 1.0) > 0.01
        if bad.any():
            k = int(np.argmax(bad))
            raise BadInput(
                f"{source}, {places[k]}: the vector ({what}x, {what}y, {what}z) has length {length[k]:.4g}, "
                f"a unit vector is expected."
            )


def refuse_metres(p: Array, where: str) -> None:
    """Raises BadInput: the points p (m, 3) m lie as near to one another as in metres; `where` names the first."""
    span = float(np.ptp(p, axis=0).max())
    if IN_METRES[0] < span < IN_METRES[1]:
        raise BadInput(
            f"{where}: all {len(p)} points lie within {1e3 * span:.2g} mm of one another, which is no pass; if they are in "
            "metres, give millimetres"
        )


def feet_on_blade(
    blade: Blade, shape: AerofoilShape, p: Array, where: Callable[[int], str]
) -> tuple[NDArray[np.str_], Array, Array, Array, Array, Array]:
    """As `locate`, edges on the mesh itself, and the distance (m,) m of each point p (m, 3) from its foot.

    Raises BadInput: a point is farther than OFF_SURFACE from the blade; `where` names it.
    """
    name, u, v, foot, normal = locate(shape, p)
    place_on_mesh(blade, name, foot, normal, p)
    gap = np.linalg.norm(foot - p, axis=1)
    off = gap > OFF_SURFACE
    if off.any():
        k = int(np.argmax(off))
        raise BadInput(
            f"{where(k)}: the point {place_mm(p[k])} is {1e3 * gap[k]:.3f} mm off the surface of {blade.name}, the limit is "
            f"{1e3 * OFF_SURFACE:g} mm ({int(off.sum())} such points): is it the same blade in the same frame?"
        )
    return name, u, v, foot, normal, gap


def angles_to_surface(n: Array, normal: Array, where: Callable[[int], str]) -> Array:
    """Angles (m,) rad between given normals n (m, 3) and the surface's. Raises BadInput: one is beyond NORMAL_LIMIT."""
    n = n / np.linalg.norm(n, axis=1, keepdims=True)
    angle = np.arccos(np.clip(np.einsum("ni,ni->n", n, normal), -1.0, 1.0))
    if (angle > NORMAL_LIMIT).any():
        k = int(np.argmax(angle > NORMAL_LIMIT))
        how = "points into the blade" if angle[k] > np.pi / 2 else f"is {np.rad2deg(angle[k]):.1f} deg off the surface's"
        raise BadInput(
            f"{where(k)}: the normal ({n[k, 0]:.4f}, {n[k, 1]:.4f}, {n[k, 2]:.4f}) {how}, the limit is "
            f"{np.rad2deg(NORMAL_LIMIT):g} deg; give outward unit normals."
        )
    return np.asarray(angle)


def locate(shape: AerofoilShape, p: Array) -> tuple[NDArray[np.str_], Array, Array, Array, Array]:
    """Side name or "edge", parameters, foot point and normal of each point; nan feet where no flank is below it."""
    name = np.full(len(p), "edge", dtype="<U8")
    u, v, best = np.zeros(len(p)), np.zeros(len(p)), np.full(len(p), np.inf)
    foot, normal = np.full_like(p, np.nan), np.full_like(p, np.nan)
    for side in shape.sides.values():
        su, sv = foot_parameters(side, shape, p)
        x = side.surface(su, sv)
        gap = np.linalg.norm(x - p, axis=1)
        inside = (su > 1e-4) & (su < 1.0 - 1e-4) & (sv > shape.v[0] + 1e-7) & (sv < shape.v[1] - 1e-7)
        better = inside & (gap < best) & (gap < 5.0 * OFF_SURFACE)
        name[better], u[better], v[better], best[better] = side.name, su[better], sv[better], gap[better]
        foot[better], normal[better] = x[better], side.normal(su[better], sv[better])
    return name, u, v, foot, normal


def foot_parameters(side: SideSurface, shape: AerofoilShape, p: Array) -> tuple[Array, Array]:
    """Parameters (n,), (n,) of the points of a side nearest to p (n, 3)."""
    grid = np.meshgrid(np.linspace(0.0, 1.0, 60), np.linspace(shape.v[0], shape.v[1], 60), indexing="ij")
    gu, gv = grid[0].ravel(), grid[1].ravel()
    _, index = cKDTree(side.surface(gu, gv)).query(p)
    return nearest_parameters(side.surface, p, gu[index], gv[index])


def place_on_mesh(blade: Blade, name: NDArray[np.str_], foot: Array, normal: Array, p: Array) -> None:
    """Foot and facet normal on the mesh itself for the points that lie on no flank (changes foot and normal)."""
    rest = np.flatnonzero(name == "edge")
    if not len(rest):
        return
    closest, _, facet = nearest_on_facets(blade, p[rest])
    weights = trimesh.triangles.points_to_barycentric(blade.vertices[blade.faces[facet]], closest)
    n = np.einsum("nk,nki->ni", weights, area_weighted_normals(blade)[blade.faces[facet]])
    foot[rest], normal[rest] = closest, n / np.linalg.norm(n, axis=1, keepdims=True)


def _along(
    source: str, places: list[str], rows: NDArray[np.int64], p: Array, n: Array, t: Array, line: int
) -> tuple[Array, Array]:
    """Arc length (m,) and feed directions made orthogonal to n."""
    if len(rows) < 3:
        raise BadInput(f"{source}, {places[rows[0]]}: line {line} has {len(rows)} points, at least 3 are needed.")
    steps = np.linalg.norm(np.diff(p, axis=0), axis=1)
    if steps.min() < 1e-6:
        k = rows[int(np.argmin(steps)) + 1]
        raise BadInput(f"{source}, {places[k]}: this point of line {line} repeats the one before it; remove one of them.")
    t = t - np.einsum("ni,ni->n", t, n)[:, None] * n
    length = np.linalg.norm(t, axis=1, keepdims=True)
    if length.min() < 0.5:
        raise BadInput(
            f"{source}, {places[rows[int(np.argmin(length))]]}: the feed direction t stands on the surface; "
            f"give the direction of travel along the blade."
        )
    t = t / length
    s = np.concatenate([[0.0], np.cumsum(steps)])
    motion = np.gradient(p, s, axis=0)
    # Where the points turn back on themselves there is no way to go along.
    cosine = np.einsum("ni,ni->n", motion, t) / np.maximum(np.linalg.norm(motion, axis=1), 1e-6)
    if cosine.min() < np.cos(FEED_LIMIT):
        k = int(np.argmin(cosine))
        angle = np.rad2deg(np.arccos(np.clip(cosine[k], -1.0, 1.0)))
        raise BadInput(
            f"{source}, {places[rows[k]]}: t is {angle:.0f} deg off the way from point to point of line {line} "
            f"(limit {np.rad2deg(FEED_LIMIT):g} deg); t is the direction of travel."
        )
    return s, t


def describe_off_flank(blade: Blade, shape: AerofoilShape, at: ContactFrames) -> BladePath:
    """A pass that leaves the smooth flanks (round an edge, over a fillet), side "edge", from frames on the mesh.

    Curvature and extent are what the facets nearby tell, roughly.
    """
    b = np.cross(at.n, at.t)
    curvature = facet_curvature(blade, at.p, at.n, at.t, b)
    return at.path("edge", curvature, _extent(blade, shape, at.p, at.t, b, curvature))


def facet_curvature(blade: Blade, p: Array, n: Array, t: Array, b: Array) -> Array:
    """k_tt, k_bb, k_tb (m, 3) 1/m of quadrics fitted to the slopes of the vertex normals round each point.

    Slopes dz/dx = -n_x / n_z carry the second derivatives more evenly than heights, which a coarse mesh cuts short.
    """
    tree, normals = cKDTree(blade.vertices), area_weighted_normals(blade)
    out = np.empty((len(p), 3))
    for k in range(len(p)):
        _, near = tree.query(p[k], min(_NEIGHBOURS, len(blade.vertices)))
        near = near[normals[near] @ n[k] > 0.3]
        if len(near) < 5:
            out[k] = 0.0
            continue
        r, m = blade.vertices[near] - p[k], normals[near]
        x, y, up = r @ t[k], r @ b[k], m @ n[k]
        zero, one = np.zeros_like(x), np.ones_like(x)
        rows = np.concatenate([np.stack([x, zero, y, one, zero], 1), np.stack([zero, y, x, zero, one], 1)])
        fit = np.linalg.lstsq(rows, np.concatenate([-(m @ t[k]) / up, -(m @ b[k]) / up]), rcond=None)[0]
        out[k] = -fit[0], -fit[1], -fit[2]
    return out


def _extent(blade: Blade, shape: AerofoilShape, p: Array, t: Array, b: Array, curvature: Array) -> Array:
    """Distances (m, 4): a turn of 60 deg at the local curvature, or the end of the blade along the span."""
    axis = shape.frame.axis
    height = blade.vertices @ axis
    here = (p @ axis)[:, None]
    rise = np.stack([t @ axis, -(t @ axis), b @ axis, -(b @ axis)], axis=1)
    to_end = np.where(rise > 0.0, height.max() - here, here - height.min()) / np.maximum(np.abs(rise), 1e-3)
    turn = MAX_TURN / np.maximum(curvature[:, [0, 0, 1, 1]], MAX_TURN / _LARGEST_EXTENT)
    return np.asarray(np.minimum(turn, np.maximum(to_end, 0.0)))


NEEDED = ("line", "px_mm", "py_mm", "pz_mm", "nx", "ny", "nz", "tx", "ty", "tz")
OPTIONAL = ("feed_mm_s", "force_N")


def read_path_file(
    path: str | Path, blade: Blade, shape: AerofoilShape, feed: float, force: float, step: float
) -> tuple[list[BladePath], list[str]]:
    """Passes of a path.csv on a blade, waypoints at most about `step` m apart, and notices; feed m/s and force N stand in where
    the columns are absent.

    Raises: BadInput naming file, line, column and value, or the distance of a point off the surface.
    """
    path = Path(path)
    read = read_csv_table(path, NEEDED, OPTIONAL)
    table, numbers = read.numbers, read.line
    notices = [f"{one}." for one in read.ignored_columns()]
    for column, default, unit in (("feed_mm_s", 1e3 * feed, "mm/s"), ("force_N", force, "N")):
        if column not in table:
            table[column] = np.full(len(numbers), default)
            notices.append(f"{path.name}: no column {column}, {default:g} {unit} is used throughout.")
        elif (table[column] <= 0.0).any():
            k = int(np.argmax(table[column] <= 0.0))
            raise BadInput(f"{path}, line {numbers[k]}, column {column}: {table[column][k]:g} {unit} must be above 0.")
    line = _line_numbers(path, table["line"], numbers)
    p = 1e-3 * np.stack([table[c] for c in ("px_mm", "py_mm", "pz_mm")], axis=1)
    n = np.stack([table[c] for c in ("nx", "ny", "nz")], axis=1)
    t = np.stack([table[c] for c in ("tx", "ty", "tz")], axis=1)
    places = [f"line {number}" for number in numbers]
    asked = 1e-3 * table["feed_mm_s"], table["force_N"]
    paths, more = paths_from_points(blade, shape, line, p, n, t, *asked, str(path), places, step)
    return paths, notices + more


def _line_numbers(path: Path, values: Array, numbers: list[int]) -> NDArray[np.int64]:
    """Line numbers of the passes as integers, each in one stretch."""
    bad = (values != np.round(values)) | (values < 1)
    if bad.any():
        k = int(np.argmax(bad))
        raise BadInput(f"{path}, line {numbers[k]}, column line: {values[k]:g} is not a whole number from 1 on.")
    line = values.astype(np.int64)
    starts = np.flatnonzero(np.concatenate([[True], line[1:] != line[:-1]]))
    seen: set[int] = set()
    for i in starts.tolist():
        if int(line[i]) in seen:
            raise BadInput(
                f"{path}, line {numbers[i]}, column line: line {line[i]} was left and comes again; give every "
                f"pass a number of its own."
            )
        seen.add(int(line[i]))
    return line
