"""Passes that leave the smooth flanks (round an edge, over a fillet): what the facets nearby tell, roughly."""

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from trajectories.blade.mesh import Blade, vertex_normals
from trajectories.blade.shape import AerofoilShape
from trajectories.blade.surroundings import MAX_TURN
from trajectories.passes import BladePath

Array = NDArray[np.float64]

_NEIGHBOURS = 40  # mesh vertices of a local quadric
_BEAM = 1e-3  # m: half width of the column in which the depth below a point is looked for
_LARGEST_EXTENT = 0.05  # m: extents are not followed farther than this


def describe_off_flank(
    blade: Blade, shape: AerofoilShape, p: Array, n: Array, t: Array, s: Array, line: int, feed: Array, force: Array
) -> BladePath:  # fmt: skip
    """A pass with side "edge" from frames p, n, t (m, 3) on the mesh: curvature, extent and thickness are rough."""
    b = np.cross(n, t)
    curvature = facet_curvature(blade, p, n, t, b)
    thick = np.array([_depth(blade, p[k], n[k]) for k in range(len(p))])
    return BladePath(line, "edge", p, n, t, s, curvature, _extent(blade, shape, p, t, b, curvature), thick, feed, force)


def facet_curvature(blade: Blade, p: Array, n: Array, t: Array, b: Array) -> Array:
    """k_tt, k_bb, k_tb (m, 3) 1/m of quadrics fitted to the slopes of the vertex normals round each point.

    Slopes dz/dx = -n_x / n_z carry the second derivatives more evenly than heights, which a coarse mesh cuts short.
    """
    tree, normals = cKDTree(blade.vertices), vertex_normals(blade)
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


def _depth(blade: Blade, p: Array, n: Array) -> float:
    """Depth of the blade below p along -n, m: the deepest vertex in a narrow column, widened until it holds one."""
    r = blade.vertices - p
    depth = -(r @ n)
    aside = np.linalg.norm(r + depth[:, None] * n, axis=1)
    reach = _BEAM
    while not (found := (aside < reach) & (depth > 1e-5)).any() and reach < 0.1:
        reach *= 1.5
    return float(depth[found].max(initial=1e-4))


def _extent(blade: Blade, shape: AerofoilShape, p: Array, t: Array, b: Array, curvature: Array) -> Array:
    """Distances (m, 4): a turn of 60 deg at the local curvature, or the end of the blade along the span."""
    axis = shape.frame.axis
    height = blade.vertices @ axis
    here = (p @ axis)[:, None]
    rise = np.stack([t @ axis, -(t @ axis), b @ axis, -(b @ axis)], axis=1)
    to_end = np.where(rise > 0.0, height.max() - here, here - height.min()) / np.maximum(np.abs(rise), 1e-3)
    turn = MAX_TURN / np.maximum(curvature[:, [0, 0, 1, 1]], MAX_TURN / _LARGEST_EXTENT)
    return np.asarray(np.minimum(turn, np.maximum(to_end, 0.0)))
