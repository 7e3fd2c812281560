"""Grinding takes material off: the same program meets less blade every time.

The overlap falls by m_per_pass ground_before (40 mm/s) / feed. Every grinding before takes off a layer, thinner the faster the
feed (Preston: removal goes with pressure, belt speed and dwell time; DIAGNOSIS, catalogue).
"""

from ocp.effects.effect import Effect, Parameter
from ocp.effects.forms import proportional, row

FEED = 0.04  # m/s at which m_per_pass holds

EFFECT = Effect(
    name="material_removal",
    title="removal of material",
    subsystem="blade",
    needs=("ground_before",),
    overlap=lambda x, j, scanned: row(-x.ground_before * FEED / x.feed),
    **proportional(Parameter("m_per_pass", "m", 5e-6, 1e-4, signed=False)),
)
