"""Masses and centres of the links that are not as the catalogue says, as unknowns of a fit."""

import numpy as np

from robots.gravity import GRAVITY
from robots.kinematics import link_frames
from robots.pose import Array
from robots.robot import Robot

LINKS = (2, 3, 4, 5, 6)  # the base and link 1 turn about the vertical only
AXES = "xyz"


def weighed_links(robot: Robot) -> list[tuple[str, int, int]]:
    """What of the links' weights is not as the catalogue says: name, link, and -1 for its relative mass or the axis (0..2) of its
    frame along which its centre lies elsewhere."""
    heavy = [link for link in LINKS if robot.link_mass[link] > 0]
    return [(f"link{i}_{'mass' if k < 0 else AXES[k]}", i, k) for i in heavy for k in range(-1, 3)]


def link_torques(robot: Robot, q: Array) -> Array:
    """Load torque (n, 6, w) N m, positive along +q, per unit of relative mass and per metre of every centre (`weighed_links`), at
    postures q (n, 6) rad.

    A catalogue's masses and centres are those of a drawing. Springs are fitted to the sag under all weight together: where the
    links are heavier than believed, a payload that is known well bends the arm less than these springs say; it looks lighter, or
    a link looks as if it bent. A weight G m at p turns joint j by c_j of its torque z_j . ((p - o_j) x down) G m (PHYSICS 2.5).
    """
    frames = link_frames(robot, q)[:, :, :3]
    out = np.zeros((len(q), 6, len(weighed_links(robot))))
    for at, (_, link, axis) in enumerate(weighed_links(robot)):
        mass, frame = robot.link_mass[link], frames[:, link]
        whole = frame[:, :, :3] @ robot.link_com[link] + frame[:, :, 3] if axis < 0 else frame[:, :, axis]
        for j in range(link):
            lever = whole - frames[:, j, :, 3] if axis < 0 else whole
            turning = np.sum(frames[:, j, :, 2] * np.cross(lever, robot.gravity_direction), axis=1)
            out[:, j, at] = robot.sign[j] * GRAVITY * mass * turning
    return out
