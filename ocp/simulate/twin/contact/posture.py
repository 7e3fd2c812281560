"""How the wheel stands to the blade at a planned contact: five numbers, and the frame they make on the blade.

The axis of the wheel, seen from the contact frame (t, b = n x t, n) of the blade, with e the wheel's outward direction most
opposite to n and x = axis x e: the wheel's middle is at
p + along x - (R - depth) e - across axis  (docs/virtual_grinding.md, eq. 1).
"""

from dataclasses import dataclass

import numpy as np

from robots.pose import Array


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


def postures(
    T_base_blade: Array, p: Array, n: Array, t: Array, centre: Array, axis: Array, radius: Array
) -> Postures:  # fmt: skip
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
    shape = np.column_stack(
        [
            -np.sum(v * x, axis=1),
            across,
            np.arcsin(np.clip(lean, -1, 1)),
            np.arctan2(np.sum(np.cross(normal, feed) * x, axis=1), np.sum(feed * x, axis=1)),
        ]
    )
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
