"""A joint gives under its load where the believed cell has it rigid, or gives more."""

from ocp.effects._forms import at_joint, one
from ocp.effects.effect import Effect, Parameter

EFFECT = Effect(
    name="joint_compliance",
    title="compliance of joint {joint} that the cell leaves out",
    subsystem="joint",
    physics="A gear and its bearings bend in proportion to the load torque: dq = c tau, tau positive along +q (PHYSICS 2.5, eq. "
    "16). rad_per_Nm comes on top of what the believed cell already has for this joint under weight and external loads. "
    "Joints 1 and 6 carry hardly any weight; only a push or pull shows their springs.",
    parameters=(Parameter("rad_per_Nm", "rad/(N m)", 3e-7, 5e-6, signed=False),),
    coefficients=("rad_per_Nm",),
    prior_sd=(5e-6,),
    joints=(1, 2, 3, 4, 5, 6),
    joint=lambda x, j, scanned: at_joint(j, x.tau[j - 1]),
    **one("rad_per_Nm"),
)
