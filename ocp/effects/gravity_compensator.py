"""The spring that balances the upper arm, which the believed cell leaves out.

A spring k from lever a of link 1 to lever b of the upper arm: torque = -k (1 - L0 / L) a b sin(phi), phi the angle from
rest_rad, L the length, L0 = free_length |b - a|. A KR 210 carries a hydropneumatic balancer on axis 2 that the paper and the
believed cell ignore (PHYSICS 2.5): stiffness_N_m is k, lever_link1_m a and lever_arm_m b count from axis 2, at phi = 0 the
spring is shortest; it pulls toward the upright arm. free_length 1: just unloaded there, less: preloaded, 0: the sine of a
gear_1x. The torque acts through the joint's own compliance, so a robot without springs in joint 2 does not show it. Readings
fix k a b and the shape; stiffness_N_m follows from the levers of the variant.
"""

import casadi as ca
import numpy as np

from ocp.effects.context import ArmContext
from ocp.effects.effect import Effect, Parameter, Scanned
from ocp.effects.forms import at_joint, proportional, tried

_KEYS = ("lever_link1_m", "lever_arm_m", "free_length", "rest_rad")
LEVER_ARM = 0.4  # m; only the product of the levers and their ratio show
RATIOS = (0.35, 0.6, 0.85)  # lever on link 1 over lever on the arm
FREE = (0.0, 0.4, 1.0)  # share of the least length that is slack: none, preloaded, just unloaded where it is shortest
REST = (-0.4, 0.0, 0.4)  # rad of joint 2 from the upright arm, where the spring is shortest


def _torque(x: ArmContext, j: int, scanned: Scanned) -> ca.SX:
    a, b = scanned["lever_link1_m"], scanned["lever_arm_m"]
    angle = x.q_real[1] + np.pi / 2 - scanned["rest_rad"]
    length = ca.sqrt(a**2 + b**2 - 2 * a * b * ca.cos(angle))
    slack = scanned["free_length"] * ca.fabs(b - a)
    return at_joint(2, -(1 - slack / length) * a * b * ca.sin(angle))


EFFECT = Effect(
    name="gravity_compensator",
    title="gravity compensator of joint 2",
    subsystem="joint",
    joints=(2,),
    scan=tried(lever_link1_m=[round(r * LEVER_ARM, 4) for r in RATIOS], lever_arm_m=[LEVER_ARM], free_length=FREE, rest_rad=REST),
    symbolic=_KEYS,
    torque=_torque,
    **proportional(
        Parameter("stiffness_N_m", "N/m", 2e4, 3e5, signed=False),
        Parameter("lever_link1_m", "m", 0.1, 0.6, signed=False),
        Parameter("lever_arm_m", "m", 0.1, 0.6, signed=False),
        Parameter("free_length", "1", 0.0, 1.0),
        Parameter("rest_rad", "rad", 0.0, 0.4),
        scanned=_KEYS,
    ),
)
