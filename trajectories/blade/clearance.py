"""Room for the wheel beside block, platform and shroud: where along a pass the wheel would run into them."""

import numpy as np
import trimesh
from numpy.typing import NDArray

from trajectories.blade.fit import SideSurface
from trajectories.blade.mesh import Blade
from trajectories.blade.shape import AerofoilShape

Array = NDArray[np.float64]

GAP = 0.5e-3  # m: room that must stay between the wheel and whatever is not aerofoil
_SAMPLING = 2e-3  # m: distance of the points that stand for block and platform
_STATIONS = 121  # places along a pass that are looked at


def obstacles(blade: Blade, shape: AerofoilShape) -> Array:
    """Points (m, 3), m, on everything that follows the aerofoil's ends: fillet, platform, block, shroud."""
    v = shape.frame.coordinate(blade.vertices)
    outside = np.zeros(len(blade.faces), bool)
    for end, beyond in ((0, v < shape.v[0]), (1, v > shape.v[1])):
        if shape.frame.block[end]:
            outside |= beyond[blade.faces].all(axis=1)
    if not outside.any():
        return np.zeros((0, 3))
    used, faces = np.unique(blade.faces[outside], return_inverse=True)
    points, _ = trimesh.remesh.subdivide_to_size(blade.vertices[used], faces.reshape(-1, 3), _SAMPLING, max_iter=12)
    return np.unique(np.round(points, 7), axis=0)


def free_stretch(side: SideSurface, points: Array, u: Array, v: Array, radius: float, width: float) -> tuple[Array, Array] | None:
    """The longest stretch of the polyline (u, v) on which the wheel keeps GAP from `points`, or None.

    The wheel stands on the surface without tilt or turn: its axis is b = n x t, its centre p + radius n.
    """
    if not len(points):
        return u, v
    at = np.linspace(0, len(u) - 1, _STATIONS)
    us, vs = (np.interp(at, np.arange(len(u)), x) for x in (u, v))
    p, n = side.surface(us, vs), side.normal(us, vs)
    t = np.gradient(p, axis=0)
    b = np.cross(n, t)
    b /= np.linalg.norm(b, axis=1, keepdims=True)
    centre = p + radius * n
    free = np.ones(len(p), bool)
    for k in range(len(p)):
        r = points - centre[k]
        lateral = r @ b[k]
        near = np.abs(lateral) < 0.5 * width + GAP
        rho2 = np.einsum("ni,ni->n", r[near], r[near]) - lateral[near] ** 2
        free[k] = not (rho2 < (radius + GAP) ** 2).any()
    edges = np.flatnonzero(np.diff(np.concatenate([[0], free.astype(int), [0]])))
    if not len(edges):
        return None
    k = int(np.argmax(edges[1::2] - edges[::2]))
    first, last = edges[::2][k], edges[1::2][k] - 1
    if last <= first:
        return None
    if first == 0 and last == len(p) - 1:
        return u, v
    keep = np.linspace(at[first], at[last], len(u))
    return np.interp(keep, np.arange(len(u)), u), np.interp(keep, np.arange(len(u)), v)
