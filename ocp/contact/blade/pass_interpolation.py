"""Smooth interpolation of compliance along passes, solved only where it is needed.

Between control points log c_nn and the ratios c_nt / c_nn, c_nb / c_nn are modified Akima cubics in arc length: they
keep c_nn positive and do not swing where a patch runs over an edge. Every interval is checked in its middle and halved
until the check is passed; the middle then serves as one more control point.
"""

from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import Akima1DInterpolator

Array = NDArray[np.float64]
Index = NDArray[np.int64]

SPACING = 8e-3  # m between the first control points of a pass; the first check halves it
FINEST = 1e-3  # m: shorter intervals are not halved
TOLERANCE = 5e-3  # relative to c_nn; an interval whose middle is off by more is halved again
RIGID = 1e-11  # m/N: less than any patch of a metal blade gives; keeps the logarithm finite inside the clamp
NEGLIGIBLE = 1e-7  # m/N: beside the 1e-5 of a rubber wheel; errors are relative to c_nn plus this


def interpolate_passes(
    solve: Callable[[Index], Array], arc_lengths: Sequence[Array], tolerance: float = TOLERANCE
) -> tuple[list[Array], Array, int]:
    """Return c (n, 3) of each pass from few calls of `solve`.

    Args:
        solve: gives (m, 3) c_nn, c_nt, c_nb in m/N at m waypoints, numbered through all passes.
        arc_lengths: s (n,) m of each pass, increasing.
        tolerance: relative error at the middle of an interval above which it is halved.

    Returns:
        The values, the largest relative error found at the middle of the intervals kept of each pass, and the number
        of waypoints solved.
    """
    starts = np.cumsum([0] + [len(s) for s in arc_lengths])
    known = np.full((starts[-1], 3), np.nan)
    controls = [_spread(s) for s in arc_lengths]
    fresh = np.concatenate([start + index for start, index in zip(starts, controls, strict=False)])
    known[fresh] = solve(fresh)
    open_intervals = [np.stack([index[:-1], index[1:]], axis=1) for index in controls]
    error = np.zeros(len(arc_lengths))
    while True:
        middles = [_middles(s, pairs) for s, pairs in zip(arc_lengths, open_intervals, strict=True)]
        fresh = np.concatenate([start + np.unique(m) for start, m in zip(starts, middles, strict=False)])
        if not len(fresh):
            break
        values = solve(fresh)
        guesses = known.copy()
        for i, s in enumerate(arc_lengths):
            guesses[starts[i] : starts[i + 1]] = _interpolate(s, known[starts[i] : starts[i + 1]])
        off = np.max(np.abs(guesses[fresh] - values), axis=1) / (values[:, 0] + NEGLIGIBLE)
        known[fresh] = values
        at_waypoint = np.zeros(len(known))
        at_waypoint[fresh] = off
        for i, s in enumerate(arc_lengths):
            pairs, middle = open_intervals[i], middles[i]
            pairs = pairs[np.diff(pairs, axis=1).ravel() > 1] if len(pairs) else pairs
            bad = at_waypoint[starts[i] + middle] > tolerance
            bad &= s[pairs[:, 1]] - s[pairs[:, 0]] > 2.0 * FINEST
            kept = at_waypoint[starts[i] + middle[~bad]]
            error[i] = max(error[i], kept.max(initial=0.0))
            open_intervals[i] = np.concatenate(
                [np.stack([pairs[bad, 0], middle[bad]], 1), np.stack([middle[bad], pairs[bad, 1]], 1)]
            )
    count = int(np.count_nonzero(~np.isnan(known[:, 0])))
    filled = [_interpolate(s, known[starts[i] : starts[i + 1]]) for i, s in enumerate(arc_lengths)]
    return filled, error, count


def _spread(s: Array) -> Index:
    """Return waypoints about SPACING apart, both ends among them and one close to each end."""
    length = s[-1] - s[0]
    wished = np.linspace(0.0, length, int(np.ceil(length / SPACING)) + 1)
    wished = np.concatenate([wished, [0.25 * SPACING, length - 0.25 * SPACING]]) + s[0]
    index = np.clip(np.searchsorted(s, wished - 1e-12), 0, len(s) - 1)
    return np.unique(np.concatenate([index, [0, len(s) - 1]]))


def _middles(s: Array, pairs: Index) -> Index:
    """Return the waypoint nearest to the middle of each interval that has one inside."""
    if not len(pairs):
        return np.empty(0, np.int64)
    pairs = pairs[np.diff(pairs, axis=1).ravel() > 1]
    middle = np.searchsorted(s, 0.5 * (s[pairs[:, 0]] + s[pairs[:, 1]]))
    return np.clip(middle, pairs[:, 0] + 1, pairs[:, 1] - 1)


def _interpolate(s: Array, known: Array) -> Array:
    """Fill the rows of `known` (n, 3) that are nan; rows that are not stay as they are."""
    at = np.flatnonzero(~np.isnan(known[:, 0]))
    if len(at) == len(s):
        return known
    stiffened = known[at, 0] + RIGID
    table = np.column_stack([np.log(stiffened), known[at, 1:] / stiffened[:, None]])
    if len(at) > 2:
        table = Akima1DInterpolator(s[at], table, method="makima")(s)
    else:
        table = np.stack([np.interp(s, s[at], column) for column in table.T], axis=1)
    filled = np.exp(table[:, :1]) * np.column_stack([np.ones(len(s)), table[:, 1:]])
    filled[:, 0] = np.maximum(filled[:, 0] - RIGID, 0.0)
    filled[at] = known[at]
    return filled
