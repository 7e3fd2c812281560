"""The same arm in plain NumPy, as a product of elementary motions: the reference that does not know CasADi.

Used by the verification of finished programs, and by the tests of `robots.kinematics`. Nothing here may
import the symbolic model.
"""

import numpy as np
from numpy.typing import ArrayLike

from robots.pose import Array, make_transform, rot_x, rot_y, rot_z
from robots.robot import Robot


def elementary_frames(robot: Robot, q: ArrayLike) -> Array:
    """Link frames 0..6 in the base frame, (n, 7, 4, 4), of postures q (n, 6) rad, any MD-H table (PHYSICS 2.2)."""
    q = np.asarray(q, float).reshape(-1, 6)
    frames = np.empty((len(q), 7, 4, 4))
    frames[:, 0] = np.eye(4)
    for i, (offset, d, a, alpha, beta) in enumerate(robot.mdh):
        turned = frames[:, i] @ _rotation(rot_z(robot.sign[i] * q[:, i] + offset))
        lifted = turned @ _translation(0.0, 0.0, d)
        moved = lifted @ _translation(a, 0.0, 0.0)
        twisted = moved @ _rotation(rot_x(alpha))
        frames[:, i + 1] = twisted @ _rotation(rot_y(beta))
    return frames


def elementary_forward(robot: Robot, q: ArrayLike) -> Array:
    """Flange poses T_base_flange (n, 4, 4) of postures q (n, 6) rad."""
    return elementary_frames(robot, q)[:, 6]


def elementary_weight_torques(
    robot: Robot,
    q: ArrayLike,
    gravity: float,
    payload_mass: float = 0.0,
    payload_com: ArrayLike = (0.0, 0.0, 0.0),
) -> Array:
    """Torques of weight about the axes (n, 6) N m, positive along +q, at postures q (n, 6) rad.

    Sum over all bodies beyond a joint of axis . (lever x weight); `gravity` m/s^2, payload kg and m in the
    flange frame.
    """
    frames = elementary_frames(robot, q)
    bodies = [(i, robot.link_mass[i], robot.link_com[i]) for i in range(1, 7)]
    bodies.append((6, payload_mass, np.asarray(payload_com, float)))
    torques = np.zeros((len(frames), 6))
    for i, mass, com in bodies:
        point = (frames[:, i, :3, :3] @ com) + frames[:, i, :3, 3]
        weight = np.array([0.0, 0.0, -mass * gravity])
        for j in range(i):
            moment = np.cross(point - frames[:, j, :3, 3], weight)
            torques[:, j] += robot.sign[j] * np.sum(frames[:, j, :3, 2] * moment, axis=-1)
    return torques


def _rotation(R: Array) -> Array:
    return make_transform(R, np.zeros(3))


def _translation(x: float, y: float, z: float) -> Array:
    return make_transform(np.eye(3), np.array([x, y, z]))
