"""The force sensor's zero wanders."""

from ocp.effects.effect import Effect, Parameter
from ocp.effects.forms import HOUR, one, row

EFFECT = Effect(
    name="sensor_drift",
    title="drift of the force sensor",
    subsystem="sensor",
    physics="Strain gauges warm: the reading grows by N_per_h per hour of the campaign's clock, in the air as in contact "
    "(DIAGNOSIS, catalogue). Air runs tell it from wear.",
    parameters=(Parameter("N_per_h", "N/h", 0.1, 3.0),),
    coefficients=("N_per_h",),
    prior_sd=(3.0,),
    needs=("clock_s",),
    sensor=lambda x, j, scanned: row(x.clock / HOUR),
    **one("N_per_h"),
)
