"""Newton's method on the pose: exact inverse kinematics of any six-axis arm near a seed."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from robots.kinematics import forward, jacobian
from robots.pose import Array
from robots.robot import Robot

ITERATIONS = 30
TOLERANCE = 1e-10  # m and rad: well below print rounding, well above the rounding of 3 m in double precision
_LONGEST_STEP = 0.3  # rad


@dataclass(frozen=True)
class Refined:
    """Joints (n, 6) rad, whether each reached the pose (n,), and what is left: position (n,) m, rotation (n,) rad."""

    q: Array
    converged: Array
    position_error: Array
    rotation_error: Array

    def reason(self, i: int) -> str:
        """One sentence about row i."""
        if self.converged[i]:
            return "the pose is reached"
        return (
            f"the pose is missed by {self.position_error[i] * 1e3:.3f} mm and "
            f"{np.degrees(self.rotation_error[i]):.4f} deg after {ITERATIONS} Newton steps: out of reach, singular, or "
            "the seed is too far away"
        )


def inverse_refined(robot: Robot, T: ArrayLike, q_seed: ArrayLike, tolerance: float = TOLERANCE) -> Refined:
    """Joints that bring the flange to poses T (n, 4, 4), from seeds (n, 6) rad, by damped Newton steps.

    The damping falls with the error, so that convergence stays quadratic away from singularities. Limits are
    not looked at. Rows that do not arrive are told by `converged`, never by an exception.
    """
    T = np.asarray(T, float).reshape(-1, 4, 4)
    q = np.array(np.broadcast_to(np.asarray(q_seed, float), (len(T), 6)))
    error = pose_error(T, forward(robot, q))
    for _ in range(ITERATIONS):
        # Two digits beyond the tolerance: the last step is nearly free and rounding is far below.
        rows = np.flatnonzero(np.abs(error).max(axis=1) > tolerance / 100)
        if not len(rows):
            break
        q[rows] += _step(jacobian(robot, q[rows]), error[rows])
        error[rows] = pose_error(T[rows], forward(robot, q[rows]))
    position, rotation = np.linalg.norm(error[:, :3], axis=1), np.linalg.norm(error[:, 3:], axis=1)
    return Refined(q, np.maximum(position, rotation) <= tolerance, position, rotation)


def pose_error(T_goal: Array, T: Array) -> Array:
    """Translation and rotation vector (n, 6) m, rad, base axes, that carry poses T (n, 4, 4) to T_goal."""
    R = T_goal[:, :3, :3] @ np.swapaxes(T[:, :3, :3], 1, 2)
    v = 0.5 * np.stack([R[:, 2, 1] - R[:, 1, 2], R[:, 0, 2] - R[:, 2, 0], R[:, 1, 0] - R[:, 0, 1]], axis=1)
    sine = np.linalg.norm(v, axis=1)
    angle = np.arctan2(sine, 0.5 * (np.trace(R, axis1=1, axis2=2) - 1.0))
    scale = np.divide(angle, sine, out=np.ones_like(sine), where=sine > 1e-12)
    return np.concatenate([T_goal[:, :3, 3] - T[:, :3, 3], v * scale[:, None]], axis=1)


def _step(J: Array, error: Array) -> Array:
    """Levenberg steps (m, 6): J^T (J J^T + lambda I)^-1 error, no longer than the largest step."""
    Jt = np.swapaxes(J, 1, 2)
    damping = 1e-3 * np.sum(error**2, axis=1) + 1e-15
    step = Jt @ np.linalg.solve(J @ Jt + damping[:, None, None] * np.eye(6), error[:, :, None])
    length = np.abs(step).max(axis=(1, 2), keepdims=True)
    return np.asarray((step * np.minimum(1.0, _LONGEST_STEP / np.maximum(length, 1e-300)))[..., 0])
