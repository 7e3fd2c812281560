"""How well data, taken or planned, tell an effect from a rival: what of its signature the rival cannot imitate.

    lambda(A | B) = min over b of |M (C_A a - C_B b)|^2

a the value found, M the projection of the nuisance on all rows together (docs/diagnosis.md, eq. 2).
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ocp.diagnose.engine.channel_system import ReadingRows
from ocp.diagnose.engine.evidence import project
from ocp.diagnose.engine.findings import Name, Ranked
from ocp.diagnose.engine.linearisation import put_back, stacked_columns
from ocp.effects.effect import Effect, Scanned
from robots.pose import Array

NOTHING = "none"
MOST_SCANS = 12  # variants of a rival that are tried


@dataclass(frozen=True)
class ProposedMeasurement:
    """A measurement that could be made: what to do, minutes."""

    do: str
    minutes: float


@dataclass(frozen=True)
class RivalPair:
    """An effect with its value, its rival (None: nothing), and the probability of the first against the second now."""

    first: Ranked
    rival: Effect | None
    joint: int
    now: float

    @property
    def names(self) -> tuple[str, ...]:
        """Of both."""
        return (str(self.first.name), NOTHING if self.rival is None else str(Name(self.rival.name, self.joint)))


def unlike(shared: Sequence[ReadingRows], pair: RivalPair, beside: Sequence[ReadingRows] = ()) -> float:
    """lambda(A | B): what of the first's signature the rival and the nuisance cannot imitate. Rows `shared` have the same
    nuisance; those `beside` one of their own each."""
    every = [*shared, *beside]
    groups = [group for group in (shared, *([c] for c in beside)) if group]
    projections = [project(np.concatenate([c.system.nuisance for c in g]), g[0].system.prior_sd) for g in groups]
    sizes = [len(c.system.residual) for c in every]
    first = sum(sizes[: len(shared)])
    cuts = np.cumsum([first, *sizes[len(shared) :]])[:-1] if shared else np.cumsum(sizes)[:-1]

    def free(columns: Array) -> Array:
        return np.concatenate([p.apply(part) for p, part in zip(projections, np.split(columns, cuts), strict=True)])

    left = free(put_back(every, [pair.first.active]))
    if pair.rival is None:
        return float(left @ left)
    sd, columns = np.asarray(pair.rival.prior_sd, float), _rival_columns(every, pair.rival, pair.joint)
    return min(float(np.sum(project(free(c), sd).apply(left) ** 2)) for c in columns)


def scans_of(every: Sequence[ReadingRows], effect: Effect, joint: int) -> list[Scanned]:
    """Variants of an effect that the first rows which show it offer, a few of them evenly over its scan."""
    return few_of(next((found for c in every if (found := c.variants(effect, joint)[0])), ()), MOST_SCANS)


def few_of(scans: Sequence[Scanned], most: int) -> list[Scanned]:
    """At most so many of a scan, evenly taken."""
    return [scans[k] for k in np.unique(np.linspace(0, len(scans) - 1, min(most, len(scans))).round().astype(int))]


def _rival_columns(every: Sequence[ReadingRows], rival: Effect, joint: int) -> list[Array]:
    """Stacked columns (N, m) of the rival's variants; without rows that show it one of zeros."""
    chosen = scans_of(every, rival, joint)
    columns, found = stacked_columns(every, rival, joint, chosen)
    return [columns[:, k] for k in range(len(found))] or [np.zeros((sum(len(c.system.residual) for c in every), rival.size))]
