"""An encoder scale that is bent.

A scale that is bent reads off by a part that grows with the square of the angle: dq = k q^2.
"""

from ocp.effects.effect import Effect, Parameter
from ocp.effects.forms import at_joint, proportional

EFFECT = Effect(
    name="bent_scale",
    title="bent scale of joint {joint}",
    subsystem="joint",
    joints=(1, 2, 3, 4, 5, 6),
    joint=lambda x, j, scanned: at_joint(j, x.q[j - 1] ** 2),
    **proportional(Parameter("k", "1/rad", 2e-5, 2e-4)),
)
