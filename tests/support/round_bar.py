"""A round bar that plays the blade at the wheel: its surface points, its pose, a point of it inside the wheel."""

import numpy as np

from ocp.model.blade_gap import SurfaceCloud

RADIUS = 0.08  # m of the round bar that plays the blade
CONTACT = np.array([0.0, RADIUS, 0.0])


def bar(length: float = 0.021, step: float = 4e-4, radius: float = RADIUS, upto: float = np.inf) -> SurfaceCloud:
    """A round bar about the blade's x axis seen from +y; its points end at x = upto."""
    x = np.arange(-length, min(length, upto) + 1e-9, step)
    angle = np.arange(-length, length + 1e-9, step) / radius
    X, A = (g.ravel() for g in np.meshgrid(x, angle))
    normal = np.column_stack([0 * X, np.cos(A), np.sin(A)])
    return SurfaceCloud(np.column_stack([X, radius * normal[:, 1], radius * normal[:, 2]]), normal)


def on_wheel(cell, turn: float = 0.0, delta: float = 0.0) -> np.ndarray:
    """T_base_blade with CONTACT at the wheel's contact direction, the bar parallel to the wheel's axis, turned about it."""
    wheel = cell.wheel
    e, a = wheel.contact_direction, wheel.axis
    belt = np.cross(a, e)
    y = -e
    x = np.cos(turn) * a + np.sin(turn) * belt
    T = np.eye(4)
    T[:3, :3] = np.stack([x, y, np.cross(x, y)], axis=1)
    T[:3, 3] = wheel.centre + (wheel.radius - delta) * e - T[:3, :3] @ CONTACT
    return T


def buried(cell, T, depth, angle, lateral=0.0):
    """The point in the blade frame that lies `depth` m inside the wheel at an angle from the contact direction."""
    wheel = cell.wheel
    belt = np.cross(wheel.axis, wheel.contact_direction)
    e = np.cos(angle) * wheel.contact_direction + np.sin(angle) * belt
    p = wheel.centre + (wheel.radius - depth) * e + lateral * wheel.axis
    return (p - T[:3, 3]) @ T[:3, :3]
