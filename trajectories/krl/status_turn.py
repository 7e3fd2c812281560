"""Status S and turn T of a KUKA position, from the axes (KRL.md, "Axes, status, turn")."""

import numpy as np

from robots.pose import Array


def turn_of(q: Array) -> Array:
    """T (n,) of axes q (n, 6) rad: bit i-1 is 1 iff axis i is negative."""
    return np.asarray((np.asarray(q) < 0) @ (1 << np.arange(6)))


def status_of(q: Array, mdh: Array) -> Array:
    """S (n,) of axes q (n, 6) rad: overhead (bit 0), elbow (bit 1), wrist (bit 2); bit 4 is left 0 (KRL.md). What decides of the
    nominal arm's MD-H table (6, 5) are a1, a2, a3 and d4 (PHYSICS.md 2.1)."""
    q = np.asarray(q, float)
    (a1, a2, a3), d4 = mdh[:3, 2], mdh[3, 1]
    q23 = q[:, 1] + q[:, 2]
    overhead = a1 + a2 * np.cos(q[:, 1]) + d4 * np.cos(q23) + a3 * np.sin(q23) < 0
    elbow = q[:, 2] >= np.arctan2(a3, d4)
    wrist = ((q[:, 4] >= -np.pi) & (q[:, 4] < 0)) | (q[:, 4] >= np.pi)
    return np.asarray(overhead * 1 + elbow * 2 + wrist * 4)
