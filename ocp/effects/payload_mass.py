"""What hangs on the flange is heavier than the cell says.

The payload has kg more than in the cell. An added mass at its centre of mass loads every joint, tau(dm) (DIAGNOSIS,
catalogue); the joints bend by their compliance. payload: the one it is true of, or 'loaded': every payload with a mass. With
one payload it looks like compliance; payloads that are swapped tell them apart.
"""

from collections.abc import Sequence

from ocp.effects.context import LOADED
from ocp.effects.effect import Effect, Parameter, Scanned, Surroundings
from ocp.effects.forms import proportional


def each_payload(joint: int, seen: Surroundings) -> Sequence[Scanned]:
    """All payloads that weigh something together, then every payload by its name."""
    return [{"payload": name} for name in (LOADED, *seen.payloads)]


EFFECT = Effect(
    name="payload_mass",
    title="mass of the payload",
    subsystem="payload",
    scan=each_payload,
    torque=lambda x, j, scanned: x.is_payload(scanned["payload"]) * x.weight_torque(1.0, x.payload[1:4]),
    **proportional(Parameter("kg", "kg", 0.5, 25.0), Parameter("payload", "name", 0.0, 0.0), scanned=("payload",)),
)
