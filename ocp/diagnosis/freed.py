"""Readings that were set aside as gross, and that an effect found earlier would take back.

Names are accepted one after the other. A step that comes late in a campaign moves few readings; as the noise falls with every
name accepted before it, they come to be taken for gross ones, and what nobody counts needs no effect. So where sets of an earlier
linearisation promised more names than were accepted in the end, the fit with all of them decides: a reading with a name for it is
rather that than one of the two in a hundred that are grossly wrong.
"""

from collections.abc import Sequence

import numpy as np

from ocp.diagnosis.system import Channel
from ocp.effects.effect import Active
from robots.errors import Infeasible

FREED = 3  # gross readings that a larger set must take back
DOUBTED = 0.5  # weight below which a reading is rather gross than good


def freed(channels: Sequence[Channel], promised: tuple[Active, ...]) -> list[Channel] | None:
    """The channels fitted with what was promised, where that takes gross readings back; else None."""
    try:
        found = [c.with_active(promised) for c in channels]
    except Infeasible:
        return None
    return found if sum(map(_gross, channels)) - sum(map(_gross, found)) >= FREED else None


def _gross(channel: Channel) -> int:
    """How many readings of a channel count for less than half."""
    weight = getattr(getattr(channel, "fit", None), "weight", None)
    return 0 if weight is None else int(np.count_nonzero(np.asarray(weight) < DOUBTED))
