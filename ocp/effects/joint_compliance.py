"""A joint gives under its load where the believed cell has it rigid, or gives more.

dq = rad_per_Nm tau on top of the believed spring; the contact's own torque bends it too. A gear and its bearings bend in
proportion to the load torque tau, positive along +q (PHYSICS 2.5, eq. 16). rad_per_Nm comes on top of what the believed cell
already has for this joint under weight and external loads; the contact's torque takes overlap away (PHYSICS 3.1). The usual
range is that of a KR 210 and grows for robots with smaller gears as their rated torque falls. Joints 1 and 6 carry hardly any
weight; only a push, a pull or the contact shows their springs.
"""

from ocp.effects.effect import Effect, Parameter, Surroundings
from ocp.effects.forms import RATED_TORQUE, at_joint, in_units, rated_torque, row

LARGEST = 5e-6  # rad/(N m) in a robot of that size


def _unit(joint: int, seen: Surroundings) -> float:
    """Gears wind up by about the same angle at their rated torque, so a smaller robot's joint gives more per newton metre."""
    return float(LARGEST * RATED_TORQUE[joint - 1] / rated_torque(joint, seen))


EFFECT = Effect(
    name="joint_compliance",
    title="compliance of joint {joint} other than the cell's",
    subsystem="joint",
    joints=(1, 2, 3, 4, 5, 6),
    joint=lambda x, j, scanned: at_joint(j, scanned["unit"] * x.tau[j - 1]),
    overlap=lambda x, j, scanned: row(-scanned["unit"] * x.joint_lever[j - 1] * x.joint_push[j - 1]),
    **in_units(Parameter("rad_per_Nm", "rad/(N m)", 3e-7, 5e-6, signed=False), LARGEST, _unit),
)
