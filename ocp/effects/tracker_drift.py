"""The tracker's frame wanders during a campaign.

What the tracker reads moves by m_per_h (3) and turns by rad_per_h (3) about its head. The stand warms or settles: per hour
since the start, in the axes of the tracker's frame (DIAGNOSIS, catalogue). Fixed reflectors read again and again would show it
apart from the robot.
"""

import casadi as ca

from ocp.effects.effect import Effect, Parameter
from ocp.effects.forms import HOUR, proportional

EFFECT = Effect(
    name="tracker_drift",
    title="drift of the tracker",
    subsystem="tracker",
    needs=("time_s",),
    reading=lambda x, j, scanned: x.time / HOUR * ca.horzcat(ca.SX.eye(3), -ca.skew(x.point)),
    **proportional(Parameter("m_per_h", "m/h", 5e-6, 8e-5, length=3), Parameter("rad_per_h", "rad/h", 1e-6, 2e-5, length=3)),
)
