"""A joint's error that repeats twice per turn of the axis.

dq = amplitude_rad cos(2 q + phase_rad): an oval gear or output-side encoder (DIAGNOSIS, catalogue). It is slow: over a part of
a turn it looks like an encoder's scale or a joint's offset, and geometry takes much of it.
"""

from ocp.effects.effect import Effect, Parameter
from ocp.effects.forms import at_joint, cosines, wave

EFFECT = Effect(
    name="gear_2x",
    title="error of joint {joint} twice per turn",
    subsystem="joint",
    joints=(1, 2, 3, 4, 5, 6),
    joint=lambda x, j, scanned: at_joint(j, *cosines(2 * x.q[j - 1])),
    **wave(Parameter("amplitude_rad", "rad", 2e-5, 6e-4, signed=False)),
)
