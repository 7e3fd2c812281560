"""A wrist axis turns with another one, as their shafts run through each other.

The drives of axes 5 and 6 run through the hollow axes before them, and the controller takes the coupling out by fixed ratios; a
wrong ratio leaves dq_j = k q_i among joints 4 to 6 (DIAGNOSIS, catalogue). source_joint is i.
"""

from collections.abc import Sequence

from ocp.effects.effect import Effect, Parameter, Scanned, Surroundings
from ocp.effects.forms import at_joint, proportional

WRIST = (4, 5, 6)


def _sources(joint: int, seen: Surroundings) -> Sequence[Scanned]:
    return [{"source_joint": i} for i in WRIST if i != joint]


EFFECT = Effect(
    name="wrist_coupling",
    title="joint {joint} turns with another wrist axis",
    subsystem="joint",
    physics=__doc__,
    joints=WRIST,
    scan=_sources,
    joint=lambda x, j, scanned: at_joint(j, x.q[int(scanned["source_joint"]) - 1]),
    **proportional(
        Parameter("ratio", "1", 1e-4, 3e-3), Parameter("source_joint", "1", 4, 6, signed=False), scanned=("source_joint",)
    ),
)
