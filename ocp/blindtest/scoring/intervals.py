"""Confidence intervals of the figures: shares, medians, F1."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from robots.pose import Array

Z95 = 1.959964
DRAWS = 2000


@dataclass(frozen=True)
class Estimate:
    """A figure with its 95 % interval and how many worlds it rests on; nan without any."""

    value: float
    low: float
    high: float
    count: int


NOTHING = Estimate(float("nan"), float("nan"), float("nan"), 0)


def share_of_hits(hits: Sequence[bool]) -> Estimate:
    """Share of hits (Wilson 1927, eq. 6)."""
    n = len(hits)
    if n == 0:
        return NOTHING
    p, z2 = sum(map(bool, hits)) / n, Z95**2
    middle = (p + z2 / (2 * n)) / (1 + z2 / n)
    half = Z95 / (1 + z2 / n) * np.sqrt(p * (1 - p) / n + z2 / (4 * n * n))
    # Rounding must not leave the share outside its interval.
    return Estimate(p, float(min(max(middle - half, 0.0), p)), float(max(min(middle + half, 1.0), p)), n)


def bootstrap(rows: Sequence[Sequence[float]], figure: Callable[[Array], float], seed: int = 0) -> Estimate:
    """A figure of rows (n, k) with the interval of `DRAWS` draws of whole rows."""
    table = np.asarray(rows, float)
    n = len(table)
    if n == 0:
        return NOTHING
    rng = np.random.default_rng(seed)
    drawn = [figure(table[rng.integers(n, size=n)]) for _ in range(DRAWS)]
    low, high = np.nanquantile(drawn, [0.025, 0.975])
    return Estimate(float(figure(table)), float(low), float(high), n)


def median(values: Sequence[float]) -> Estimate:
    """Median of values."""
    return bootstrap([[v] for v in values], lambda t: float(np.median(t)))


def share_in_groups(groups: Sequence[Sequence[bool]]) -> Estimate:
    """Share of hits in all groups together, groups drawn as wholes: hits of one world are not independent."""
    rows = [[sum(map(bool, g)), len(g)] for g in groups if len(g)]
    return bootstrap(rows, lambda t: float(t[:, 0].sum() / t[:, 1].sum()))


def f1(counts: Sequence[tuple[int, int, int]]) -> Estimate:
    """F1 of rows (found, named, planted), summed over worlds."""
    return bootstrap(counts, lambda t: float(2 * t[:, 0].sum() / max(t[:, 1].sum() + t[:, 2].sum(), 1)))
