"""A block that plays the blade before the wheel, and the postures that hold it there."""

import itertools

import numpy as np

from ocp.plan.clearance import flange_pose
from robots.inverse import inverse_branches

BLOCK = np.array(list(itertools.product((-0.02, 0.02), (-0.003, 0.003), (0.0, 0.1))))  # blade frame, m


def joints_of(cell, T_base_blade):
    """Postures (k, 6) inside the limits that put the blade at a pose."""
    q, _ = inverse_branches(cell.robot, flange_pose(cell, T_base_blade)[None])
    q = q[0][np.isfinite(q[0]).all(axis=1)]
    return q[((q >= cell.robot.q_min) & (q <= cell.robot.q_max)).all(axis=1)]


def blade_before_wheel(cell, gap, lateral=0.0):
    """The block upright before the wheel, its flat face toward it and `gap` off its surface."""
    T = np.eye(4)
    T[:3, :3] = np.stack([[0, 1, 0], [1, 0, 0], [0, 0, -1]], axis=1)  # blade x to base y, y to x, z down
    wheel = cell.wheel
    face = wheel.centre + wheel.contact_direction * (wheel.radius + gap)
    T[:3, 3] = face - T[:3, :3] @ np.array([0.0, 0.003, 0.05]) + np.array([0.0, lateral, 0.0])
    return T
