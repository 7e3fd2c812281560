"""Backlash of a gear: after a reversal the link stands at the other flank of the teeth.

dq = half_width_rad s: the link stands further along the last motion. That is play, s the sign of the axis' last motion
(DIAGNOSIS, catalogue). It depends on nothing else, which tells it from windup of friction, which grows with the load; on joint
1, which carries no load, the two are one.
"""

from ocp.effects.effect import Effect, Parameter
from ocp.effects.forms import at_joint, proportional

EFFECT = Effect(
    name="backlash",
    title="backlash of joint {joint}",
    subsystem="joint",
    joints=(1, 2, 3, 4, 5, 6),
    needs=("approach",),
    joint=lambda x, j, scanned: at_joint(j, x.approach[j - 1]),
    **proportional(Parameter("half_width_rad", "rad", 2e-5, 8e-4, signed=False)),
)
