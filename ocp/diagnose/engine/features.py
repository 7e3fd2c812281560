"""Smooth functions of conditions that the library-free kernels are made of: cosines, waves, groups, and their products."""

import numpy as np

from robots.pose import Array
from robots.tracker_readings import Index

SMOOTH = 7  # cosines over a condition's range
SOFT = 4.0  # wave number at which their prior has fallen to half


def smooth(values: Array, count: int = SMOOTH) -> Array:
    """Cosines (n, count) over the range of values, falling with their wave number; the constant is left out."""
    span = float(np.ptp(values)) or 1.0
    x = (values - values.min()) / span
    k = np.arange(1, count + 1)
    return np.asarray(np.cos(np.pi * k * x[:, None]) / (1.0 + (k / SOFT) ** 2))


def waves(angle: Array) -> Array:
    """Once a turn (n, 2)."""
    return np.column_stack([np.cos(angle), np.sin(angle)])


def unit(values: Array) -> Array:
    """Values over their largest size."""
    return np.asarray(values / (np.abs(values).max() or 1.0))


def products(one: Array, other: Array) -> Array:
    """Each of (n, a) times each of (n, b): (n, a b)."""
    return np.asarray((one[:, :, None] * other[:, None, :]).reshape(len(one), -1))


def waves_of_two(q: Array, other: Array, a: int, b: int) -> Array:
    """Waves (n, 4) of two angles, a per turn of the first times b per turn of the second."""
    return products(waves(a * q), waves(b * other))


def groups(index: Array | Index | None, centred: bool = True) -> Array | None:
    """Indicators (n, g - 1) of all groups but the largest, or None where there is one group; centred about their means."""
    if index is None:
        return None
    kinds, counts = np.unique(index, return_counts=True)
    if len(kinds) < 2:
        return None
    kept = np.delete(kinds, np.argmax(counts)) if centred else kinds
    indicator = (np.asarray(index)[:, None] == kept).astype(float)
    return indicator - indicator.mean(axis=0) if centred else indicator
