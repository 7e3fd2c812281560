"""The force sensor's gain is off.

The normal reading is (1 + scale) times the force (DIAGNOSIS, catalogue). At constant friction cross-talk does the same; with a
force-setting flange, which keeps the true force, several setpoints show it.
"""

from ocp.effects.effect import Effect, Parameter
from ocp.effects.forms import proportional, row

EFFECT = Effect(
    name="sensor_gain",
    title="gain of the force sensor",
    subsystem="sensor",
    sensor=lambda x, j, scanned: row(x.F),
    **proportional(Parameter("scale", "1", 0.005, 0.06)),
)
