"""A joint's zero moves with the temperature."""

from ocp.effects.effect import Effect, Parameter
from ocp.effects.forms import at_joint, one

EFFECT = Effect(
    name="joint_thermal",
    title="thermal drift of joint {joint}",
    subsystem="joint",
    physics="A gearbox housing or a column that warms on one side turns what it carries: dq = g (T - T0), rad_per_K = g "
    "(DIAGNOSIS, catalogue).",
    parameters=(Parameter("rad_per_K", "rad/K", 1e-6, 2e-5),),
    coefficients=("rad_per_K",),
    prior_sd=(2e-5,),
    joints=(1, 2, 3, 4, 5, 6),
    needs=("temperature_C",),
    joint=lambda x, j, scanned: at_joint(j, x.warm),
    **one("rad_per_K"),
)
