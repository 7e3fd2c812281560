"""The clamp gives: the blade tilts about its root.

The contact moves by m_per_N F (h / 60 mm)^2 away from the wheel, h its height over the clamp. A clamp that tilts under a force
at height h does so: the moment goes with h, so does the displacement (DIAGNOSIS, catalogue).
"""

from ocp.effects.effect import Effect, Parameter
from ocp.effects.forms import proportional, row

LEVER = 0.06  # m over the clamp where m_per_N holds

EFFECT = Effect(
    name="clamp_compliance",
    title="compliance of the clamp",
    subsystem="blade",
    overlap=lambda x, j, scanned: row(-x.F * (x.lever / LEVER) ** 2),
    **proportional(Parameter("m_per_N", "m/N", 1e-7, 2e-6, signed=False)),
)
