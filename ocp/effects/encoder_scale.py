"""An axis turns a little more than its encoder says, in proportion to its angle."""

from ocp.effects.effect import Effect, Parameter
from ocp.effects.forms import at_joint, one

EFFECT = Effect(
    name="encoder_scale",
    title="encoder scale of joint {joint}",
    subsystem="joint",
    physics="A wrong gear ratio in the controller or a stretched encoder scale: dq = e q, the link stands at (1 + scale) q "
    "(DIAGNOSIS, catalogue). Over a part of a turn gear_1x and a gravity compensator look alike.",
    parameters=(Parameter("scale", "1", 1e-5, 4e-4),),
    coefficients=("scale",),
    prior_sd=(4e-4,),
    joints=(1, 2, 3, 4, 5, 6),
    joint=lambda x, j, scanned: at_joint(j, x.q[j - 1]),
    **one("scale"),
)
