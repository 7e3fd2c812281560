"""A gear that grows stiffer with its load, as teeth and rollers come to bear."""

from collections.abc import Sequence

import numpy as np

from ocp.effects.effect import Effect, Parameter, Scanned, Surroundings
from ocp.effects.forms import at_joint

# Of a KR 210 (PHYSICS 2.1, 2.5): N m, N m/rad; they only set the prior's scale where a robot has no values of its own.
TORQUE = np.array([7290.0, 8100.0, 5291.0, 2182.0, 1282.0, 825.0])
STIFFNESS = np.array([2.0e6, 3.3e6, 2.46e6, 0.5e6, 0.35e6, 0.30e6])
LARGEST_SHARE = 0.3  # of c tau at rated torque
UNIT = 1e-15  # rad/(N m)^3 of a coefficient whose variant says nothing


def _unit(joint: int, seen: Surroundings) -> Sequence[Scanned]:
    """Not a scan: the size of a coefficient of one, 30 % of c tau at rated torque of this joint."""
    torque = TORQUE if seen.torque_max is None else seen.torque_max
    stiffness = STIFFNESS if seen.stiffness is None or seen.stiffness[joint - 1] <= 0 else seen.stiffness
    return ({"unit": float(LARGEST_SHARE / stiffness[joint - 1] / torque[joint - 1] ** 2)},)


EFFECT = Effect(
    name="joint_stiffening",
    title="joint {joint} stiffens under load",
    subsystem="joint",
    physics="The windup of a gear grows more slowly than its load: dq = c tau - c3 tau^3, the hysteresis curve's backbone as "
    "makers of precision gears print it. rad_per_Nm3 is c3, positive where the joint stiffens; typical sizes are 5 to 30 % of "
    "c tau at rated torque (DIAGNOSIS, catalogue).",
    parameters=(Parameter("rad_per_Nm3", "rad/(N m)^3", 2e-16, 1.5e-12, signed=False),),
    coefficients=("share",),
    prior_sd=(1.0,),
    values=lambda a, scanned: {"rad_per_Nm3": float(a[0] * scanned["unit"])},
    coefficients_of=lambda values: (np.array([values["rad_per_Nm3"] / UNIT]), {"unit": UNIT}),
    joints=(1, 2, 3, 4, 5, 6),
    scan=_unit,
    symbolic=("unit",),
    joint=lambda x, j, scanned: at_joint(j, -scanned["unit"] * x.tau[j - 1] ** 3),
)
