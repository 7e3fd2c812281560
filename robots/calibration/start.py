"""Where the tracker stands, from nothing: the rigid motion that most readings agree on (least median of squares)."""

import numpy as np
from numpy.random import default_rng

from robots.pose import Array, make_transform

TRIALS = 200
SUBSET = 4


def rigid_motion(source: Array, target: Array, weight: Array | None = None) -> Array:
    """T (4, 4) that moves source (n, 3) onto target (n, 3) in weighted least squares (Kabsch 1976), always right-handed."""
    w = np.ones(len(source)) if weight is None else weight
    a, b = (np.average(x, axis=0, weights=w) for x in (source, target))
    U, _, Vt = np.linalg.svd((source - a).T @ (w[:, None] * (target - b)))
    R = Vt.T @ np.diag([1.0, 1.0, np.sign(np.linalg.det(Vt.T @ U.T))]) @ U.T
    return make_transform(R, b - R @ a)


def robust_motion(source: Array, target: Array) -> tuple[Array, float]:
    """T (4, 4) and the median distance m it leaves: the best of many small subsets, refined on the nearer half.

    Deterministic; half of the readings may be wrong (Rousseeuw 1984).
    """
    n = len(source)
    rng = default_rng(0)
    best, least = rigid_motion(source, target), np.inf
    for _ in range(TRIALS if n > SUBSET else 1):
        rows = rng.choice(n, min(SUBSET, n), replace=False)
        T = rigid_motion(source[rows], target[rows])
        off = np.linalg.norm(source @ T[:3, :3].T + T[:3, 3] - target, axis=1)
        median = float(np.median(off))
        if median < least:
            best, least = T, median
    for _ in range(3):
        off = np.linalg.norm(source @ best[:3, :3].T + best[:3, 3] - target, axis=1)
        near = off <= np.median(off)
        if near.sum() >= 3:
            T = rigid_motion(source[near], target[near])
            median = float(np.median(np.linalg.norm(source @ T[:3, :3].T + T[:3, 3] - target, axis=1)))
            if median > least:
                break
            best, least = T, median
    return best, least
