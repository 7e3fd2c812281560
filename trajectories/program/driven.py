"""What a controller makes of a program that was read: axes over time, from blocks with times, poses and straight motions.

A block that begins and ends at rest is driven along a curve of about fifth order through its points (quintic spline, C4).
Straight motions that blend follow their polygon with rounded corners. The controller's own curves are not published.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.interpolate import BSpline, make_interp_spline
from scipy.spatial.transform import Rotation

from robots.errors import BadInput
from robots.inverse import inverse_branches, status
from robots.kinematics import forward
from robots.pose import Array, invert, make_transform
from robots.robot import Robot
from trajectories.joint_trajectory import SAMPLE
from trajectories.program.execution import Execution, Frames, PathBounds, ProgramSegment

POSE_STEP = 2e-3  # s between the poses of a timed block for which axes are worked out; the curve is then good to 1e-9 rad
AXIS_PART = 0.5  # of an axis' acceleration for changes of speed along a path; the rest is for its bends
STOOD = np.radians(1e-3)  # rad; nearer than this the robot stands where it is sent: poses are printed that well


def rest_to_rest_spline(q: Array, t: Array) -> BSpline:
    """Quintic spline through q (n, m) at times t (n,) with speed and acceleration zero at both ends."""
    rest = [(1, np.zeros(q.shape[1])), (2, np.zeros(q.shape[1]))]
    return make_interp_spline(t, q, k=5, bc_type=(rest, rest))


def _flat(poses: Array) -> Array:
    """Positions and quaternions (n, 7) of poses (n, 4, 4), each quaternion with the sign that is nearer to the one before."""
    quaternion = Rotation.from_matrix(poses[:, :3, :3]).as_quat()
    sign = np.sign(np.einsum("ij,ij->i", quaternion[1:], quaternion[:-1]))
    quaternion[1:] *= np.cumprod(sign)[:, None]
    return np.hstack([poses[:, :3, 3], quaternion])


def _posed(flat: Array) -> Array:
    return make_transform(Rotation.from_quat(flat[:, 3:]).as_matrix(), flat[:, :3])


def pose_curve(poses: Array, t: Array) -> Callable[[Array], Array]:
    """The curve through poses (n, 4, 4) at times t (n,) s, from rest to rest: positions and quaternions are quintic splines."""
    curve = rest_to_rest_spline(_flat(poses), t)
    return lambda at: _posed(np.asarray(curve(at)))


def path_peaks(poses: Array, period: float = SAMPLE) -> PathBounds:
    """Largest speeds and accelerations of the origin and of the axes of poses (n, 4, 4) that are `period` s apart, n > 2."""
    turn = Rotation.from_matrix(np.swapaxes(poses[:-1, :3, :3], 1, 2) @ poses[1:, :3, :3]).as_rotvec()
    rates = [np.diff(poses[:, :3, 3], axis=0) / period, turn / period]
    found = [np.linalg.norm(v, axis=1).max() for rate in rates for v in (rate, np.diff(rate, axis=0) / period)]
    return PathBounds(*map(float, found))


def axes_along(robot: Robot, frames: Frames, poses: Array, near: Array) -> Array:
    """Axes (n, 6) rad of the nominal arm along programmed poses (n, 4, 4): the branch of `near` (6,), no jump of a turn, nan
    where it does not reach. `frames` as known."""
    q = inverse_branches(robot, frames.flange(poses))[0][:, int(status(robot, near))]
    return np.asarray(np.unwrap(np.vstack([near, q]), axis=0)[1:])


def programmed_poses(frames: Frames, robot: Robot, q: Array) -> Array:
    """The poses (n, 4, 4) that a program would give for axes q (n, 6) rad."""
    assert frames.tool is not None and frames.base is not None
    seen = invert(frames.base) @ forward(robot, q) @ frames.tool
    return invert(seen) if frames.external_tcp else seen


def block_axes(segment: ProgramSegment, robot: Robot, where: Array | None) -> BSpline:
    """Axes (6,) rad over the time s of a timed block; `where` (6,): the posture before a block of poses.

    Raises BadInput, naming file and line: a block of poses whose frames or posture are not known, or that the arm cannot reach.
    """
    assert segment.times is not None
    if segment.q is not None:
        return rest_to_rest_spline(segment.q, segment.times)
    assert segment.poses is not None
    if where is None or segment.frames.tool is None or segment.frames.base is None:
        raise BadInput(f"{segment.place()}: where the {segment.word} begins is not known; tool, base and full axes come first")
    fine = np.linspace(0.0, segment.times[-1], int(np.ceil(segment.times[-1] / POSE_STEP)) + 8)
    poses = pose_curve(segment.poses, segment.times)(fine)
    q = axes_along(robot, segment.frames, poses, where)
    lost = np.flatnonzero(np.isnan(q).any(axis=1))
    if len(lost):
        i = min(int(np.searchsorted(segment.times, fine[lost[0]])), len(segment.times) - 1)
        raise BadInput(f"{segment.place(i)}: the arm {robot.name} does not reach this pose; plan it nearer to the robot")
    return rest_to_rest_spline(q, fine)


@dataclass(frozen=True)
class ProgramMotion:
    """The motion of a timed program as read back: pieces (start s, spline) one after the other."""

    starts: Array
    pieces: tuple[BSpline, ...]
    duration: float

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


def reinterpolate(execution: Execution, robot: Robot, part: float = 0.1) -> ProgramMotion:
    """The axes over time that the program read back commands; its first posture is where the robot is taken to stand.

    Timed blocks keep their times. A move to a point takes as long as a smooth move needs at `part` of the robot's speeds and
    accelerations; one that goes nowhere takes no time. Raises BadInput for what the text does not time: see `drive_lines`.
    """
    starts, pieces, clock = [], [], 0.0
    where: Array | None = None
    for s in execution.segments:
        if s.times is not None:
            piece = block_axes(s, robot, where)
        elif s.kind == "point" and s.q is not None:
            distance = np.abs(s.q[0] - where) if where is not None else np.zeros(6)
            # quintic from rest to rest: peak speed 15/8 d/T, peak acceleration 10/sqrt(3) d/T^2
            T = float(np.sqrt(5.7735 * distance / (part * robot.qdd_max)).max())
            T = max(T, float((1.875 * distance / (part * robot.qd_max)).max()))
            begin, where = where, s.q[0]
            if begin is None or distance.max() < STOOD:
                continue
            piece = rest_to_rest_spline(np.array([begin, where]), np.array([0.0, T]))
        else:
            raise BadInput(f"{s.place()}: {s.word} has no times; only axis motions and blocks with times can be replayed")
        starts.append(clock)
        pieces.append(piece)
        clock += float(piece.t[-1])
        where = np.asarray(piece(piece.t[-1]))
    if not pieces:
        raise BadInput("the program holds no timed motion")
    return ProgramMotion(np.array(starts), tuple(pieces), clock)


@dataclass(frozen=True)
class DrivenLines:
    """Straight motions in a row that blend into one another, at `times` (m,) s: poses (m, 4, 4); `corners` (k,) s, when it is
    nearest to the k written poses, the first of them where the robot stands."""

    times: Array
    poses: Array
    corners: Array


def axis_gains(robot: Robot, poses: Array, q: Array) -> Array:
    """Acceleration (n - 1,) m/s^2 along the sides between poses (n, 4, 4), axes q (n, 6), that takes AXIS_PART of an axis'."""
    ways = np.linalg.norm(np.diff(poses[:, :3, 3], axis=0), axis=1)
    turned = np.maximum(np.abs(np.diff(q, axis=0)), 1e-12)
    return np.asarray(AXIS_PART * ways * (robot.qdd_max / turned).min(axis=1))


def drive_lines(chain: Sequence[ProgramSegment], begin: Array, gains: Array | None = None) -> DrivenLines:
    """Straight motions from the pose `begin` (4, 4) through one pose each to a stop, sampled every SAMPLE. `gains` (n,) m/s^2:
    what the axes leave of the acceleration on each way.

    Corners are rounded by parabolas that begin half the shorter side before them, as blending does at most. On each side the
    speed is at most its own and changes at most by the acceleration in force: it falls before a slower side and rises on a
    faster one.
    """
    poses = np.concatenate([begin[None], *(s.poses for s in chain if s.poses is not None)])
    ways = np.maximum(np.linalg.norm(np.diff(poses[:, :3, 3], axis=0), axis=1), 1e-9)
    u = np.concatenate([[0.0], np.cumsum(ways)])
    most, gain = (np.array([getattr(s.bounds, name) for s in chain]) for name in ("speed", "acceleration"))
    at, v = _speeds(u, most, gain if gains is None else np.minimum(gain, gains))
    when = np.concatenate([[0.0], np.cumsum(2.0 * np.diff(at) / (v[1:] + v[:-1]))])
    times = np.append(np.arange(0.0, when[-1], SAMPLE), when[-1])
    i = np.clip(np.searchsorted(when, times, side="right") - 1, 0, len(when) - 2)
    since = times - when[i]
    station = at[i] + since * (v[i] + 0.5 * since * (v[i + 1] - v[i]) / (when[i + 1] - when[i]))
    return DrivenLines(times, _posed(_round_corners(u, _flat(poses), station)), np.interp(u, at, when))


def _speeds(u: Array, most: Array, gain: Array) -> tuple[Array, Array]:
    """Stations and speeds between which acceleration is constant, along sides from u[k] to u[k + 1] with at most the speed
    most[k] and the acceleration gain[k]: every side is sped up along, driven at its speed, and slowed down along."""
    ways = np.diff(u)
    v2 = np.minimum(np.append(most, 0.0), np.append(0.0, most)) ** 2
    for k in range(1, len(u)):
        v2[k] = min(v2[k], v2[k - 1] + 2.0 * gain[k - 1] * ways[k - 1])
    for k in range(len(u) - 2, -1, -1):
        v2[k] = min(v2[k], v2[k + 1] + 2.0 * gain[k] * ways[k])
    peak = np.minimum(most**2, 0.5 * (v2[1:] + v2[:-1]) + gain * ways)
    ends = np.clip(np.stack([peak - v2[:-1], peak - v2[1:]]) / (2.0 * gain), 0.0, ways)
    at = np.append(np.stack([u[:-1], u[:-1] + ends[0], u[1:] - ends[1]], axis=1).ravel(), u[-1])
    speed = np.sqrt(np.append(np.stack([v2[:-1], peak, peak], axis=1).ravel(), 0.0))
    keep = np.append(True, np.diff(at) > 1e-12)
    return at[keep], speed[keep]


def _round_corners(u: Array, points: Array, at: Array) -> Array:
    """Points (m, k) at stations `at` (m,) of the polygon through `points` (n, k) at u (n,), its corners rounded: on the polygon
    lies a parabola r/4 (1 - |x|/r)^2 of the change of direction, x from the corner, r half the shorter side."""
    slope = np.diff(points, axis=0) / np.diff(u)[:, None]
    side = np.clip(np.searchsorted(u, at, side="right") - 1, 0, len(slope) - 1)
    on = points[side] + (at - u[side])[:, None] * slope[side]
    corner = np.where(at - u[side] < 0.5 * (u[side + 1] - u[side]), side, side + 1)
    turn = np.diff(slope, axis=0, prepend=slope[:1], append=slope[-1:])
    ways = np.diff(u)
    r = 0.5 * np.minimum(np.append(ways, ways[-1]), np.append(ways[0], ways))
    inside = np.clip(1.0 - np.abs(at - u[corner]) / r[corner], 0.0, 1.0)
    return np.asarray(on + (0.25 * r[corner] * inside**2)[:, None] * turn[corner])
