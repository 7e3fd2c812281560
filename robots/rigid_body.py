"""The arm as a Pinocchio model: motor torques for timing, independent check of kinematics and gravity."""

from typing import Any

import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike

from robots.gravity import GRAVITY
from robots.pose import Array, make_transform, rot_x, rot_y, rot_z
from robots.robot import Robot

KEPT_MODELS = 4


def rigid_body_model(robot: Robot, payload_mass: float = 0.0, payload_com: ArrayLike = (0.0, 0.0, 0.0)) -> pin.Model:
    """Pinocchio model with joint variables q in the controller's signs, payload as a point mass, gravity as the base is mounted.

    Joint i turns about sign_i z of link frame i - 1 and starts at the theta offset, so no conversion of q is
    needed. Frames "link1" .. "link6" are the MD-H link frames. payload kg, centre (3,) m in the flange frame.
    """
    model = pin.Model()
    model.gravity.linear = GRAVITY * robot.gravity_direction
    parent, before = 0, np.eye(4)
    for i, (offset, d, a, alpha, beta) in enumerate(robot.mdh):
        # A_i = Rz(offset) Rz(sign q) X_i; X_i belongs to the body that the joint carries.
        placement = before @ make_transform(rot_z(offset), np.zeros(3))
        joint = pin.JointModelRevoluteUnaligned(np.array([0.0, 0.0, robot.sign[i]]))
        parent = model.addJoint(parent, joint, pin.SE3(placement), f"A{i + 1}")
        R = rot_x(alpha) @ rot_y(beta)
        X = make_transform(R, np.array([a, 0.0, d]))
        mass, com, tensor = (x[i + 1] for x in (robot.link_mass, robot.link_com, robot.link_inertia))
        inertia = pin.Inertia(float(mass), com.copy(), tensor.copy())
        model.appendBodyToJoint(parent, inertia, pin.SE3(X))
        model.addFrame(pin.Frame(f"link{i + 1}", parent, 0, pin.SE3(X), pin.FrameType.OP_FRAME))
        before = X
    if payload_mass > 0:
        point = pin.Inertia(float(payload_mass), np.asarray(payload_com, float), np.zeros((3, 3)))
        model.appendBodyToJoint(parent, point, pin.SE3(before))
    return model


def inverse_dynamics(
    robot: Robot, payload_mass: float, payload_com: ArrayLike, q: ArrayLike, qd: ArrayLike, qdd: ArrayLike
) -> Array:
    """Motor torques (n, 6) N m on the link side, positive along +q, that a motion needs (Newton-Euler).

    q, qd, qdd (n, 6) in rad, rad/s, rad/s^2; payload kg, centre (3,) m in the flange frame. Without friction,
    rotor inertia and balancer, which the catalogue does not know.
    """
    rows = [np.asarray(x, float).reshape(-1, 6) for x in (q, qd, qdd)]
    model, data, pool = _known_model(robot, payload_mass, payload_com)
    if pool is None:  # Pinocchio without OpenMP
        return np.array([pin.rnea(model, data, *row) for row in zip(*rows, strict=True)]).reshape(-1, 6)
    # One thread: Pinocchio's loop over rows takes half the time of one here.
    return np.ascontiguousarray(pin.rneaInParallel(1, pool, *map(np.asfortranarray, (x.T for x in rows))).T).reshape(-1, 6)


Known = tuple[pin.Model, pin.Data, Any]
_known: dict[tuple[bytes, ...], Known] = {}


def _known_model(robot: Robot, payload_mass: float, payload_com: ArrayLike) -> Known:
    """`rigid_body_model` with room for its results; those asked for last are at hand, a plan asks a thousand times."""
    arm = robot.mdh, robot.sign, robot.gravity_direction, robot.link_mass, robot.link_com, robot.link_inertia
    key = tuple(np.asarray(part, float).tobytes() for part in (*arm, payload_mass, payload_com))
    if key not in _known:
        while len(_known) >= KEPT_MODELS:
            del _known[next(iter(_known))]
        model = rigid_body_model(robot, payload_mass, payload_com)
        _known[key] = model, model.createData(), pin.ModelPool(model, 1) if hasattr(pin, "rneaInParallel") else None
    return _known[key]
