"""A ripple of a joint with a whole number of waves per turn of the axis.

dq = amplitude_rad cos(order q + phase_rad): teeth, pins and rolling elements. They repeat a whole number of times per turn of
the gear's output, tried from 3 to 300 (DIAGNOSIS, catalogue).
"""

from ocp.effects.effect import Effect, Parameter
from ocp.effects.forms import at_joint, cosines, tried, wave

EFFECT = Effect(
    name="gear_harmonic",
    title="gear ripple of joint {joint}",
    subsystem="joint",
    joints=(1, 2, 3, 4, 5, 6),
    scan=tried(order=range(3, 301)),
    symbolic=("order",),
    joint=lambda x, j, scanned: at_joint(j, *cosines(scanned["order"] * x.q[j - 1])),
    **wave(
        Parameter("order", "1", 3, 300, signed=False),
        Parameter("amplitude_rad", "rad", 3e-5, 2e-4, signed=False),
        scanned=("order",),
    ),
)
