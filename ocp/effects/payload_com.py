"""The centre of what hangs on the flange is elsewhere than the cell says.

The payload's real centre is shift_m (3) from the cell's, flange frame. Its weight acts there: its moment changes by m g x dr,
tau(dr) (DIAGNOSIS, catalogue). payload: the one it is true of, or 'loaded': every payload with a mass, each by the same shift.
"""

import casadi as ca

from ocp.effects.context import ArmContext
from ocp.effects.effect import Effect, Parameter, Scanned
from ocp.effects.forms import proportional
from ocp.effects.payload_mass import each_payload


def _torque(x: ArmContext, j: int, scanned: Scanned) -> ca.SX:
    here, mass = x.is_payload(scanned["payload"]), x.payload[0]
    still = x.weight_torque(mass, ca.SX.zeros(3))
    return here * ca.horzcat(*(x.weight_torque(mass, ca.SX.eye(3)[:, k]) - still for k in range(3)))


EFFECT = Effect(
    name="payload_com",
    title="centre of mass of the payload",
    subsystem="payload",
    scan=each_payload,
    torque=_torque,
    **proportional(
        Parameter("shift_m", "m", 0.005, 0.12, length=3), Parameter("payload", "name", 0.0, 0.0), scanned=("payload",)
    ),
)
