"""The blade is gripped anew and sits elsewhere.

From at_s on the blade's frame is shifted by m (3) in the flange frame. The time is on the campaign's clock. What was so from
the start is registration (DIAGNOSIS, catalogue).
"""

from ocp.effects.effect import Effect
from ocp.effects.forms import moved_at_once

EFFECT = Effect(
    name="tool_frame_shift",
    title="the blade sits elsewhere in its grip",
    subsystem="tool",
    **moved_at_once(lambda x: -(x.e.T @ x.R_flange)),
)
