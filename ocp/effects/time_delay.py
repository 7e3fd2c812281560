"""The force is logged later than the motion.

The reading at t shows the force at t - s. Filters and buses delay what the sensor says, s positive where the logger is behind
the motion (DIAGNOSIS, catalogue). In force-only logs at one feed an axis error that goes with speed looks the same.
"""

from ocp.effects.effect import Effect, Parameter
from ocp.effects.forms import late, shifted_by_time

EFFECT = Effect(
    name="time_delay",
    title="delay of the force logger",
    subsystem="timing",
    needs=("time_s",),
    **late(Parameter("s", "s", 0.002, 0.06), about=(0.002, 0.015, 0.04), least=1e-3, shifted=shifted_by_time),
)
