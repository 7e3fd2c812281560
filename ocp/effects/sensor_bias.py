"""The force sensor's zero is off."""

from ocp.effects.effect import Effect, Parameter
from ocp.effects.forms import one, row

EFFECT = Effect(
    name="sensor_bias",
    title="bias of the force sensor",
    subsystem="sensor",
    physics="The reading is the force plus N newton, in the air as in contact (DIAGNOSIS, catalogue); air runs show it alone.",
    parameters=(Parameter("N", "N", 0.1, 2.0),),
    coefficients=("N",),
    prior_sd=(2.0,),
    sensor=lambda x, j, scanned: row(1.0),
    **one("N"),
)
