"""What hangs on the flange flexes: tool, gripper or blade holder give across the flange's axis.

All beyond the flange moves by m_per_N times the force square to its z axis. A holder is a short beam on the flange: it gives
under a force across its axis and hardly along it (Euler-Bernoulli, any textbook on strength of materials; FORMATS, additions).
The force is the payload's weight, so that reflectors sag with posture and payload, and the contact's with its friction, which
takes overlap away. At constant payload a joint's compliance and a shifted nest take most of it.
"""

import casadi as ca

from ocp.effects.context import ArmContext, ContactContext
from ocp.effects.effect import Effect, Parameter, Scanned
from ocp.effects.forms import proportional, row
from robots.gravity import GRAVITY


def _across(force: ca.SX, axis: ca.SX) -> ca.SX:
    return force - ca.dot(force, axis) * axis


def _sag(x: ArmContext, j: int, scanned: Scanned) -> dict[int, ca.SX]:
    moved = _across(x.payload[0] * GRAVITY * ca.SX(x.down), x.frames[6][:3, 2])
    return {6: ca.vertcat(moved, ca.SX.zeros(3))}


def _pressed(x: ContactContext, j: int, scanned: Scanned) -> ca.SX:
    force = x.F * (x.e + x.friction * ca.sign(x.belt) * x.belt_direction)
    return row(-ca.dot(x.e, _across(force, x.R_flange[:, 2])))


EFFECT = Effect(
    name="tool_flex",
    title="flexing of the tool",
    subsystem="tool",
    twist=_sag,
    overlap=_pressed,
    **proportional(Parameter("m_per_N", "m/N", 1e-8, 1e-6, signed=False)),
)
