"""The flange does not know all of the weight it carries.

The flange carries kg that it does not compensate: the force grows by kg g times the downward share of its push. It does so
with the tilt of the flange's axis (DIAGNOSIS, catalogue).
"""

import casadi as ca

from ocp.effects.effect import Effect, Parameter
from ocp.effects.forms import proportional, row
from robots.gravity import GRAVITY

EFFECT = Effect(
    name="flange_gravity",
    title="weight carried by the flange",
    subsystem="flange",
    push=lambda x, j, scanned: row(GRAVITY * ca.dot(ca.SX(x.down), x.push_axis) / ca.dot(x.push_axis, x.n_base)),
    **proportional(Parameter("kg", "kg", 0.05, 1.0)),
)
