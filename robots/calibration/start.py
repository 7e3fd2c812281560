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
    best = rigid_motion(source, target)
    least = float(np.median(np.linalg.norm(source @ best[:3, :3].T + best[:3, 3] - target, axis=1)))
    if n > SUBSET:
        rows = default_rng(0).random((TRIALS, n)).argpartition(SUBSET, axis=1)[:, :SUBSET]
        R, t = _motions(source[rows], target[rows])
        medians = np.median(np.linalg.norm(source @ np.swapaxes(R, 1, 2) + t[:, None] - target, axis=2), axis=1)
        k = int(np.argmin(medians))
        best, least = make_transform(R[k], t[k]), float(medians[k])
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


def _motions(source: Array, target: Array) -> tuple[Array, Array]:
    """Rotations (m, 3, 3) and shifts (m, 3) that move source (m, k, 3) onto target, all at once (Kabsch 1976)."""
    a, b = source.mean(axis=1), target.mean(axis=1)
    U, _, Vt = np.linalg.svd(np.swapaxes(source - a[:, None], 1, 2) @ (target - b[:, None]))
    V = np.swapaxes(Vt, 1, 2).copy()
    V[:, :, 2] *= np.sign(np.linalg.det(V @ np.swapaxes(U, 1, 2)))[:, None]
    R = V @ np.swapaxes(U, 1, 2)
    return R, b - (R @ a[..., None])[..., 0]
