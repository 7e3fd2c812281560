"""The wheel's cover is stiffer or softer than the cell says.

The same indentation takes (1 + scale) times the force: rubber of another batch or age (DIAGNOSIS, catalogue). Indentation
follows a power of the force, d(F / (1 + s)) = d (1 + s)^-0.7, so the coefficient a = (1 - (1 + s)^-0.7) / 0.7 enters linearly.
Cover thickness does the same.
"""

import numpy as np

from ocp.effects.effect import Effect, Parameter
from ocp.effects.forms import row

LAW = 0.7  # exponent of indentation in force, between a bonded layer (1/2 to 2/3) and a plain spring (1)

EFFECT = Effect(
    name="wheel_stiffness",
    title="stiffness of the wheel's cover",
    subsystem="wheel",
    parameters=(Parameter("scale", "1", 0.0, 0.3),),
    coefficients=("give",),
    prior_sd=(0.3,),
    values=lambda a, scanned: {"scale": float(max(1.0 - LAW * a[0], 1e-3) ** (-1.0 / LAW) - 1.0)},
    coefficients_of=lambda values: (np.array([(1.0 - (1.0 + values["scale"]) ** -LAW) / LAW]), {}),
    overlap=lambda x, j, scanned: row(x.F * x.slopes[1]),
)
