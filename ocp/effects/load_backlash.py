"""Play of a gear that its load takes up: the link lies on the side to which gravity pulls it.

dq = half_width_rad tanh(tau / torque_Nm): the load chooses the side. Its torque tau is positive along +q (FORMATS, additions).
Where weight closes the gap the side follows the sign of the torque, not of the last motion (`backlash`): the link jumps by
twice half_width_rad where the torque passes zero, over the torque_Nm that friction of the unloaded gear withstands, tried from
0.3 to 10 % of the joint's rated torque. A load that never changes its sign hides it in the joint's zero; a small torque_Nm
beside steady motions is what backlash looks like on joints that are approached from below alone. Joint 1 of an upright robot
carries no weight and does not show it. At a contact its push joins the weight: the overlap loses what the link turns by then.
"""

from collections.abc import Sequence

import casadi as ca

from ocp.effects.context import ContactContext
from ocp.effects.effect import Effect, Parameter, Scanned, Surroundings
from ocp.effects.forms import at_joint, proportional, rated_torque, row

SHARES = (0.003, 0.01, 0.03, 0.1)  # of the rated torque: a factor of three changes tanh by less than a tenth of its square


def _torques(joint: int, seen: Surroundings) -> Sequence[Scanned]:
    return [{"torque_Nm": share * rated_torque(joint, seen)} for share in SHARES]


def _pushed(x: ContactContext, j: int, scanned: Scanned) -> ca.SX:
    alone, together = (ca.tanh(tau / scanned["torque_Nm"]) for tau in (x.tau[j - 1], x.tau[j - 1] + x.joint_push[j - 1]))
    return row(-x.joint_lever[j - 1] * (together - alone))


EFFECT = Effect(
    name="load_backlash",
    title="backlash of joint {joint} on the side of its load",
    subsystem="joint",
    joints=(1, 2, 3, 4, 5, 6),
    scan=_torques,
    symbolic=("torque_Nm",),
    joint=lambda x, j, scanned: at_joint(j, ca.tanh(x.tau[j - 1] / scanned["torque_Nm"])),
    overlap=_pushed,
    **proportional(
        Parameter("half_width_rad", "rad", 2e-5, 8e-4, signed=False),
        Parameter("torque_Nm", "N m", 3.0, 300.0, signed=False),
        scanned=("torque_Nm",),
    ),
)
