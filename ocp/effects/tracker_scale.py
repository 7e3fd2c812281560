"""The tracker's ranges are a share too long.

The tracker reads (1 + scale) times the distance. A wrong refractive index (air temperature, pressure) scales every range,
about 1e-6 per kelvin of air. Free link lengths take all of it; only lengths that are known, a scale bar, show it.
"""

from ocp.effects.effect import Effect, Parameter
from ocp.effects.forms import proportional

EFFECT = Effect(
    name="tracker_scale",
    title="scale of the tracker",
    subsystem="tracker",
    reading=lambda x, j, scanned: x.point,
    **proportional(Parameter("scale", "1", 1e-6, 1e-5)),
)
