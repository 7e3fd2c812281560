"""The normal reading shows a share of the tangential force.

The normal reading is the force plus `share` of the tangential force, that is ft_N, mu F with the sign of the belt's motion
(DIAGNOSIS, catalogue). A stopped or reversed belt tells it from a gain.
"""

import casadi as ca

from ocp.effects.effect import Effect, Parameter
from ocp.effects.forms import proportional, row

EFFECT = Effect(
    name="sensor_crosstalk",
    title="cross-talk of the force sensor",
    subsystem="sensor",
    sensor=lambda x, j, scanned: row(x.friction * ca.sign(x.belt) * x.F),
    **proportional(Parameter("share", "1", 0.01, 0.1)),
)
