"""A gear that grows stiffer with its load, as teeth and rollers come to bear.

dq = c tau - rad_per_Nm3 tau^3, c the linear spring's. The windup of a gear grows more slowly than its load, the hysteresis
curve's backbone as makers of precision gears print it. rad_per_Nm3 is positive where the joint stiffens; typical sizes are 5
to 30 % of c tau at rated torque (DIAGNOSIS, catalogue). At a contact its push joins the weight.
"""

import casadi as ca
import numpy as np

from ocp.effects.context import ContactContext
from ocp.effects.effect import Effect, Parameter, Scanned, Surroundings
from ocp.effects.forms import at_joint, in_units, rated_torque, row

# Of a KR 210 (PHYSICS 2.5), N m/rad: only sets the prior's scale where a robot has no values of its own.
STIFFNESS = np.array([2.0e6, 3.3e6, 2.46e6, 0.5e6, 0.35e6, 0.30e6])
LARGEST_SHARE = 0.3  # of c tau at rated torque
UNIT = 1e-15  # rad/(N m)^3 of a coefficient whose variant says nothing


def _unit(joint: int, seen: Surroundings) -> float:
    """30 % of c tau at rated torque of this joint."""
    stiffness = STIFFNESS if seen.stiffness is None or seen.stiffness[joint - 1] <= 0 else seen.stiffness
    return float(LARGEST_SHARE / stiffness[joint - 1] / rated_torque(joint, seen) ** 2)


def _pushed(x: ContactContext, j: int, scanned: Scanned) -> ca.SX:
    alone, push = x.tau[j - 1], x.joint_push[j - 1]
    return row(scanned["unit"] * x.joint_lever[j - 1] * ((alone + push) ** 3 - alone**3))


EFFECT = Effect(
    name="joint_stiffening",
    title="joint {joint} stiffens under load",
    subsystem="joint",
    joints=(1, 2, 3, 4, 5, 6),
    joint=lambda x, j, scanned: at_joint(j, -scanned["unit"] * x.tau[j - 1] ** 3),
    overlap=_pushed,
    **in_units(Parameter("rad_per_Nm3", "rad/(N m)^3", 2e-16, 1.5e-12, signed=False), UNIT, _unit),
)
