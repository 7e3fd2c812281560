"""The gap between the wheel and the blade's real surface, where a quadratic is not enough: near edges, over a wide wheel.

The surface comes as a fine cloud of points with normals. About a contact it is seen in the wheel's unrolled frame
(x = R times the angle, y along the axis, height over the wheel's surface) and its departure from the local quadratic
is interpolated linearly between neighbours; where there is no surface there is no blade.
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import Delaunay, cKDTree

from ocp.contact.wheel.signorini import LocalShape
from ocp.model.cell import Wheel
from robots.pose import Array, apply

REACH = 0.026  # m about the planned point; beyond, the wheel has left the blade or `ocp.plan.clearance` speaks
NEAR, THINNED = 0.011, 4  # m; farther out one point in four is enough, the gap there matters only if it closes
FACING = 0.2  # smallest cosine between a point's normal and the wheel for it to be touched from this side
# Longest side of a triangle between neighbours, near the contact and farther out. Longer ones close the outline of the cloud
# across a corner or along an edge of the blade: there is no surface in them.
LONGEST_NEAR, LONGEST_FAR = 2.5e-3, 6e-3  # m
END_ZONE = 4e-3  # m at both ends of a pass where contacts are solved more densely
DEGENERATE = 1000 * np.finfo(float).eps
SHARPEST = 1e-9  # m; points this close in (x, y) are one for the triangulation


@dataclass(frozen=True)
class SurfaceCloud:
    """Points (m, 3) m on the ground surface with outward normals (m, 3), blade frame."""

    points: Array
    normals: Array

    @cached_property
    def tree(self) -> cKDTree:
        """Search tree of the points."""
        return cKDTree(self.points)


@dataclass(frozen=True)
class Departure:
    """Heights over a triangulation of points in (x, y), linear in each triangle; inf outside and in triangles that are not
    `sound` (k,)."""

    triangles: Delaunay
    heights: Array
    sound: NDArray[np.bool_]

    def __call__(self, points: Array) -> Array:
        """Height at points (..., 2)."""
        flat = points.reshape(-1, 2)
        found = self.triangles.find_simplex(flat)
        inside = (found >= 0) & self.sound[found]
        k = found[inside]
        transform = self.triangles.transform[k]
        two = np.einsum("nij,nj->ni", transform[:, :2], flat[inside] - transform[:, 2])
        share = np.column_stack([two, 1.0 - two.sum(axis=1)])
        out = np.full(len(flat), np.inf)
        out[inside] = np.sum(share * self.heights[self.triangles.simplices[k]], axis=1)
        return out.reshape(points.shape[:-1])


def _departure(points: Array, heights: Array) -> Departure:
    triangles = Delaunay(points)
    triangles._transform = affine(points[triangles.simplices])
    first, second, third = points[triangles.simplices.T]
    sides = [np.sqrt(x * x + y * y) for x, y in ((first - third).T, (second - first).T, (third - second).T)]
    near = np.hypot(*points.T)[triangles.simplices].max(axis=1) < NEAR
    longest = np.where(near, LONGEST_NEAR, LONGEST_FAR)
    sound = (np.maximum.reduce(sides) < longest) & np.isfinite(triangles.transform[:, 0, 0])
    return Departure(triangles, heights, sound)


def affine(corners: Array) -> Array:
    """Transforms (k, 3, 2) of triangles with corners (k, 3, 2) to barycentric coordinates, nan where a triangle is degenerate: to
    the last bit those of `Delaunay.transform`, which come one by one and take as long as the triangulation."""
    away = corners[:, :2] - corners[:, 2:]
    (a, b), (c, d) = away[:, 0].T, away[:, 1].T
    determinant = a * d - b * c
    size = np.maximum(np.abs(a) + np.abs(b), np.abs(c) + np.abs(d)) * np.maximum(np.abs(d) + np.abs(b), np.abs(c) + np.abs(a))
    flat = ~(np.abs(determinant) >= DEGENERATE * size)  # reciprocal condition number in the 1-norm
    away[flat] = np.eye(2)
    found = np.empty(corners.shape)  # rows in order: SciPy reads it as it lies
    found[:, :2], found[:, 2] = np.linalg.inv(away).swapaxes(1, 2), corners[:, 2]
    found[flat, :2] = np.nan
    return found


@dataclass(frozen=True)
class SurfaceShape(LocalShape):
    """A local quadratic plus the real surface's departure from it; inf where there is no surface."""

    departure: Departure | None = None

    def gap(self, x: Array, y: Array) -> Array:
        """Height of the undeformed blade over the undeformed wheel at x, y (m)."""
        quadratic = LocalShape.gap(self, x, y)
        if self.departure is None:
            return quadratic
        x, y = np.broadcast_arrays(x, y)
        return np.asarray(quadratic + self.departure(np.stack([x, y], axis=-1)))


def surface_shape(wheel: Wheel, cloud: SurfaceCloud, base: LocalShape, T_base_blade: Array, contact: Array) -> SurfaceShape:
    """`base` with the departure of the blade's surface from it about `contact` (3,) in the blade frame.

    T_base_blade (4, 4) is the pose at which `base` was taken; docs/architecture.md has the frame.
    """
    index = np.sort(np.asarray(cloud.tree.query_ball_point(contact, REACH), dtype=int))
    far = np.linalg.norm(cloud.points[index] - contact, axis=1) > NEAR
    index = index[~far | (index % THINNED == 0)]
    n = cloud.normals[index] @ T_base_blade[:3, :3].T
    lateral, radial, rho = wheel.cylindrical(apply(T_base_blade, np.vstack([contact, cloud.points[index]])))
    e = radial[0] / rho[0]
    angle = np.arctan2(radial @ np.cross(wheel.axis, e), radial @ e)
    x, y = wheel.radius * angle, lateral - lateral[0]
    height = rho - rho[0]
    facing = np.sum(n * radial[1:], axis=1) / rho[1:] < -FACING
    keep = np.concatenate([[True], facing & (np.hypot(x[1:], y[1:]) > SHARPEST)])
    x, y, height = x[keep], y[keep], height[keep]
    departure = _departure(np.column_stack([x, y]), height - base.gap(x, y))
    return SurfaceShape(
        base.kxx, base.kyy, base.kxy, base.lateral, base.tilt_x, base.tilt_y, None, base.heading, departure=departure
    )


def contact_stations(s: Array, spacing: float) -> Array:
    """Indices of those waypoints, at arc lengths s (n,) m, where the contact is to be solved directly.

    About `spacing` m apart, a third of it near the ends, where the blade's edges come under the wheel.
    """
    length = s[-1] - s[0]
    near = np.arange(0.0, END_ZONE, spacing / 3)
    wanted = np.concatenate([near, np.arange(END_ZONE, length - END_ZONE, spacing), length - near])
    return np.unique(np.abs(s[:, None] - s[0] - np.clip(wanted, 0.0, length)).argmin(axis=0))
