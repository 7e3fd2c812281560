"""The force-setting flange is stiffer or softer than the cell says.

The flange's force rises with its stroke by (1 + scale) times the cell's stiffness. The stroke at a force is 1 / (1 + scale) of
the model's (DIAGNOSIS, catalogue); the coefficient scale / (1 + scale) enters linearly.
"""

from ocp.effects.effect import Effect, Parameter
from ocp.effects.forms import row, share

EFFECT = Effect(
    name="flange_stiffness",
    title="stiffness of the flange",
    subsystem="flange",
    overlap=lambda x, j, scanned: row(x.parts[0]),
    **share(Parameter("scale", "1", 0.0, 0.4)),
)
