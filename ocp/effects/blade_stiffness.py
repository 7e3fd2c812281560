"""The blade is stiffer or softer than its elements say.

The blade gives 1 / (1 + scale) of what its finite elements say (DIAGNOSIS, catalogue). Modulus or thickness differ from the
drawing; the coefficient scale / (1 + scale) enters linearly.
"""

from ocp.effects.effect import Effect, Parameter
from ocp.effects.forms import row, share

EFFECT = Effect(
    name="blade_stiffness",
    title="stiffness of the blade",
    subsystem="blade",
    overlap=lambda x, j, scanned: row(x.parts[2] - x.clamp_deflection),
    **share(Parameter("scale", "1", 0.0, 0.4)),
)
