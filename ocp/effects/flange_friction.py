"""The flange sticks: its force depends on the direction of its stroke."""

from ocp.effects.effect import Effect, Parameter
from ocp.effects.forms import one, row

EFFECT = Effect(
    name="flange_friction",
    title="friction of the flange",
    subsystem="flange",
    physics="Seals and guides resist: while the flange is pressed in the contact feels N newton more, while it extends N less "
    "(DIAGNOSIS, catalogue: sign of its stroke rate).",
    parameters=(Parameter("N", "N", 0.3, 1.5, signed=False),),
    coefficients=("N",),
    prior_sd=(1.5,),
    push=lambda x, j, scanned: row(x.stroke_sign),
    **one("N"),
)
