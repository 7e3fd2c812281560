"""Friction winds up the gear and the link; after a reversal they stand wound the other way.

dq = (base_rad + per_Nm |tau|) s: friction keeps the gear wound. An axis that stops is held back by friction, which grows with
the load tau of the bearings and teeth (DIAGNOSIS, catalogue). s is the sign of the last motion; positive values leave the link
further along the last motion, as backlash does.
"""

import casadi as ca

from ocp.effects.effect import Effect, Parameter
from ocp.effects.forms import at_joint, proportional

EFFECT = Effect(
    name="friction_windup",
    title="friction windup of joint {joint}",
    subsystem="joint",
    joints=(1, 2, 3, 4, 5, 6),
    needs=("approach",),
    joint=lambda x, j, scanned: at_joint(j, x.approach[j - 1], ca.fabs(x.tau[j - 1]) * x.approach[j - 1]),
    **proportional(
        Parameter("base_rad", "rad", 2e-5, 2e-4, signed=False), Parameter("per_Nm", "rad/(N m)", 2e-8, 1e-7, signed=False)
    ),
)
