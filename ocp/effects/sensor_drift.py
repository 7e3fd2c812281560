"""The force sensor's zero wanders.

The reading grows by N_per_h, in the air too. Strain gauges warm, on the campaign's clock (DIAGNOSIS, catalogue). Air runs tell
it from wear.
"""

from ocp.effects.effect import Effect, Parameter
from ocp.effects.forms import HOUR, proportional, row

EFFECT = Effect(
    name="sensor_drift",
    title="drift of the force sensor",
    subsystem="sensor",
    needs=("clock_s",),
    sensor=lambda x, j, scanned: row(x.clock / HOUR),
    **proportional(Parameter("N_per_h", "N/h", 0.1, 3.0)),
)
