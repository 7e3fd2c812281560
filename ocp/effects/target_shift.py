"""A reflector nest moves during a campaign.

From at_s on readings of `target` are shifted by shift_m (3) in the frame of its link. A glued nest is knocked or creeps
(DIAGNOSIS, catalogue); at_s is on the campaign's clock. A shift from the start is the nest's unknown position.
"""

from collections.abc import Sequence

from ocp.effects.effect import Effect, Parameter, Scanned, Surroundings
from ocp.effects.forms import AT_S, after, instants, proportional


def _scan(joint: int, seen: Surroundings) -> Sequence[Scanned]:
    """Between the nest's own readings: where others are read meanwhile nothing tells one instant from the next."""
    return [{"target": name, "at_s": float(t)} for name in seen.targets for t in instants(seen.read_at.get(name, seen.time))]


EFFECT = Effect(
    name="target_shift",
    title="a reflector nest moved",
    subsystem="target",
    needs=("target", "time_s"),
    scan=_scan,
    symbolic=("at_s",),
    reading=lambda x, j, scanned: x.is_target(scanned["target"]) * after(x.time, scanned["at_s"]) * x.R,
    **proportional(
        Parameter("shift_m", "m", 5e-5, 4e-4, length=3), Parameter("target", "name", 0.0, 0.0), AT_S, scanned=("target", "at_s")
    ),
)
