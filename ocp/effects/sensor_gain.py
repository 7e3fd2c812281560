"""The force sensor's gain is off."""

from ocp.effects.effect import Effect, Parameter
from ocp.effects.forms import one, row

EFFECT = Effect(
    name="sensor_gain",
    title="gain of the force sensor",
    subsystem="sensor",
    physics="The normal reading is (1 + scale) times the force (DIAGNOSIS, catalogue). At constant friction cross-talk does "
    "the same; with a force-setting flange, which keeps the true force, several setpoints show it.",
    parameters=(Parameter("scale", "1", 0.005, 0.06),),
    coefficients=("scale",),
    prior_sd=(0.06,),
    sensor=lambda x, j, scanned: row(x.F),
    **one("scale"),
)
