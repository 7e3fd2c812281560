"""The wheel was moved.

From at_s on the wheel's centre is shifted by m (3) in base axes. The time is on the campaign's clock. What was so from the
start is registration (DIAGNOSIS, catalogue). Along the wheel's axis and along the belt nothing shows.
"""

from ocp.effects.effect import Effect
from ocp.effects.forms import moved_at_once

EFFECT = Effect(name="wheel_frame_shift", title="the wheel was moved", subsystem="wheel", **moved_at_once(lambda x: x.e.T))
