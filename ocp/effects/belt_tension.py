"""A tight belt presses on edges and strongly curved places.

Extra normal force N k / (k + half_per_m), k the blade's convex curvature. It is that along and across the belt. A belt under
tension that is bent over a convex blade presses on it as a rope on a pulley, more the more it is curved; N is what a sharp
edge feels (DIAGNOSIS, catalogue: extra force at high curvature and edges).
"""

import casadi as ca

from ocp.effects.context import ContactContext
from ocp.effects.effect import Effect, Parameter, Scanned
from ocp.effects.forms import proportional, row, tried

HALF = (10.0, 50.0, 250.0)  # 1/m of blade curvature at which half of the force acts


def _extra(x: ContactContext, j: int, scanned: Scanned) -> ca.SX:
    blade = ca.fmax(x.curvature[0] - 1.0 / x.radius, 0.0) + ca.fmax(x.curvature[1], 0.0)
    return row(blade / (blade + scanned["half_per_m"]) * ca.if_else(x.F > 0, 1.0, 0.0))


EFFECT = Effect(
    name="belt_tension",
    title="tension of the belt",
    subsystem="wheel",
    scan=tried(half_per_m=HALF),
    symbolic=("half_per_m",),
    push=_extra,
    **proportional(
        Parameter("N", "N", 1.0, 10.0, signed=False),
        Parameter("half_per_m", "1/m", 10.0, 250.0, signed=False),
        scanned=("half_per_m",),
        usual={"half_per_m": HALF[1]},
    ),
)
