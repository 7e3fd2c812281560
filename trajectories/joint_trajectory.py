"""A timed joint path with its limits: evaluated exactly at any time, never from resampled tables."""

from collections.abc import Callable
from dataclasses import dataclass
from enum import Enum
from typing import TYPE_CHECKING

import numpy as np
from scipy.interpolate import CubicSpline, PPoly

from robots.pose import Array

if TYPE_CHECKING:
    from robots.robot import Robot

SAMPLE = 1e-3  # s, the period at which limits are checked (PHYSICS.md part 2, PEERS.md)

Torque = Callable[[Array, Array, Array], Array]


@dataclass(frozen=True)
class Limits:
    """What the axes can do, each (6,): speed rad/s, acceleration rad/s^2, range rad, torque N m at the link
    side.

    `torque` maps stacks q, qd, qdd (n, 6) to torques (n, 6); None: not checked. It must be a rigid-body law
    (inertia, terms quadratic in speed, weight); speed-dependent friction is not covered. `margin` is the part
    of speed, acceleration and torque limits that a plan may use; axis range and feed bound have no margin.
    """

    qd: Array
    qdd: Array
    q_min: Array
    q_max: Array
    torque_max: Array | None = None
    torque: Torque | None = None
    margin: float = 0.9

    @staticmethod
    def of(robot: "Robot", torque: Torque | None = None, margin: float = 0.9) -> "Limits":
        """The limits of a catalogue robot; `torque` usually is inverse dynamics with the payload bound in."""
        return Limits(robot.qd_max, robot.qdd_max, robot.q_min, robot.q_max, robot.torque_max, torque, margin)


class TimingStatus(Enum):
    """How the limits were met; the value is the message."""

    HELD = "all limits hold at 1 ms"
    SLOWED = "all limits hold at 1 ms after the whole motion was slowed down"


@dataclass(frozen=True)
class Worst:
    """Largest ratio over all samples to the machine's limit (not to margin * limit); feed: to its bound."""

    velocity: float
    acceleration: float
    torque: float
    feed: float


@dataclass(frozen=True)
class JointTrajectory:
    """A joint path timed from rest to rest: q(t) = path(law(t)).

    `path`: q(s) rad with s in m (air moves: rad of the axis that moves most); `law`: s(t); `stations` (n,)
    and `times` (n,) of the waypoints; `kept` (n,) their indices in the path handed in (near-duplicates are
    dropped); `feed_bound` (n,) m/s or None; `worst` and `status` as checked at 1 ms.
    """

    path: CubicSpline
    law: PPoly
    stations: Array
    times: Array
    kept: Array
    feed_bound: Array | None
    limits: Limits
    worst: Worst
    status: TimingStatus

    @property
    def duration(self) -> float:
        """Seconds from rest to rest."""
        return float(self.law.x[-1])

    def _law(self, t: Array | float, order: int) -> Array:
        t = np.clip(np.asarray(t, float), 0.0, self.duration)
        value = np.asarray(self.law(t, order))
        return np.clip(value, 0.0, self.stations[-1]) if order == 0 else value

    def s(self, t: Array | float) -> Array:
        """Arc length (...) m at times t (...) s; before the start and after the end it rests."""
        return self._law(t, 0)

    def feed(self, t: Array | float) -> Array:
        """ds/dt (...) m/s."""
        return np.maximum(self._law(t, 1), 0.0)

    def motion(self, t: Array | float) -> tuple[Array, Array, Array]:
        """`q`, `qd` and `qdd` in one go."""
        s, v, u = self.s(t), self.feed(t)[..., None], self._law(t, 2)[..., None]
        slope = self.path(s, 1)
        return np.asarray(self.path(s)), np.asarray(slope * v), np.asarray(self.path(s, 2) * v**2 + slope * u)

    def q(self, t: Array | float) -> Array:
        """Joints (..., 6) rad."""
        return np.asarray(self.path(self.s(t)))

    def qd(self, t: Array | float) -> Array:
        """Joint speeds (..., 6) rad/s: q' ds/dt."""
        return np.asarray(self.path(self.s(t), 1) * self.feed(t)[..., None])

    def qdd(self, t: Array | float) -> Array:
        """Joint accelerations (..., 6) rad/s^2: q'' (ds/dt)^2 + q' d2s/dt2."""
        return self.motion(t)[2]

    def ratios(self, t: Array) -> Array:
        """Ratios (n, 4) of speed, acceleration, torque (largest over the axes) and feed at times t (n,)."""
        t, limits = np.asarray(t, float), self.limits
        q, qd, qdd = self.motion(t)
        result = np.zeros((len(t), 4))
        result[:, 0] = np.abs(qd / limits.qd).max(axis=1)
        result[:, 1] = np.abs(qdd / limits.qdd).max(axis=1)
        if limits.torque is not None and limits.torque_max is not None:
            result[:, 2] = np.abs(limits.torque(q, qd, qdd) / limits.torque_max).max(axis=1)
        if self.feed_bound is not None:
            result[:, 3] = self.feed(t) / np.interp(self.s(t), self.stations, self.feed_bound)
        return result

    def limit_ratio(self, t: Array) -> Array:
        """Largest ratio of speed, acceleration and torque to the machine's limits at times t (n,), (n,)."""
        return np.asarray(self.ratios(t)[:, :3].max(axis=1))


def sample_times(trajectory: JointTrajectory, period: float = SAMPLE) -> Array:
    """Times (n,) s from 0 to the end: every `period`, and the knots of law and path, where extremes sit."""
    T = trajectory.duration
    return np.unique(np.concatenate([np.arange(0.0, T, period), [T], trajectory.law.x, trajectory.times]))


def ramps(trajectory: JointTrajectory, part: float = 0.99) -> tuple[float, float]:
    """Lengths in m at start and end over which the feed is below `part` of its bound.

    Without a bound, or where the bound is never reached, the reference is the largest feed of the motion.
    """
    t = sample_times(trajectory)
    s, feed = trajectory.s(t), trajectory.feed(t)
    bound = np.full(len(t), feed.max())
    if trajectory.feed_bound is not None:
        given = np.interp(s, trajectory.stations, trajectory.feed_bound)
        bound = given if np.any(feed >= part * given) else bound
    fast = np.flatnonzero(feed >= part * bound)
    return float(s[fast[0]]), float(trajectory.stations[-1] - s[fast[-1]])
