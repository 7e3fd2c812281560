"""A joint turns with another one: their drives, cables or their controller couple them.

dq_j = ratio_rad q_i, i = source_joint: a hose pack, a shaft or a belt couples two axes. Shared shafts, belts that run over a
neighbour's axis, a hose pack that pulls two axes and compensations with a wrong ratio leave it, rad per rad of any axis i but
j itself (FORMATS, additions). wrist_coupling is the case of the wrist's hollow shafts, larger and among joints 4 to 6; there
both say the same and are one class.
"""

from ocp.effects.effect import Effect, Parameter
from ocp.effects.forms import follows

EFFECT = Effect(
    name="joint_coupling",
    title="joint {joint} turns with another axis",
    subsystem="joint",
    **follows(Parameter("ratio_rad", "1", 1e-5, 4e-4), among=(1, 2, 3, 4, 5, 6)),
)
