"""One recorded channel of a log comes later than another.

dq = -s dq/dt of one joint, or of all alike (joint 0). What is measured (link-side encoder, force) belongs to commanded axes s
seconds earlier: two recorders, two clocks. Positive: the measured channel is behind the recorded axes. At one speed it hides
behind anything that goes with the sign of the speed.
"""

from ocp.effects.effect import Effect, Parameter
from ocp.effects.forms import at_joint, proportional

EFFECT = Effect(
    name="channel_delay",
    title="recorded channel of joint {joint} behind the others",
    subsystem="timing",
    joints=(0, 1, 2, 3, 4, 5, 6),
    needs=("speed",),
    joint=lambda x, j, scanned: -x.speed if j == 0 else at_joint(j, -x.speed[j - 1]),
    **proportional(Parameter("s", "s", 1e-3, 5e-2)),
)
