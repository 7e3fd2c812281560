"""Wheel and blade seen from each other: the wheel's posture at a planned contact, and the blade's triangles over the wheel.

The axis of the wheel, seen from the contact frame (t, b = n x t, n) of the blade, with e the wheel's outward direction most
opposite to n and x = axis x e: the wheel's middle is at
p + along x - (R - depth) e - across axis  (docs/virtual_grinding.md, eq. 1).

Rays leave the axis at right angles through sample points of the unrolled wheel (x = radius times angle, y along the axis) and
meet the triangles exactly; rasterising their outline on (x, y) says which may be met. Where no triangle is met that looks
at the wheel, the blade has ended.

The blade is smooth, its triangles are chords of it: kinks of a centiradian, every other millimetre, would mark the pressure of a
rubber by a tenth. Between corners a, b whose normals differ by theta the surface bulges by theta L u v / 2 over its chord of
length L (a circle, to second order), and over a triangle with barycentric l_i by

    sum over edges of  l_a l_b (n_b - n_a)(x_b - x_a) / 2                                                                 (2)

with normals that the triangles about a corner make, weighted by their angle there (Thuermer and Wuethrich 1998, J. Graphics Tools
3, 43). Edges sharper than CREASE stay what they are.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from robots.pose import Array
from trajectories.blade import Blade


@dataclass(frozen=True)
class Postures:
    """n postures. depth m: overlap along e of the undeformed bodies; shape (n, 4): along m, across m, tilt rad (inclination of
    the axis to the tangent plane), turn rad (of x from t about n); e, x (n, 3): unit vectors in the base frame; overlap m:
    along the wheel radial through the planned point, as the plan counts it."""

    depth: Array
    shape: Array
    e: Array
    x: Array
    overlap: Array


def postures(T_base_blade: Array, p: Array, n: Array, t: Array, centre: Array, axis: Array, radius: Array) -> Postures:
    """Postures at blade poses (n, 4, 4) of contacts p, n, t (n, 3) in the blade frame, on wheels with centre m, axis (n, 3)
    and radius (n,) m."""
    R = T_base_blade[:, :3, :3]
    at = np.einsum("kij,kj->ki", R, p) + T_base_blade[:, :3, 3]
    normal, feed = np.einsum("kij,kj->ki", R, n), np.einsum("kij,kj->ki", R, t)
    lean = np.sum(normal * axis, axis=1)
    e = -(normal - lean[:, None] * axis)
    e /= np.linalg.norm(e, axis=1, keepdims=True)
    x = np.cross(axis, e)
    v = at - centre
    across = np.sum(v * axis, axis=1)
    turn = np.arctan2(np.sum(np.cross(normal, feed) * x, axis=1), np.sum(feed * x, axis=1))
    shape = np.column_stack([-np.sum(v * x, axis=1), across, np.arcsin(np.clip(lean, -1, 1)), turn])
    overlap = radius - np.linalg.norm(v - across[:, None] * axis, axis=1)
    return Postures(radius - np.sum(v * e, axis=1), shape, e, x, overlap)


def wheel_on_blade(p: Array, n: Array, t: Array, shape: Array, radius: float) -> tuple[Array, Array]:
    """Rotation (3, 3), rows x, axis, e, and middle (3,) of the wheel in the blade frame at a posture `shape` (4,) of depth 0."""
    along, across, tilt, turn = shape
    b = np.cross(n, t)
    x = np.cos(turn) * t + np.sin(turn) * b
    flat = np.cross(x, n)
    axis = np.cos(tilt) * flat + np.sin(tilt) * n
    e = np.sin(tilt) * flat - np.cos(tilt) * n
    return np.stack([x, axis, e]), p + along * x - radius * e - across * axis


FACING = 0.2  # smallest cosine between a triangle's outward normal and the wheel for the wheel to touch it
DEEPEST = 4e-3  # m below the wheel's surface: what is deeper belongs to the other side of the blade
SUBSAMPLES = 2  # samples across a cell in each direction, at Gauss points: cell means of quadratics are exact
CREASE = np.radians(30.0)  # between triangles, from which on an edge is one of the blade and no chord's
EDGE = 1e-6  # of an edge's length: how far outside it a sample counts, so that no crack opens between neighbours


@dataclass(frozen=True)
class Facets:
    """Triangles of a blade: corners (m, 3, 3) m, outward unit normals (m, 3), a ball around each: middle (m, 3), radius (m,);
    bulge (m, 3) m: the factor of l_a l_b in eq. 2, of the edges from each corner to the next."""

    corners: Array
    normals: Array
    bulge: Array
    middle: Array
    radius: Array


def facets(blade: Blade) -> Facets:
    """Triangles with an area."""
    corners = blade.vertices[blade.faces]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    size = np.linalg.norm(normals, axis=1)
    kept = size > 0
    corners, normals = corners[kept], normals[kept] / size[kept, None]
    middle = corners.mean(axis=1)
    radius = np.linalg.norm(corners - middle[:, None, :], axis=2).max(axis=1)
    return Facets(corners, normals, _bulge(corners, normals, blade.faces[kept]), middle, radius)


def _bulge(corners: Array, normals: Array, faces: NDArray[np.int64]) -> Array:
    """`Facets.bulge` (m, 3)."""
    ahead, behind = np.roll(corners, -1, axis=1) - corners, np.roll(corners, 1, axis=1) - corners
    lengths = np.linalg.norm(ahead, axis=2) * np.linalg.norm(behind, axis=2)
    angle = np.arccos(np.clip(np.sum(ahead * behind, axis=2) / lengths, -1.0, 1.0)).ravel()
    # All pairs of triangles that meet in a corner.
    order = np.argsort(faces.ravel(), kind="stable")
    count = np.unique(faces, return_counts=True)[1]
    start = np.repeat(np.cumsum(count) - count, count)
    times = np.repeat(count, count)
    one = np.repeat(order, times)
    other = order[np.repeat(start, times) + np.arange(times.sum()) - np.repeat(np.cumsum(times) - times, times)]
    like = np.sum(normals[one // 3] * normals[other // 3], axis=1) > np.cos(CREASE)
    weight = np.where(like, angle[other], 0.0)
    smooth = np.column_stack([np.bincount(one, weight * normals[other // 3, k]) for k in range(3)])
    smooth = (smooth / np.linalg.norm(smooth, axis=1, keepdims=True)).reshape(corners.shape)
    return np.asarray(0.5 * np.sum((np.roll(smooth, -1, axis=1) - smooth) * ahead, axis=2))


def near(surface: Facets, p: Array, reach: float) -> Facets:
    """The triangles that come within `reach` m of p."""
    kept = np.sum((surface.middle - p) ** 2, axis=1) < (surface.radius + reach) ** 2
    return Facets(*(values[kept] for values in vars(surface).values()))


def samples(cells: Array, size: float) -> Array:
    """Sample places (len(cells) SUBSAMPLES,) about cell middles: Gauss points of each cell."""
    points = np.polynomial.legendre.leggauss(SUBSAMPLES)[0]
    return np.asarray((cells[:, None] + 0.5 * size * points).ravel())


def gap(surface: Facets, frame: Array, middle: Array, radius: float, x: Array, y: Array, dx: float, dy: float) -> Array:
    """Height (nx, ny) m of the blade over the undeformed wheel, mean over cells at x, y; inf where half a cell or more is empty.

    `frame` (3, 3) has rows x, axis, e and `middle` (3,) is the wheel's, both on the blade.
    """
    xs, ys = samples(x, dx), samples(y, dy)
    looking = surface.normals @ frame[2] < -FACING
    corners = (surface.corners[looking] - middle) @ frame.T
    normals = surface.normals[looking] @ frame.T
    height = _heights(corners, normals, surface.bulge[looking], radius, xs, ys)
    cells = height.reshape(len(x), SUBSAMPLES, len(y), SUBSAMPLES).transpose(0, 2, 1, 3).reshape(len(x), len(y), -1)
    there = np.isfinite(cells)
    number = there.sum(axis=2)
    mean = np.where(there, cells, 0.0).sum(axis=2) / np.maximum(number, 1)
    return np.where(2 * number > cells.shape[2], mean, np.inf)


def _heights(corners: Array, normals: Array, bulge: Array, radius: float, xs: Array, ys: Array) -> Array:
    """Height (len(xs), len(ys)) of the lowest triangle met, inf where none is; corners (m, 3, 3) about the wheel's middle."""
    angle = np.arctan2(corners[..., 0], corners[..., 2])
    u, v = radius * angle, corners[..., 1]
    first_x, last_x = _window(xs, u.min(axis=1), u.max(axis=1))
    first_y, last_y = _window(ys, v.min(axis=1), v.max(axis=1))
    wide, tall = np.maximum(last_x - first_x, 0), np.maximum(last_y - first_y, 0)
    count = wide * tall
    triangle = np.repeat(np.arange(len(corners)), count)
    inner = np.arange(len(triangle)) - np.repeat(np.cumsum(count) - count, count)
    i = first_x[triangle] + inner // np.maximum(tall[triangle], 1)
    j = first_y[triangle] + inner % np.maximum(tall[triangle], 1)
    # Ray: reach (sin, 0, cos) + (0, y, 0), met with the triangle's plane; then inside of all three edges.
    facing = np.sum(normals * corners[:, 0], axis=1)
    sine, cosine = np.sin(xs / radius), np.cos(xs / radius)
    down = normals[triangle, 0] * sine[i] + normals[triangle, 2] * cosine[i]
    reach = (facing[triangle] - normals[triangle, 1] * ys[j]) / np.where(down < -FACING, down, np.inf)
    kept = (down < -FACING) & (reach - radius > -DEEPEST)
    inside = np.zeros((len(triangle), 0))  # barycentric coordinates of the corners before the edges
    for a in range(3):
        triangle, i, j, reach, down, inside = (v[kept] for v in (triangle, i, j, reach, down, inside))
        edge = corners[:, (a + 1) % 3] - corners[:, a]
        inward = np.cross(normals, edge)
        border = np.sum(inward * corners[:, a], axis=1)
        across, place = inward[triangle], reach * sine[i]
        over = across[:, 0] * place + across[:, 1] * ys[j] + across[:, 2] * reach * cosine[i] - border[triangle]
        tall = np.sum(inward * corners[:, (a + 2) % 3], axis=1) - border
        kept = over > -EDGE * np.sum(edge**2, axis=1)[triangle]
        inside = np.column_stack([inside, over / tall[triangle]])
    triangle, i, j, inside = triangle[kept], i[kept], j[kept], inside[kept]
    first, second, third = inside[:, 1], inside[:, 2], inside[:, 0]
    out = np.sum(bulge[triangle] * np.column_stack([first * second, second * third, third * first]), axis=1)
    height = reach[kept] - radius + out / down[kept]
    lowest = np.full((len(xs), len(ys)), np.inf)
    np.minimum.at(lowest, (i, j), height)
    return lowest


def _window(samples_: Array, low: Array, high: Array) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    slack = 1e-7  # m: rounding
    return np.searchsorted(samples_, low - slack), np.searchsorted(samples_, high + slack)
