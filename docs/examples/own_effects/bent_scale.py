"""An encoder scale that is bent: its reading is off by a part that grows with the square of the angle."""

from ocp.effects.effect import Effect, Parameter
from ocp.effects.forms import at_joint, one

EFFECT = Effect(
    name="bent_scale",
    title="bent scale of joint {joint}",
    subsystem="joint",
    physics="A scale that is bent reads off by a part that grows with the square of the angle: dq = k q^2.",
    parameters=(Parameter("k", "1/rad", 2e-5, 2e-4),),
    coefficients=("k",),
    prior_sd=(2e-4,),
    joints=(1, 2, 3, 4, 5, 6),
    joint=lambda x, j, scanned: at_joint(j, x.q[j - 1] ** 2),
    **one("k"),
)
