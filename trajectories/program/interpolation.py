"""What a controller makes of emitted points: a smooth curve of about fifth order, and how many points that needs.

The model is the quintic spline (C4) through the points of a block that starts and ends at rest. The controller's own
curve is not published; what can be bounded is how far any such curve can be from the plan, and that falls with the
fourth power or more of the step where the plan is smooth.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy.interpolate import BSpline, make_interp_spline
from scipy.spatial.transform import Rotation

from robots.errors import BadInput, Infeasible
from robots.pose import Array, make_transform
from trajectories.joint_trajectory import SAMPLE, JointTrajectory
from trajectories.program.execution import Execution
from trajectories.program.program import FileLimits

STEP = 0.025  # s between emitted points

Deviation = Callable[[Array, Array], Array]


def rest_to_rest_spline(q: Array, t: Array) -> BSpline:
    """Quintic spline through q (n, m) at times t (n,) with speed and acceleration zero at both ends."""
    rest = [(1, np.zeros(q.shape[1])), (2, np.zeros(q.shape[1]))]
    return make_interp_spline(t, q, k=5, bc_type=(rest, rest))


@dataclass(frozen=True)
class Emission:
    """Points of a trajectory as they will be printed: times (n,) s, axes q (n, 6) rad; the largest deviation found."""

    times: Array
    q: Array
    deviation: float


def largest_axis_difference(planned: Array, driven: Array) -> Array:
    """The default measure of deviation, (n,) rad."""
    return np.asarray(np.abs(planned - driven).max(axis=1))


def emit(
    trajectory: JointTrajectory,
    limits: FileLimits,
    tolerance: float = 2e-5,
    deviation: Deviation = largest_axis_difference,
    step: float = STEP,
) -> Emission:
    """Emission points such that the curve through the printed points stays within `tolerance` of the plan at 1 ms.

    `deviation(q_planned, q_driven)` (n, 6), (n, 6) -> (n,) has the unit of `tolerance` (rad; or mm or N if the caller
    measures so). Starts with equal steps, halves those whose neighbourhood deviates, never below the cycle of `limits`. Raises
    Infeasible, which names time and deviation, where that is not enough.
    """
    unit, most = limits.time_unit, limits.block_points
    end = np.ceil(trajectory.duration / unit - 1e-6) * unit
    n = int(np.clip(np.ceil(end / step), 2, most - 1))
    times = np.rint(np.linspace(0.0, end, n + 1) / unit) * unit
    fine = np.arange(0.0, end, SAMPLE)
    planned = trajectory.q(fine)
    while True:
        q = np.radians(np.round(np.degrees(trajectory.q(times)), limits.angle_decimals))
        error = deviation(planned, rest_to_rest_spline(q, times)(fine))
        worst = int(np.argmax(error))
        if error[worst] <= tolerance:
            return Emission(times, q, float(error[worst]))
        cell = np.clip(np.searchsorted(times, fine[error > tolerance], side="right") - 1, 0, len(times) - 2)
        near = np.unique(np.clip(np.concatenate([cell - 1, cell, cell + 1]), 0, len(times) - 2))
        near = near[np.diff(times)[near] >= 2 * limits.cycle]
        if len(near) == 0 or len(times) + len(near) > most:
            raise Infeasible(
                f"the emitted program leaves the plan by {error[worst]:.3g} (allowed {tolerance:.3g}) at {fine[worst]:.3f} s "
                f"with {len(times)} points; drive slower there, smooth the path or allow more"
            )
        middle = np.rint(0.5 * (times[near] + times[near + 1]) / unit) * unit
        times = np.sort(np.concatenate([times, middle]))


@dataclass(frozen=True)
class ProgramMotion:
    """The motion of an axis program as read back: pieces (start s, spline) one after the other."""

    starts: Array
    pieces: tuple[BSpline, ...]
    duration: float
    places: tuple[tuple[str, int], ...]  # file and line of each piece

    def _evaluate(self, t: Array, order: int) -> Array:
        t = np.clip(np.atleast_1d(np.asarray(t, float)), 0.0, self.duration)
        which = np.clip(np.searchsorted(self.starts, t, side="right") - 1, 0, len(self.pieces) - 1)
        result = np.empty((len(t), 6))
        for i in np.unique(which):
            mine = which == i
            piece = self.pieces[i]
            result[mine] = piece(np.clip(t[mine] - self.starts[i], 0.0, piece.t[-1]), nu=order)
        return result

    def q(self, t: Array) -> Array:
        """Axes (n, 6) rad at program times t (n,) s."""
        return self._evaluate(t, 0)

    def qd(self, t: Array) -> Array:
        """Axis speeds (n, 6) rad/s."""
        return self._evaluate(t, 1)

    def qdd(self, t: Array) -> Array:
        """Axis accelerations (n, 6) rad/s^2."""
        return self._evaluate(t, 2)

    def sample_times(self, period: float = SAMPLE) -> Array:
        """0, period, .. and the end, (n,) s."""
        return np.append(np.arange(0.0, self.duration, period), self.duration)


def reinterpolate(execution: Execution, qd: Array, qdd: Array, part: float = 0.1) -> ProgramMotion:
    """The axes over time that the program read back commands; its first posture is where the robot is taken to stand.

    Timed blocks keep their times. A move to a point takes as long as a smooth move needs at `part` of the speeds qd and
    accelerations qdd (6,); one that goes nowhere takes no time. Raises BadInput for programs of poses, whose axes depend
    on the controller's inverse kinematics: see `pose_spline`.
    """
    starts, pieces, places, clock = [], [], [], 0.0
    where: Array | None = None
    for s in execution.segments:
        if s.q is None or (s.kind != "point" and s.times is None):
            raise BadInput(f"{s.place()}: {s.word} is not an axis motion with times; only those can be replayed")
        q, t = s.q, s.times
        if s.kind == "point":
            distance = np.abs(q[0] - where) if where is not None else np.zeros(6)
            # quintic from rest to rest: peak speed 15/8 d/T, peak acceleration 10/sqrt(3) d/T^2
            T = max(float((1.875 * distance / (part * qd)).max()), float(np.sqrt(5.7735 * distance / (part * qdd)).max()))
            q, t = (np.array([where, q[0]]), np.array([0.0, T])) if where is not None and T > 1e-6 else (q, None)
        where = q[-1]
        if t is None:
            continue
        starts.append(clock)
        pieces.append(rest_to_rest_spline(q, t))
        places.append((s.file, int(s.lines[0])))
        clock += float(t[-1])
    if not pieces:
        raise BadInput("the program holds no timed motion")
    return ProgramMotion(np.array(starts), tuple(pieces), clock, tuple(places))


def pose_spline(poses: Array) -> tuple[Callable[[Array], Array], float]:
    """The curve through poses (n, 4, 4) that a spline block drives, over the chord length u in [0, L] m, and L.

    Positions and rotation vectors (against the middle pose) are quintic splines over the chord length.
    """
    p = poses[:, :3, 3]
    chord = np.linalg.norm(np.diff(p, axis=0), axis=1)
    keep = np.concatenate([[True], chord > 1e-7])
    middle = Rotation.from_matrix(poses[len(poses) // 2, :3, :3])
    turn = (middle.inv() * Rotation.from_matrix(poses[keep][:, :3, :3])).as_rotvec()
    u = np.concatenate([[0.0], np.cumsum(chord[keep[1:]])])
    curve = make_interp_spline(u, np.hstack([p[keep], turn]), k=min(5, 2 * ((len(u) - 1) // 2) + 1 if len(u) > 2 else 1))

    def evaluate(at: Array) -> Array:
        value = np.asarray(curve(np.clip(at, 0.0, u[-1])))
        return make_transform((middle * Rotation.from_rotvec(value[:, 3:])).as_matrix(), value[:, :3])

    return evaluate, float(u[-1])
