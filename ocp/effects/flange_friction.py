"""The flange sticks: its force depends on the direction of its stroke.

The contact feels N more while the flange is pressed in, N less while it extends. Seals and guides resist (DIAGNOSIS,
catalogue: sign of its stroke rate).
"""

from ocp.effects.effect import Effect, Parameter
from ocp.effects.forms import proportional, row

EFFECT = Effect(
    name="flange_friction",
    title="friction of the flange",
    subsystem="flange",
    push=lambda x, j, scanned: row(x.stroke_sign),
    **proportional(Parameter("N", "N", 0.3, 1.5, signed=False)),
)
