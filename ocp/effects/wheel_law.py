"""The wheel's force rises more steeply with its indentation than modelled.

The local exponent of F(delta) is (1 + exponent) times the model's, with the same indentation under 20 newton. Rubber that
stiffens (DIAGNOSIS, catalogue). To first order indentation falls by a (dd/dF) F ln(F / 20 N), a = exponent / (1 + exponent).
Only several force levels tell it from a stiffer cover.
"""

import casadi as ca

from ocp.effects.effect import Effect, Parameter
from ocp.effects.forms import row, share

ABOUT = 20.0  # N where model and wheel agree

EFFECT = Effect(
    name="wheel_law",
    title="force law of the wheel",
    subsystem="wheel",
    overlap=lambda x, j, scanned: row(x.F * x.slopes[1] * ca.log(ca.fmax(x.F, 0.1) / ABOUT)),
    **share(Parameter("exponent", "1", 0.05, 0.6)),
)
