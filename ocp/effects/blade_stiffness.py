"""The blade is stiffer or softer than its elements say."""

from ocp.effects.effect import Effect, Parameter
from ocp.effects.forms import row, share

EFFECT = Effect(
    name="blade_stiffness",
    title="stiffness of the blade",
    subsystem="blade",
    physics="Modulus or thickness differ from the drawing: the blade gives 1 / (1 + scale) of what its finite elements say "
    "(DIAGNOSIS, catalogue); the coefficient scale / (1 + scale) enters linearly.",
    parameters=(Parameter("scale", "1", 0.0, 0.4),),
    coefficients=("share",),
    prior_sd=(0.4,),
    overlap=lambda x, j, scanned: row(x.parts[2] - x.clamp_deflection),
    **share("scale"),
)
