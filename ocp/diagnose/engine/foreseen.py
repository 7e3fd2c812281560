"""Which of the named effects conditions that nobody has read say enough of to be predicted."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from ocp.effects.effect import Active, Effect
from robots.tracker_readings import Index


@dataclass(frozen=True)
class Foreseen:
    """Effects that can be predicted, and those for which a column is missing; kept (k,): places of the known ones' coefficients
    among those of all."""

    known: tuple[Active, ...]
    unknown: tuple[Active, ...]
    kept: Index

    @property
    def lacking(self) -> tuple[str, ...]:
        """Names of the unknown ones."""
        return tuple(a.effect.name for a in self.unknown)


def foreseen(active: Sequence[Active], told: Callable[[Effect], bool]) -> Foreseen:
    """Effects parted by whether the conditions have what each needs (`told`)."""
    inside = [told(a.effect) for a in active]
    known, unknown = (tuple(a for a, k in zip(active, inside, strict=True) if k is wanted) for wanted in (True, False))
    kept = np.flatnonzero(np.repeat(inside, [a.effect.size for a in active])) if active else np.zeros(0, np.int64)
    return Foreseen(known, unknown, kept)
