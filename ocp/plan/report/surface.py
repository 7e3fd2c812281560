"""The blade as it is drawn: fine enough to carry colour where it was ground, small enough to be shipped; a still picture of it.

Every vertex near a pass gets up to four waypoints with weights: the two nearest on each of the two nearest
passes. Between two passes the weights fade from one to the other, so a value painted on the surface is a
linear interpolation of neighbouring waypoints and never leaves their range.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.collections import PolyCollection
from matplotlib.colors import Colormap, Normalize, to_rgb
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from ocp.plan.report.plan_report import GroundPass
from ocp.report.plotting import Canvas
from ocp.report.style import LEFT_OUT, NOT_GROUND, SOFT
from robots.pose import Array

MAX_FACES = 60_000
"""More triangles than this are clustered away: on a screen nobody sees them, and the page stays small."""
LONE_PASS_WIDTH = 0.004
"""m; painted width where there is one pass only and no spacing is given: about a contact patch."""


_LIGHT = np.array([0.35, 0.35, 0.87])


@dataclass(frozen=True)
class PaintedBlade:
    """Triangles `vertices` (nv, 3) m, `faces` (nf, 3); per vertex `waypoint` (nv, 4) and `weight` (nv, 4); `left` (nf,):
    triangles nearer to what is left out than to a pass.

    Waypoints count through all passes in order. The sum of a vertex's weights is its cover: 1 near a pass,
    falling with the distance; the surface counts as ground where it is at least 0.5. Being linear across a
    triangle, that border is a smooth line instead of a row of teeth.
    """

    vertices: Array
    faces: NDArray[np.int64]
    waypoint: NDArray[np.int64]
    weight: Array
    left: NDArray[np.bool_]


def paint_blade(
    vertices: Array, faces: NDArray[Any], passes: Sequence[GroundPass], spacing: float = 0.0, left_out: Sequence[GroundPass] = ()
) -> PaintedBlade:
    """Blade mesh ready for drawing, see `PaintedBlade`; `spacing` m between passes, 0 = measured."""
    spacing = spacing if spacing > 0 else pass_spacing(passes)
    small = cluster_vertices(np.asarray(vertices, float), np.asarray(faces, np.int64), MAX_FACES)
    everything = [*passes, *left_out]
    fine, triangles = refine_near(*small, np.concatenate([item.p for item in everything]), spacing)
    waypoint, weight = paint_weights(fine, angle_weighted_normals(fine, triangles), everything, 0.6 * spacing)
    beyond = waypoint >= sum(len(item.s) for item in passes)
    cover, lost = weight.sum(axis=1), np.where(beyond, weight, 0.0).sum(axis=1)
    left = (cover[triangles].mean(axis=1) >= 0.5) & (2 * lost[triangles].sum(axis=1) > cover[triangles].sum(axis=1))
    return PaintedBlade(fine, triangles, np.where(beyond, 0, waypoint), np.where(beyond, 0.0, weight), left)


def pass_spacing(passes: Sequence[GroundPass]) -> float:
    """Distance m between neighbouring passes of one side: the 90th percentile over waypoints."""
    found = []
    for item in passes:
        others = [other.p for other in passes if other.side == item.side and other is not item]
        if others:
            found.append(cKDTree(np.concatenate(others)).query(item.p)[0])
    return float(np.percentile(np.concatenate(found), 90)) if found else LONE_PASS_WIDTH


def angle_weighted_normals(vertices: Array, faces: NDArray[np.int64]) -> Array:
    """Unit normals of the vertices (nv, 3), faces weighted by their angle at the vertex.

    Weights by area would let one long triangle beyond an edge turn the normals of a finely divided face away.
    """
    corners = vertices[faces]
    ahead = np.roll(corners, -1, axis=1) - corners
    behind = np.roll(corners, 1, axis=1) - corners
    turned = np.cross(ahead, behind)
    size = np.linalg.norm(turned, axis=2, keepdims=True)
    angle = np.arctan2(size, (ahead * behind).sum(axis=2, keepdims=True))
    pull = (angle * turned / np.maximum(size, 1e-300)).reshape(-1, 3)
    index = faces.ravel()
    normals = np.stack([np.bincount(index, pull[:, k], minlength=len(vertices)) for k in range(3)], axis=-1)
    return np.asarray(normals / np.maximum(np.linalg.norm(normals, axis=1), 1e-30)[:, None])


def cluster_vertices(vertices: Array, faces: NDArray[np.int64], max_faces: int) -> tuple[Array, NDArray[np.int64]]:
    """Merge vertices that share a grid cell until at most `max_faces` triangles remain (for drawing only)."""
    size = float(np.ptp(vertices, axis=0).max()) / 400
    while len(faces) > max_faces:
        cell = np.floor((vertices - vertices.min(axis=0)) / size).astype(np.int64)
        _, owner = np.unique(cell, axis=0, return_inverse=True)
        owner = owner.ravel()
        count = np.bincount(owner)
        vertices = np.stack([np.bincount(owner, vertices[:, k]) / count for k in range(3)], axis=-1)
        faces = owner[faces]
        distinct = (faces != np.roll(faces, 1, axis=1)).all(axis=1)
        faces, size = faces[distinct], size * 1.3
    return vertices, np.asarray(faces, np.int64)


def refine_near(vertices: Array, faces: NDArray[np.int64], points: Array, spacing: float) -> tuple[Array, NDArray[np.int64]]:
    """Quarter triangles near `points` until their edges are below half of `spacing`.

    Flat faces of a coarse STL would otherwise smear one colour over many passes. Neighbours of a quartered
    triangle keep their straight edge, so no gap opens.
    """
    tree = cKDTree(points)
    for _ in range(6):
        corners = vertices[faces]
        longest = np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=2).max(axis=1)
        large = np.flatnonzero(longest > 0.5 * spacing)
        distance = tree.query(corners[large].mean(axis=1), distance_upper_bound=float(longest.max()) + spacing)[0]
        large = large[distance < longest[large]]
        if len(large) == 0 or len(faces) + 3 * len(large) > MAX_FACES:
            break
        a, b, c = faces[large].T
        edges = np.sort(np.concatenate([np.c_[a, b], np.c_[b, c], np.c_[c, a]]), axis=1)
        edges, index = np.unique(edges, axis=0, return_inverse=True)
        ab, bc, ca = len(vertices) + index.reshape(3, -1)
        vertices = np.concatenate([vertices, vertices[edges].mean(axis=1)])
        quarters = [np.c_[a, ab, ca], np.c_[ab, b, bc], np.c_[ca, bc, c], np.c_[ab, bc, ca]]
        faces = np.concatenate([np.delete(faces, large, axis=0), *quarters])
    return vertices, np.asarray(faces, np.int64)


def paint_weights(vertices: Array, normals: Array, passes: Sequence[GroundPass], reach: float) -> tuple[NDArray[np.int64], Array]:
    """Waypoints (nv, 4) and weights (nv, 4) of every vertex; the weights sum to 0.5 at `reach` m from a pass.

    A waypoint counts only where the surface looks its way (within 60 deg): on a thin edge the other side is
    nearer than the next pass.
    """
    count = len(vertices)
    nearest = np.full((count, 2), np.inf)
    waypoint, weight = np.zeros((count, 4), np.int64), np.zeros((count, 4))
    first = 0
    for item in passes:
        neighbours = min(2, len(item.s))
        distance, index = cKDTree(item.p).query(vertices, k=[1, neighbours], distance_upper_bound=1.5 * reach)
        index = np.minimum(index, len(item.s) - 1)
        facing = np.einsum("ij,ij->i", item.n[index[:, 0]], normals) > 0.5
        near = np.where(facing, distance[:, 0], np.inf)
        share = 1 / (np.maximum(distance, 1e-9))
        share = share / np.maximum(share.sum(axis=1), 1e-30)[:, None]
        # The two nearest passes are kept sorted, pair (0, 1) before pair (2, 3).
        better = near < nearest[:, 0]
        second = ~better & (near < nearest[:, 1])
        nearest[better, 1], waypoint[better, 2:], weight[better, 2:] = (
            nearest[better, 0],
            waypoint[better, :2],
            weight[better, :2],
        )
        for rows, rank in ((better, 0), (second, 1)):
            pair = slice(2 * rank, 2 * rank + 2)
            nearest[rows, rank], waypoint[rows, pair], weight[rows, pair] = near[rows], first + index[rows], share[rows]
        first += len(item.s)
    blend = 1 / np.maximum(nearest, 1e-9) ** 2
    total = blend.sum(axis=1)
    blend = np.where(total[:, None] > 0, blend / np.maximum(total, 1e-30)[:, None], 0)
    cover = np.clip(1.5 - nearest[:, :1] / reach, 0, 1)
    return waypoint, weight * np.repeat(cover * blend, 2, axis=1)


def draw_blade(
    canvas: Canvas, blade: PaintedBlade, values: Array, span: tuple[float, float], colours: Colormap, toward: Array, unit: str
) -> None:
    """The blade from both sides, upright along its longest axis, coloured by the waypoints' `values` between the ends of `span`.

    `toward` (3,): direction from which the first picture is seen, as far as it is square to the longest axis.
    """
    cover = blade.weight.sum(axis=1)
    value = (blade.weight * np.nan_to_num(values)[blade.waypoint]).sum(axis=1) / np.maximum(cover, 1e-12)
    norm = Normalize(*span)
    axes = list(canvas.subplots(1, 2, left=0.05, right=0.75, top=0.1, bottom=0.1, across=0.2))
    upright = int(np.argmax(np.ptp(blade.vertices, axis=0)))
    level = np.where(np.arange(3) == upright, 0.0, toward)
    level = level / np.linalg.norm(level)
    ground = cover[blade.faces].mean(axis=1) >= 0.5
    painted = np.asarray(colours(norm(value[blade.faces].mean(axis=1))))[:, :3]
    painted = np.where(ground[:, None], painted, to_rgb(NOT_GROUND))
    painted[blade.left] = to_rgb(LEFT_OUT)
    for ax, sign in zip(axes, (1.0, -1.0), strict=True):
        _draw_side(ax, blade, painted, sign * level, np.eye(3)[upright])
    beside = axes[-1].get_position()
    bar = canvas.figure.add_axes(
        (beside.x1 + 0.2 / canvas.figure.get_figwidth(), beside.y0 + 0.1 * beside.height, 0.012, 0.8 * beside.height)
    )
    canvas.figure.colorbar(ScalarMappable(norm, colours), cax=bar)
    bar.tick_params(pad=3.5)
    bar.set_title(unit, fontsize=7, color=SOFT, loc="left")


def _draw_side(ax: Axes, blade: PaintedBlade, colours: Array, toward: Array, up: Array) -> None:
    """Faces that look toward the viewer in their `colours` (nf, 3), the far ones first, shaded a little by their slope."""
    right = np.cross(up, toward)
    corners = blade.vertices[blade.faces]
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    size = np.linalg.norm(normal, axis=1)
    normal = normal / np.maximum(size, 1e-30)[:, None]
    visible = np.flatnonzero((normal @ toward > 0) & (size > 0))
    visible = visible[np.argsort((corners[visible].mean(axis=1)) @ toward, kind="stable")]
    flat: Any = 1e3 * np.stack([corners[visible] @ right, corners[visible] @ up], axis=-1)
    shade = 0.78 + 0.22 * np.clip(normal[visible] @ (_LIGHT @ np.stack([right, up, toward])), 0, 1)
    faces = PolyCollection(
        flat, facecolors=colours[visible] * shade[:, None], edgecolors="face", linewidths=0.15, rasterized=True
    )
    ax.add_collection(faces)
    ax.set_xlim(flat[..., 0].min(), flat[..., 0].max())
    ax.set_ylim(flat[..., 1].min(), flat[..., 1].max())
    ax.set_aspect("equal")
    ax.set_axis_off()
