"""A joint gives under its load where the believed cell has it rigid, or gives more."""

from collections.abc import Sequence

import numpy as np

from ocp.effects.effect import Effect, Parameter, Scanned, Surroundings
from ocp.effects.forms import at_joint

TORQUE = np.array([7290.0, 8100.0, 5291.0, 2182.0, 1282.0, 825.0])  # N m at the link side, KR 210 (PHYSICS 2.1)
LARGEST = 5e-6  # rad/(N m) in a robot of that size


def _unit(joint: int, seen: Surroundings) -> Sequence[Scanned]:
    """Not a scan: the size of a coefficient of one. Gears wind up by about the same angle at their rated torque, so a smaller
    robot's joint gives more per newton metre."""
    torque = TORQUE if seen.torque_max is None else seen.torque_max
    return ({"unit": float(LARGEST * TORQUE[joint - 1] / torque[joint - 1])},)


EFFECT = Effect(
    name="joint_compliance",
    title="compliance of joint {joint} that the cell leaves out",
    subsystem="joint",
    physics="A gear and its bearings bend in proportion to the load torque: dq = c tau, tau positive along +q (PHYSICS 2.5, eq. "
    "16). rad_per_Nm comes on top of what the believed cell already has for this joint under weight and external loads; the "
    "usual range is that of a KR 210 and grows for robots with smaller gears as their rated torque falls. "
    "Joints 1 and 6 carry hardly any weight; only a push or pull shows their springs.",
    parameters=(Parameter("rad_per_Nm", "rad/(N m)", 3e-7, 5e-6, signed=False),),
    coefficients=("share",),
    prior_sd=(1.0,),
    values=lambda a, scanned: {"rad_per_Nm": float(a[0] * scanned["unit"])},
    coefficients_of=lambda values: (np.array([values["rad_per_Nm"] / LARGEST]), {"unit": LARGEST}),
    joints=(1, 2, 3, 4, 5, 6),
    scan=_unit,
    symbolic=("unit",),
    joint=lambda x, j, scanned: at_joint(j, scanned["unit"] * x.tau[j - 1]),
)
