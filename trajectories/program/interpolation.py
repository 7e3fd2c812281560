"""How many points of a trajectory a program needs, so that the curve a controller lays through them stays with the plan.

The curve is modelled in trajectories.program.driven. The controller's own is not published; what can be bounded is how far any
such curve can be from the plan, and that falls with the fourth power or more of the step where the plan is smooth.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from robots.errors import Infeasible
from robots.inverse import inverse_refined
from robots.pose import Array, abc_from_rotation, transform_from_xyzabc
from robots.robot import Robot
from trajectories.joint_trajectory import SAMPLE, JointTrajectory
from trajectories.program.driven import pose_curve, rest_to_rest_spline
from trajectories.program.execution import Frames
from trajectories.program.program import FileLimits

STEP = 0.025  # s between emitted points

Deviation = Callable[[Array, Array], Array]


class Laying(Protocol):
    """What points of a block are, and the axes that a controller makes of them."""

    def points(self, q: Array) -> Array:
        """The points of axes q (n, 6) rad, as they will be printed."""

    def axes(self, points: Array, times: Array, at: Array, planned: Array) -> Array:
        """Axes (m, 6) rad at times `at` (m,) s along the points, where planned (m, 6) are wanted."""


@dataclass(frozen=True)
class LaidAxes:
    """Points are axes."""

    limits: FileLimits

    def points(self, q: Array) -> Array:
        """As `Laying`."""
        return np.radians(np.round(np.degrees(q), self.limits.angle_decimals))

    def axes(self, points: Array, times: Array, at: Array, planned: Array) -> Array:
        """As `Laying`."""
        return np.asarray(rest_to_rest_spline(points, times)(at))


@dataclass(frozen=True)
class LaidPoses:
    """Points are poses of `frames` through the controller's own, nominal kinematics: `robot`; `posed` q (n, 6) -> (n, 4, 4)."""

    limits: FileLimits
    frames: Frames
    robot: Robot
    posed: Callable[[Array], Array]

    def points(self, q: Array) -> Array:
        """As `Laying`."""
        P = self.posed(q)
        xyz = np.round(1e3 * P[:, :3, 3], self.limits.length_decimals) * 1e-3
        abc = np.radians(np.round(np.degrees(abc_from_rotation(P[:, :3, :3])), self.limits.angle_decimals))
        return transform_from_xyzabc(xyz, abc)

    def axes(self, points: Array, times: Array, at: Array, planned: Array) -> Array:
        """As `Laying`."""
        found = inverse_refined(self.robot, self.frames.flange(pose_curve(points, times)(at)), planned)
        if not found.converged.all():
            raise Infeasible(f"the arm {self.robot.name} does not reach a pose between those of the plan; smooth the path")
        return np.asarray(found.q)


@dataclass(frozen=True)
class Emission:
    """Points of a trajectory as they will be printed, axes (n, 6) rad or poses (n, 4, 4), at times (n,) s; the largest
    deviation found."""

    times: Array
    points: Array
    deviation: float


def largest_axis_difference(planned: Array, driven: Array) -> Array:
    """The default measure of deviation, (n,) rad."""
    return np.asarray(np.abs(planned - driven).max(axis=1))


def emit(
    trajectory: JointTrajectory,
    limits: FileLimits,
    tolerance: Callable[[Array], Array] = lambda t: np.full(len(t), 2e-5),
    deviation: Deviation = largest_axis_difference,
    step: float = STEP,
    laid: Laying | None = None,
) -> Emission:
    """Emission points such that the curve through the printed points stays within `tolerance` of the plan at 1 ms.

    `tolerance(t)` (n,) -> (n,) at times s. `deviation(q_planned, q_driven)` (n, 6), (n, 6) -> (n,) has its unit (rad; or mm or N
    if the caller measures so); `laid`: what the points are (None: axes). Starts with equal steps, halves those whose
    neighbourhood deviates, never below the cycle of `limits`. Raises Infeasible, which names time and deviation, where that is
    not enough.
    """
    unit, most, laid = limits.time_unit, limits.block_points, laid or LaidAxes(limits)
    end = np.ceil(trajectory.duration / unit - 1e-6) * unit
    n = int(np.clip(np.ceil(end / step), 2, most - 1))
    times = np.rint(np.linspace(0.0, end, n + 1) / unit) * unit
    fine = np.arange(0.0, end, SAMPLE)
    planned, allowed = trajectory.q(fine), tolerance(fine)
    while True:
        points = laid.points(trajectory.q(times))
        error = deviation(planned, laid.axes(points, times, fine, planned))
        worst = int(np.argmax(error / allowed))
        if error[worst] <= allowed[worst]:
            return Emission(times, points, float(error.max()))
        cell = np.clip(np.searchsorted(times, fine[error > allowed], side="right") - 1, 0, len(times) - 2)
        near = np.unique(np.clip(np.concatenate([cell - 1, cell, cell + 1]), 0, len(times) - 2))
        near = near[np.diff(times)[near] >= 2 * limits.cycle]
        if len(near) == 0 or len(times) + len(near) > most:
            raise Infeasible(
                f"the emitted program leaves the plan by {error[worst]:.3g} (allowed {allowed[worst]:.3g}) at {fine[worst]:.3f} s"
                f" with {len(times)} points; drive slower there, smooth the path or allow more"
            )
        middle = np.rint(0.5 * (times[near] + times[near + 1]) / unit) * unit
        times = np.sort(np.concatenate([times, middle]))
