"""A joint's error that repeats once per turn of the axis."""

import casadi as ca

from ocp.effects.effect import Effect, Parameter
from ocp.effects.forms import at_joint, wave

EFFECT = Effect(
    name="gear_1x",
    title="error of joint {joint} once per turn",
    subsystem="joint",
    physics="dq = A cos(q + phase): an eccentric gear or encoder disc on the output side (DIAGNOSIS, catalogue). "
    "It is slow: over a part of a turn it looks like an encoder's scale or a joint's offset, and geometry takes much of it.",
    parameters=(Parameter("amplitude_rad", "rad", 2e-5, 6e-4, signed=False), Parameter("phase_rad", "rad", 0.0, 3.15)),
    coefficients=("cos", "sin"),
    prior_sd=(6e-4, 6e-4),
    joints=(1, 2, 3, 4, 5, 6),
    joint=lambda x, j, scanned: at_joint(j, ca.cos(1 * x.q[j - 1]), ca.sin(1 * x.q[j - 1])),
    **wave("amplitude_rad"),
)
