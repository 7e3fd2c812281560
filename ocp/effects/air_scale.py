"""The tracker's ranges grow with the air's temperature.

The tracker reads (1 + per_K (T - T0)) times the distance. T is the readings' temperature, T0 the cell's reference. A warmer
hall thins the air, whose refractive index falls by 0.93e-6 per kelvin (Ciddor 1996, Applied Optics 35, 1566), and an
interferometer's own weather station may stand elsewhere; either sign, as it leaves the compensation out or makes it twice. It
differs from link_thermal, ten times as large per kelvin, by what it scales: the way from the tracker, not the arm.
"""

from ocp.effects.effect import Effect, Parameter
from ocp.effects.forms import proportional

EFFECT = Effect(
    name="air_scale",
    title="scale of the tracker with the air's temperature",
    subsystem="tracker",
    needs=("temperature_C",),
    reading=lambda x, j, scanned: x.warm * x.point,
    **proportional(Parameter("per_K", "1/K", 1e-7, 2e-6)),
)
