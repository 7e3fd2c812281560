"""Torques that the weight of the arm and its payload exerts about the joint axes (PHYSICS 2.5).

Sign: positive along +q, so that a joint of compliance c bends by dq = c tau. Equal to minus the generalised
gravity of rigid-body dynamics, which is the torque a motor must hold.
"""

from functools import lru_cache
from typing import Any

import casadi as ca
import numpy as np
from numpy.typing import ArrayLike

from robots.kinematics import chain, evaluate_rows, link_frames
from robots.pose import Array
from robots.robot import Robot

# m/s^2. The rounded value reproduces the own-weight torques of PHYSICS 2.5 to their last digit. The standard
# value 9.80665 is 0.03 % less: 0.4 um at the tool for 1.2 mm of sag.
GRAVITY = 9.81
LINKS = (2, 3, 4, 5, 6)  # whose weight may differ from the catalogue's: the base and link 1 turn about the vertical only
AXES = "xyz"


def gravity_torques(
    q: Any, mdh: Any, sign: Any, link_mass: Any, link_com: Any, payload_mass: Any, payload_com: Any, down: Any
) -> Any:
    """Torque of weight (6) N m about each axis at posture q, as a CasADi expression.

    q (6) rad, mdh (6, 5), sign (6); link_mass (7) kg and link_com (7, 3) m of the base and links 1..6 in the
    link frames; payload mass kg and centre (3) m in the flange frame; down (3) unit direction of gravity in the base
    frame. q may be a deflected posture.
    """
    frames = chain(q, mdh, sign)
    mass, moment = payload_mass, payload_mass * _point(frames[6], payload_com)
    torques: list[Any] = []
    for j in range(5, -1, -1):
        mass = mass + link_mass[j + 1]
        com = ca.vertcat(link_com[j + 1, 0], link_com[j + 1, 1], link_com[j + 1, 2])
        moment = moment + link_mass[j + 1] * _point(frames[j + 1], com)
        z, lever = frames[j][:3, 2], moment - mass * frames[j][:3, 3]
        torques.append(sign[j] * GRAVITY * ca.dot(z, ca.cross(lever, ca.SX(down))))
    return ca.vertcat(*reversed(torques))


def _point(frame: Any, local: Any) -> Any:
    """A point (3) of a frame in base coordinates."""
    return frame[:3, :3] @ local + frame[:3, 3]


def weight_torques(robot: Robot, q: ArrayLike, payload_mass: ArrayLike = 0.0, payload_com: ArrayLike = (0.0, 0.0, 0.0)) -> Array:
    """Torques of weight (n, 6) N m, positive along +q, at postures q (n, 6) rad.

    Payload kg, its centre (3,) m in the flange frame: one, or one for each posture (n,), (n, 3).
    """
    constants = (robot.mdh, robot.sign, robot.link_mass, robot.link_com, robot.gravity_direction)
    function = _compiled(*(np.asarray(a, float).tobytes() for a in constants))
    rows = np.asarray(q, float).reshape(-1, 6)
    payload = np.empty((len(rows), 4))
    payload[:, 0], payload[:, 1:] = payload_mass, payload_com
    return evaluate_rows(function, rows, payload)


@lru_cache(maxsize=32)
def _compiled(mdh: bytes, sign: bytes, link_mass: bytes, link_com: bytes, down: bytes) -> ca.Function:
    """The function (q, [payload mass, com]) -> torques for one arm."""
    q, payload = ca.SX.sym("q", 6), ca.SX.sym("payload", 4)
    arm = np.frombuffer(mdh).reshape(6, 5), np.frombuffer(sign), np.frombuffer(link_mass), np.frombuffer(link_com).reshape(7, 3)
    torques = gravity_torques(q, *arm, payload[0], payload[1:], np.frombuffer(down))
    return ca.Function("weight_torques", [q, payload], [ca.densify(torques)])


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
