"""Springs in the joints: the posture that gravity leaves (PHYSICS 2.5)."""

from collections.abc import Callable
from typing import Any

import casadi as ca
import numpy as np
from numpy.typing import ArrayLike

from robots.gravity import weight_torques
from robots.pose import Array
from robots.robot import Robot

# Steps of q <- q_cmd + c tau(q). Each gains a factor |c dtau/dq|, below 3e-3 for a loaded KR 210: after two
# the rest is below 0.1 um at the tool.
STEPS = 2


def deflected_joints(q: Any, torque: Callable[[Any], Any], compliance: Any) -> Any:
    """Joints q_real (6) rad that satisfy q_real = q + c tau(q_real), by two fixed-point steps (PHYSICS 2.5, eq. 16).

    q (6) commanded joints, `torque` maps joints (6) to the torque the load exerts, positive along +q, N m;
    compliance (6) rad/(N m). CasADi expressions in and out.
    """
    real = q
    for _ in range(STEPS):
        real = q + compliance * torque(real)
    return real


def compliance_from_stiffness(stiffness: Any) -> Any:
    """Joint compliances (6) rad/(N m) of stiffnesses (6) N m/rad, where 0 means rigid: compliance 0.

    CasADi expression or array.
    """
    if isinstance(stiffness, ca.SX | ca.MX):
        k: Any = stiffness
        return ca.if_else(k > 0, 1 / k, 0)  # masks the derivative too
    k = np.asarray(stiffness, float)
    return np.divide(1.0, k, out=np.zeros_like(k), where=k > 0)


def deflect(
    robot: Robot,
    q: ArrayLike,
    compliance: ArrayLike,
    payload_mass: float = 0.0,
    payload_com: ArrayLike = (0.0, 0.0, 0.0),
    steps: int = STEPS,
) -> Array:
    """Real joints (n, 6) rad under gravity of commanded joints q (n, 6) rad; compliance (6,) rad/(N m).

    Payload kg and m in the flange frame. `steps` above two only shows what two leave.
    """
    q, c = np.asarray(q, float).reshape(-1, 6), np.asarray(compliance, float)
    real = q
    for _ in range(steps):
        real = q + c * weight_torques(robot, real, payload_mass, payload_com)
    return real
