"""A warm arm is longer.

All lengths of the arm are (1 + per_K (T - T0)) as long. Steel and cast iron have 1.1e-5, aluminium 2.3e-5 per kelvin, T0 is
the cell's reference. What is clamped to the flange does not grow with it. At constant temperature it cannot be told from the
tracker's scale or from longer links.
"""

import casadi as ca

from ocp.effects.context import ArmContext
from ocp.effects.effect import Effect, Parameter, Scanned
from ocp.effects.forms import proportional


def _growth(x: ArmContext, j: int, scanned: Scanned) -> dict[int, ca.SX]:
    """Each link's tip moves away from its root."""
    tips = [frame[:3, 3] for frame in x.frames]
    return {i: ca.vertcat(x.warm * (tips[i] - tips[i - 1]), ca.SX.zeros(3)) for i in range(1, 7)}


EFFECT = Effect(
    name="link_thermal",
    title="thermal growth of the arm",
    subsystem="link",
    needs=("temperature_C",),
    twist=_growth,
    **proportional(Parameter("per_K", "1/K", 4e-6, 2.5e-5, signed=False)),
)
