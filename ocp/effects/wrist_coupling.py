"""A wrist axis turns with another one, as their shafts run through each other.

dq_j = ratio q_i among joints 4 to 6, i = source_joint: hollow shafts run through each other. The drives of axes 5 and 6 run
through the hollow axes before them, and the controller takes the coupling out by fixed ratios; a wrong ratio leaves this
(DIAGNOSIS, catalogue).
"""

from ocp.effects.effect import Effect, Parameter
from ocp.effects.forms import follows

EFFECT = Effect(
    name="wrist_coupling",
    title="joint {joint} turns with another wrist axis",
    subsystem="joint",
    **follows(Parameter("ratio", "1", 1e-4, 3e-3), among=(4, 5, 6)),
)
