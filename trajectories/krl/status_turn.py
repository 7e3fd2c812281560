"""Status S and turn T of a KUKA position, from the axes (KRL.md, "Axes, status, turn")."""

from dataclasses import dataclass

import numpy as np

from robots.pose import Array


@dataclass(frozen=True)
class ArmLengths:
    """Lengths in m that decide the branch: a1, a2, a3 and d4 of the nominal arm (PHYSICS.md 2.1)."""

    a1: float
    a2: float
    a3: float
    d4: float

    @staticmethod
    def of(mdh: Array) -> "ArmLengths":
        """From an MD-H table (6, 5) with columns theta, d, a, alpha, beta."""
        return ArmLengths(float(mdh[0, 2]), float(mdh[1, 2]), float(mdh[2, 2]), float(mdh[3, 1]))


def turn_of(q: Array) -> Array:
    """T (n,) of axes q (n, 6) rad: bit i-1 is 1 iff axis i is negative."""
    return np.asarray((np.asarray(q) < 0) @ (1 << np.arange(6)))


def status_of(q: Array, arm: ArmLengths) -> Array:
    """S (n,) of axes q (n, 6) rad: overhead (bit 0), elbow (bit 1), wrist (bit 2); bit 4 is left 0 (KRL.md)."""
    q = np.asarray(q, float)
    q23 = q[:, 1] + q[:, 2]
    overhead = arm.a1 + arm.a2 * np.cos(q[:, 1]) + arm.d4 * np.cos(q23) + arm.a3 * np.sin(q23) < 0
    elbow = q[:, 2] >= np.arctan2(arm.a3, arm.d4)
    wrist = ((q[:, 4] >= -np.pi) & (q[:, 4] < 0)) | (q[:, 4] >= np.pi)
    return np.asarray(overhead * 1 + elbow * 2 + wrist * 4)
