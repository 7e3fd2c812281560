"""Every posture of a pose within the axis limits, or why there is none: what the planner's own search is checked against."""

from dataclasses import dataclass
from enum import Enum
from itertools import product

import numpy as np
from numpy.typing import ArrayLike, NDArray

from robots.inverse import inverse_branches, reach_excess
from robots.pose import Array
from robots.robot import Robot

REACH_ROUNDING = 1e-12  # m, as in robots.inverse


class Status(Enum):
    """What an inverse came to; the value is the sentence for a user."""

    FOUND = "postures within the axis limits exist"
    OUT_OF_REACH = "the wrist centre is out of reach"
    OUTSIDE_LIMITS = "every posture breaks an axis limit"
    NOT_CONVERGED = "the arm's own geometry misses the pose near a singular posture"


@dataclass(frozen=True)
class Solutions:
    """All postures of one pose: q (m, 6) rad within limits, branch (m,) = KUKA's S, and why if there are none.

    excess: m beyond reach, or rad beyond the axis limit in the posture that comes closest; axis 1..6 for the
    latter.
    """

    q: Array
    branch: NDArray[np.int64]
    status: Status
    excess: float = 0.0
    axis: int | None = None

    def reason(self) -> str:
        """One sentence."""
        if self.status is Status.OUT_OF_REACH:
            return f"{self.status.value} by {self.excess * 1e3:.1f} mm"
        if self.status is Status.OUTSIDE_LIMITS:
            return f"{self.status.value}, at best axis {self.axis} by {np.degrees(self.excess):.1f} deg"
        return self.status.value


def turns(robot: Robot, q: ArrayLike) -> Array:
    """All postures (m, 6) rad equal to q (6,) up to whole turns of axes, within the limits; m may be 0."""
    q = np.asarray(q, float)
    # Rounding must not throw out a posture on its limit.
    low = np.ceil((robot.q_min - q) / (2 * np.pi) - 1e-12).astype(int)
    high = np.floor((robot.q_max - q) / (2 * np.pi) + 1e-12).astype(int)
    shifts = list(product(*(range(a, b + 1) for a, b in zip(low, high, strict=True))))
    return np.clip(q + 2 * np.pi * np.array(shifts, float).reshape(-1, 6), robot.q_min, robot.q_max)


def inverse_all(robot: Robot, T: ArrayLike) -> Solutions:
    """Every posture of one flange pose T (4, 4) within the axis limits: all branches, all turns. Errors as `inverse_branches`."""
    q, reachable = inverse_branches(robot, np.asarray(T, float).reshape(1, 4, 4))
    found = [(turns(robot, q[0, b]), b) for b in range(8) if reachable[0, b]]
    postures = np.concatenate([np.empty((0, 6)), *(rows for rows, _ in found)])
    branch = np.concatenate([np.empty(0, int), *(np.full(len(rows), b) for rows, b in found)])
    if len(postures):
        return Solutions(postures, branch, Status.FOUND)
    if not found:
        excess = float(reach_excess(robot, np.asarray(T, float))[0])
        state = Status.OUT_OF_REACH if excess > REACH_ROUNDING else Status.NOT_CONVERGED
        return Solutions(postures, branch, state, excess)
    over = np.array([_least_excess(robot, q[0, b]) for _, b in found])
    best = int(np.argmin(over.max(axis=1)))
    return Solutions(postures, branch, Status.OUTSIDE_LIMITS, float(over[best].max()), int(np.argmax(over[best])) + 1)


def _least_excess(robot: Robot, q: Array) -> Array:
    """How far (6,) rad each axis of q (6,) stays outside its limits in its best turn; not above zero = inside."""
    turned = q + 2 * np.pi * np.arange(-2, 3)[:, None]
    return np.asarray(np.maximum(robot.q_min - turned, turned - robot.q_max).min(axis=0))
