"""A ripple of a joint with a whole number of waves per turn of the axis."""

from collections.abc import Sequence

import casadi as ca

from ocp.effects.context import ArmContext
from ocp.effects.effect import Effect, Parameter, Scanned, Surroundings
from ocp.effects.forms import at_joint, wave

ORDERS = range(3, 301)


def _orders(joint: int, seen: Surroundings) -> Sequence[Scanned]:
    return [{"order": k} for k in ORDERS]


def _ripple(x: ArmContext, j: int, scanned: Scanned) -> ca.SX:
    angle = scanned["order"] * x.q[j - 1]
    return at_joint(j, ca.cos(angle), ca.sin(angle))


EFFECT = Effect(
    name="gear_harmonic",
    title="gear ripple of joint {joint}",
    subsystem="joint",
    physics="Teeth, pins and rolling elements of a gear repeat a whole number of times per turn of its output: dq = A cos(k q + "
    "phase), order k waves per turn of the axis, tried from 3 to 300 (DIAGNOSIS, catalogue).",
    parameters=(
        Parameter("order", "1", 3, 300, signed=False),
        Parameter("amplitude_rad", "rad", 3e-5, 2e-4, signed=False),
        Parameter("phase_rad", "rad", 0.0, 3.15),
    ),
    coefficients=("cos", "sin"),
    prior_sd=(2e-4, 2e-4),
    joints=(1, 2, 3, 4, 5, 6),
    scan=_orders,
    symbolic=("order",),
    joint=_ripple,
    **wave("amplitude_rad", "order"),
)
