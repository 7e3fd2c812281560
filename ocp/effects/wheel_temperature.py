"""A warm wheel is softer and larger.

The cover is (1 + per_K (T - T0)) times as stiff, its radius grows by radius_per_K (T - T0). T is the wheel's temperature, T0
is the cell's reference, per_K negative: warm rubber is softer; it recovers on pauses (DIAGNOSIS, catalogue).
"""

from ocp.effects.effect import Effect, Parameter
from ocp.effects.forms import proportional, row

EFFECT = Effect(
    name="wheel_temperature",
    title="temperature of the wheel",
    subsystem="wheel",
    needs=("wheel_temperature_C",),
    overlap=lambda x, j, scanned: row(x.wheel_warm * x.F * x.slopes[1], x.wheel_warm),
    **proportional(Parameter("per_K", "1/K", -0.01, -0.003), Parameter("radius_per_K", "m/K", 2e-6, 1e-5, signed=False)),
)
