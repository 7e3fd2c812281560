"""Does the blade touch the wheel anywhere else than the contact model thinks?"""

from dataclasses import dataclass

import numpy as np

from ocp.model.blade_gap import REACH
from ocp.model.cell import Cell
from ocp.plan.rules import SECONDARY_CONTACT_TOLERANCE
from robots.pose import Array, apply


@dataclass(frozen=True)
class SecondaryContact:
    """Deepest unplanned overlap on a path: depth (m), waypoint index, distance (m) of that point from the contact."""

    depth: float
    index: int
    distance: float


def find_secondary_contact(
    cell: Cell, points: Array, T_base_blade: Array, contact: Array, curvature: Array, tilt: Array, delta: Array
) -> SecondaryContact:
    """Deepest overlap beyond the local quadratic of each contact.

    points (m, 3) of the blade's surface, blade frame: what lies within the reach of the direct contact is left to it;
    T_base_blade (n, 4, 4); contact (n, 3) planned points in the blade frame; curvature (n, 3) kxx, kyy, kxy relative;
    tilt (n, 2); delta (n,) m. Frames: docs/architecture.md.
    """
    wheel = cell.wheel
    worst = SecondaryContact(0.0, 0, 0.0)
    for k, T in enumerate(T_base_blade):
        v = apply(T, np.vstack([points, contact[k]])) - wheel.centre
        lateral = v @ wheel.axis
        radial = v - lateral[:, None] * wheel.axis
        depth = wheel.radius - np.linalg.norm(radial, axis=1)
        seen = np.linalg.norm(points - contact[k], axis=1) < 0.9 * REACH
        near = (np.abs(lateral[:-1]) <= 0.5 * wheel.width) & (depth[:-1] > SECONDARY_CONTACT_TOLERANCE) & ~seen
        if not near.any():
            continue
        e = radial[-1] / np.linalg.norm(radial[-1])
        x = (radial[:-1][near]) @ np.cross(wheel.axis, e)
        y = lateral[:-1][near] - lateral[-1]
        gap = tilt[k, 0] * x + tilt[k, 1] * y
        gap += 0.5 * (curvature[k, 0] * x**2 + 2 * curvature[k, 2] * x * y + curvature[k, 1] * y**2)
        beyond = depth[:-1][near] - np.maximum(delta[k] - gap, 0.0)
        i = int(np.argmax(beyond))
        if beyond[i] > worst.depth:
            worst = SecondaryContact(float(beyond[i]), k, float(np.hypot(x[i], y[i])))
    return worst
