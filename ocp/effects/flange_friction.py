"""The flange sticks: its force depends on the direction of its stroke.

Seals and guides resist: while the flange is pressed in the contact feels N newton more, while it extends N less (DIAGNOSIS,
catalogue: sign of its stroke rate).
"""

from ocp.effects.effect import Effect, Parameter
from ocp.effects.forms import proportional, row

EFFECT = Effect(
    name="flange_friction",
    title="friction of the flange",
    subsystem="flange",
    physics=__doc__,
    push=lambda x, j, scanned: row(x.stroke_sign),
    **proportional(Parameter("N", "N", 0.3, 1.5, signed=False)),
)
