"""The normal reading shows a share of the tangential force.

The normal reading is the force plus share_sign `share` of the tangential force. That is ft_N, mu F with the sign of the belt's
motion (DIAGNOSIS, catalogue). A stopped or reversed belt tells it from a gain.
"""

import casadi as ca
import numpy as np

from ocp.effects.effect import Effect, Parameter
from ocp.effects.forms import row

EFFECT = Effect(
    name="sensor_crosstalk",
    title="cross-talk of the force sensor",
    subsystem="sensor",
    parameters=(Parameter("share", "1", 0.01, 0.1, signed=False), Parameter("share_sign", "1", -1, 1)),
    coefficients=("share",),
    prior_sd=(0.1,),
    values=lambda a, scanned: {"share": abs(float(a[0])), "share_sign": 1 if a[0] >= 0 else -1},
    coefficients_of=lambda values: (np.array([values["share"] * values.get("share_sign", 1)]), {}),
    sensor=lambda x, j, scanned: row(x.friction * ca.sign(x.belt) * x.F),
)
