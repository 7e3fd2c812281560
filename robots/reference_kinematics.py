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


def _rotation(R: Array) -> Array:
    return make_transform(R, np.zeros(3))


def _translation(x: float, y: float, z: float) -> Array:
    return make_transform(np.eye(3), np.array([x, y, z]))
