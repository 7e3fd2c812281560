"""The belt and the wheel's cover wear: the radius falls."""

from ocp.effects.effect import Effect, Parameter
from ocp.effects.forms import one, row

EFFECT = Effect(
    name="wheel_wear",
    title="wear of the wheel",
    subsystem="wheel",
    physics="The radius falls by m_per_s for every second of the campaign's clock, grinding between logged runs included; where "
    "a log gives no clock, for every second in contact (DIAGNOSIS, catalogue).",
    parameters=(Parameter("m_per_s", "m/s", 2e-8, 1e-6, signed=False),),
    coefficients=("m_per_s",),
    prior_sd=(1e-6,),
    overlap=lambda x, j, scanned: row(-x.clock),
    **one("m_per_s"),
)
