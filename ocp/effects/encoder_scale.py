"""An axis turns a little more than its encoder says, in proportion to its angle.

dq = scale q: a wrong gear ratio in the controller or a stretched encoder scale. The link stands at (1 + scale) q (DIAGNOSIS,
catalogue). Over a part of a turn gear_1x and a gravity compensator look alike.
"""

from ocp.effects.effect import Effect, Parameter
from ocp.effects.forms import at_joint, proportional

EFFECT = Effect(
    name="encoder_scale",
    title="encoder scale of joint {joint}",
    subsystem="joint",
    joints=(1, 2, 3, 4, 5, 6),
    joint=lambda x, j, scanned: at_joint(j, x.q[j - 1]),
    **proportional(Parameter("scale", "1", 1e-5, 4e-4)),
)
