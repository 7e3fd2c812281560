"""The force sensor's zero is off.

The reading is the force plus N, in the air too. Air runs show it alone (DIAGNOSIS, catalogue).
"""

from ocp.effects.effect import Effect, Parameter
from ocp.effects.forms import proportional, row

EFFECT = Effect(
    name="sensor_bias",
    title="bias of the force sensor",
    subsystem="sensor",
    sensor=lambda x, j, scanned: row(1.0),
    **proportional(Parameter("N", "N", 0.1, 2.0)),
)
