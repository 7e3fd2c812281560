"""Weights, frames and compliance of an arm by other ways than the product's, to check it against."""

import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike

from robots.compliance import compliance_from_stiffness
from robots.kinematics import jacobian, link_frames
from robots.pose import Array
from robots.reference_kinematics import elementary_frames
from robots.rigid_body import rigid_body_model
from robots.robot import Robot


def elementary_weight_torques(
    robot: Robot, q: ArrayLike, gravity: float, payload_mass: float = 0.0, payload_com: ArrayLike = (0.0, 0.0, 0.0)
) -> Array:
    """Torques of weight about the axes (n, 6) N m, positive along +q, at postures q (n, 6) rad.

    Sum over all bodies beyond a joint of axis . (lever x weight), the weight being (0, 0, -m g); `gravity` m/s^2, payload kg and
    m in the flange frame.
    """
    frames = elementary_frames(robot, q)
    bodies = [(i, robot.link_mass[i], robot.link_com[i]) for i in range(1, 7)]
    bodies.append((6, payload_mass, np.asarray(payload_com, float)))
    axis, torques = frames[:, :6, :3, 2], np.zeros((len(frames), 6))
    for i, mass, com in bodies:
        point = (frames[:, i, :3, :3] @ com) + frames[:, i, :3, 3]
        lever = point[:, None] - frames[:, :i, :3, 3]
        turning = axis[:, :i, 1] * lever[:, :, 0] - axis[:, :i, 0] * lever[:, :, 1]
        torques[:, :i] += mass * gravity * robot.sign[:i] * turning
    return torques


def point_compliance(robot: Robot, q: ArrayLike, points: ArrayLike) -> Array:
    """Compliance (n, 3, 3) m/N in base axes of flange-fixed points (n, 3) m, base frame, at joints q (n, 6) rad."""
    q = np.asarray(q, float).reshape(-1, 6)
    J = jacobian(robot, q)
    lever = np.asarray(points, float) - link_frames(robot, q)[:, 6, :3, 3]
    # v_point = v_flange + omega x lever, column by column
    linear = J[:, :3] + np.cross(J[:, 3:], lever[:, :, None], axis=1)
    return np.asarray((linear * compliance_from_stiffness(robot.stiffness)) @ np.swapaxes(linear, -1, -2))


def generalised_gravity(robot: Robot, q: ArrayLike, payload_mass: float = 0.0, payload_com: ArrayLike = (0.0, 0.0, 0.0)) -> Array:
    """Torques (n, 6) N m that hold the arm at rest at q (n, 6) rad; minus `robots.gravity.weight_torques`."""
    model = rigid_body_model(robot, payload_mass, payload_com)
    data = model.createData()
    rows = np.asarray(q, float).reshape(-1, 6)
    return np.array([pin.computeGeneralizedGravity(model, data, row).copy() for row in rows]).reshape(-1, 6)


def body_frames(robot: Robot, q: ArrayLike) -> Array:
    """Link frames 1..6 by Pinocchio, (n, 6, 4, 4), of postures q (n, 6) rad."""
    model = rigid_body_model(robot)
    data = model.createData()
    ids = [model.getFrameId(f"link{i}") for i in range(1, 7)]
    rows = np.asarray(q, float).reshape(-1, 6)
    frames = np.empty((len(rows), 6, 4, 4))
    for k, row in enumerate(rows):
        pin.framesForwardKinematics(model, data, row)
        for i, frame in enumerate(ids):
            frames[k, i] = data.oMf[frame].homogeneous
    return frames
