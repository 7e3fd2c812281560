"""The belt and the wheel's cover wear: the radius falls.

The radius falls by m_per_s on the campaign's clock, or in contact where a log gives none. Grinding between logged runs is
included (DIAGNOSIS, catalogue).
"""

from ocp.effects.effect import Effect, Parameter
from ocp.effects.forms import proportional, row

EFFECT = Effect(
    name="wheel_wear",
    title="wear of the wheel",
    subsystem="wheel",
    overlap=lambda x, j, scanned: row(-x.clock),
    **proportional(Parameter("m_per_s", "m/s", 2e-8, 1e-6, signed=False)),
)
