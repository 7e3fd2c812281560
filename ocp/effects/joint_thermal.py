"""A joint's zero moves with the temperature.

dq = rad_per_K (T - T0): a housing or column that warms on one side. It turns what it carries (DIAGNOSIS, catalogue).
"""

from ocp.effects.effect import Effect, Parameter
from ocp.effects.forms import at_joint, proportional

EFFECT = Effect(
    name="joint_thermal",
    title="thermal drift of joint {joint}",
    subsystem="joint",
    joints=(1, 2, 3, 4, 5, 6),
    needs=("temperature_C",),
    joint=lambda x, j, scanned: at_joint(j, x.warm),
    **proportional(Parameter("rad_per_K", "rad/K", 1e-6, 2e-5)),
)
