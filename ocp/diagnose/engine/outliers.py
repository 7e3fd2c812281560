"""Readings that were set aside as gross, and an effect that takes them back.

What nobody counts needs no effect: a nest that moves before the last few readings is taken for so many gross readings; so is a
small step once the noise has fallen with the names accepted before it. So where several readings are set aside, all are counted
once more, what then explains them best is fitted beside what was accepted, and the fit decides: readings with one cause in
common are rather that than each of them one of the two in a hundred that are grossly wrong.
"""

from collections.abc import Mapping, Sequence
from typing import Protocol, runtime_checkable

import numpy as np
from numpy.typing import NDArray

from ocp.diagnose.engine.beam import Search, Weighed, weigh
from ocp.diagnose.engine.channel_system import Channel
from ocp.diagnose.engine.findings import Options
from ocp.diagnose.engine.problem import Linearisation, linearised
from ocp.diagnose.rules import OUTLIER_WEIGHT, OUTLIERS_OF_ONE_CAUSE, RECHECKED
from ocp.effects.effect import Active, Effect
from robots.errors import Infeasible


@runtime_checkable
class Openable(Protocol):
    """A channel that can count every reading in full."""

    def opened(self) -> Channel:
        """The channel about the same fit with no reading set aside."""


def outliers_rechecked(
    problem: Linearisation, held: tuple[Active, ...], library: Mapping[str, Effect], options: Options
) -> list[Channel] | None:
    """The channels fitted with one effect more than is held, where that takes gross readings back; else None."""
    if _count(problem.channels) < OUTLIERS_OF_ONE_CAUSE:
        return None
    whole = linearised([c.opened() if isinstance(c, Openable) else c for c in problem.channels], library, options)
    search = Search(whole.pool, options.most, options.beam)
    names = {a.key for a in held}
    key = [i for n, i in whole.index.items() if (n.effect, n.joint) in names]
    there = weigh(whole.pool, key) if key else Weighed(0.0, ())
    value = search.scan(there).log + search.odds
    value[[*key, *np.flatnonzero(search.kernel | search.background)]] = -np.inf
    for f in np.argsort(-value)[:RECHECKED]:
        if value[f] <= 0:
            break
        try:
            found = [c.with_active(whole.values(weigh(whole.pool, [*key, int(f)]))) for c in problem.channels]
        except Infeasible:
            continue
        if _count(problem.channels) - _count(found) >= OUTLIERS_OF_ONE_CAUSE:
            return found
    return None


def outliers(channel: Channel) -> NDArray[np.bool_]:
    """Readings (n,) of a channel that are set aside as gross; none where its fit weighs no single readings."""
    n = len(channel.gap())
    weight = getattr(getattr(channel, "fit", None), "weight", None)
    return np.zeros(n, bool) if weight is None or np.shape(weight) != (n,) else np.asarray(weight <= OUTLIER_WEIGHT)


def _count(channels: Sequence[Channel]) -> int:
    return sum(int(np.count_nonzero(outliers(c))) for c in channels)
