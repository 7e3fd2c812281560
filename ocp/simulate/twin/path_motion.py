"""LIN and SPLINE motions: a path of poses, the axes that follow it, and the speed that the axes allow, or the times that the
program gives; and for it the controller's own kinematics: the nominal arm forward, its Jacobian, an inverse by Newton steps,
status and turn.

A controller knows the design numbers only. Everything is written from the MD-H table of the robot (docs/robot.md):
A_i = Rz(theta_i) Tz(d_i) Tx(a_i) Rx(alpha_i) Ry(beta_i), theta_i = sign_i q_i + offset_i.

Under $IPO_MODE = #TCP a programmed pose is the pose of $BASE seen from $TOOL (KRL.md), and it is this pose that moves along the
path: FLANGE = BASE P^-1 TOOL^-1. Otherwise FLANGE = BASE P TOOL^-1.
"""

from collections.abc import Callable
from dataclasses import dataclass
from itertools import product

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import BSpline, CubicHermiteSpline, CubicSpline, make_interp_spline
from scipy.spatial.transform import Rotation

from ocp.simulate.twin.krl_text import DrivenMotion, ProgramFrames
from robots.errors import Infeasible
from robots.pose import Array, invert, make_transform, rot_x, rot_y, rot_z
from robots.robot import Robot

STEPS = 40  # Newton steps at most; from a neighbouring posture three are enough
CLOSE = 1e-10  # m and rad, where Newton's steps end
REACHED = 1e-7  # m and rad, from which on a pose counts as out of reach
REACH = 0.3  # rad, longest step of an axis


def frames(robot: Robot, q: Array) -> Array:
    """Link frames (n, 7, 4, 4) of the nominal arm, base and links 1..6, at joints q (n, 6)."""
    q = np.atleast_2d(q)
    T = np.empty((len(q), 7, 4, 4))
    T[:, 0] = np.eye(4)
    for i in range(6):
        offset, d, a, alpha, beta = robot.mdh[i]
        fixed = make_transform(rot_x(alpha) @ rot_y(beta), np.array([a, 0.0, d]))
        turned = make_transform(rot_z(robot.sign[i] * q[:, i] + offset), np.zeros(3))
        T[:, i + 1] = T[:, i] @ turned @ fixed
    return T


def flange(robot: Robot, q: Array) -> Array:
    """T_base_flange (n, 4, 4)."""
    return np.asarray(frames(robot, q)[:, 6])


def nominal_jacobian(robot: Robot, T: Array) -> Array:
    """Twist of the flange per joint speed (n, 6, 6): rows translation of the flange origin, rotation; base axes.

    T (n, 7, 4, 4) as `frames` gives it. Joint i turns about the z axis of frame i-1, in the sense of `sign`.
    """
    axis = robot.sign[:, None] * T[:, :6, :3, 2]
    arm = T[:, 6:7, :3, 3] - T[:, :6, :3, 3]
    return np.concatenate([np.cross(axis, arm), axis], axis=2).transpose(0, 2, 1)


def nominal_error(goal: Array, actual: Array) -> Array:
    """Translation and rotation vector (n, 6), base axes, that carry `actual` onto `goal`."""
    turn = Rotation.from_matrix(goal[:, :3, :3] @ actual[:, :3, :3].transpose(0, 2, 1)).as_rotvec()
    return np.concatenate([goal[:, :3, 3] - actual[:, :3, 3], turn], axis=1)


def solve_posture(robot: Robot, goal: Array, guess: Array) -> tuple[Array, Array]:
    """Joints (n, 6) that bring the nominal flange to `goal` (n, 4, 4), from `guess` (n, 6), and what is left (n,) m, rad."""
    q = np.array(np.broadcast_to(guess, (len(goal), 6)))
    left = np.full(len(goal), np.inf)
    for _ in range(STEPS):
        T = frames(robot, q)
        error = nominal_error(goal, T[:, 6])
        left = np.abs(error).max(axis=1)
        if left.max() < CLOSE:
            break
        J = nominal_jacobian(robot, T)
        # A little damping carries over wrist singularities; near the goal it is far below what is asked for.
        damping = np.minimum(1e-4, left**2)[:, None, None] * np.eye(6)
        step = np.linalg.solve(J.transpose(0, 2, 1) @ J + damping, J.transpose(0, 2, 1) @ error[..., None])[..., 0]
        longest = np.abs(step).max(axis=1, keepdims=True)
        q = q + step * np.minimum(1.0, REACH / np.maximum(longest, 1e-12))
    return q, left


def follow(robot: Robot, goal: Array, start: Array, coarse: int = 24) -> tuple[Array, Array]:
    """Joints along a path of poses (n, 4, 4) that begins near `start` (6,): no jump of branch. As `solve_posture`; from the first
    pose on that is out of reach, of every `coarse`-th, nothing is looked for any more and `left` is infinite."""
    knots = np.unique(np.append(np.arange(0, len(goal), coarse), len(goal) - 1))
    found = np.empty((len(knots), 6))
    q = start
    for k, index in enumerate(knots):
        there, left = solve_posture(robot, goal[index : index + 1], q[None])
        if left[0] > REACHED:
            return np.zeros((len(goal), 6)), np.where(np.arange(len(goal)) < index, 0.0, np.inf)
        q = found[k] = there[0]
    at = np.arange(len(goal))
    guess = np.stack([np.interp(at, knots, found[:, j]) for j in range(6)], axis=1)
    return solve_posture(robot, goal, guess)


def status_turn(robot: Robot, q: Array) -> tuple[int, int]:
    """Status and turn of joints q (6,) (KRL.md, "Axes, status, turn")."""
    a1, a2, a3, d4 = robot.mdh[0, 2], robot.mdh[1, 2], robot.mdh[2, 2], robot.mdh[3, 1]
    both = q[1] + q[2]
    overhead = a1 + a2 * np.cos(q[1]) + d4 * np.cos(both) + a3 * np.sin(both) < 0
    elbow = q[2] >= np.arctan2(a3, d4)
    wrist = -np.pi <= q[4] < 0 or q[4] >= np.pi
    return int(overhead) + 2 * int(elbow) + 4 * int(wrist), int(sum(1 << i for i in range(6) if q[i] < 0))


def inverse_by_status(robot: Robot, goal: Array, status: int, turn: int | None) -> Array | None:
    """The joints (6,) within the limits that reach `goal` (4, 4) with the given status and turn; None where there are none."""
    axes = ([-150, -90, -30, 30, 90, 150], [-110, -60], [-60, 30, 100], [-120, 0, 120], [-80, 80], [-90, 90])
    seeds = [np.array(s) for s in product(*(np.radians(a) for a in axes))]
    found, left = solve_posture(robot, np.broadcast_to(goal, (len(seeds), 4, 4)), np.array(seeds))
    whole = 2 * np.pi
    for q in found[left < REACHED]:
        q = (q + np.pi) % whole - np.pi
        turns = [
            [v for v in (x, x - whole, x + whole) if lo <= v <= hi] for x, lo, hi in zip(q, robot.q_min, robot.q_max, strict=True)
        ]
        for choice in product(*turns):
            s, t = status_turn(robot, np.array(choice))
            if s == status & 7 and (turn is None or t == turn):
                return np.array(choice)
    return None


FINE = 4e-3  # s between the poses of a timed block for which axes are worked out
STEP = 2.5e-4  # m along the path between the poses for which axes are worked out
SAME = 1e-7  # m; points nearer than this are one
DrivenPath = tuple[float, Callable[..., Array], tuple[Array, NDArray[np.int64]]]
SHARE = 0.98  # of an axis' speed that a path motion uses at most


def flange_poses(frames: ProgramFrames, P: Array) -> Array:
    """T_base_flange (n, 4, 4) of programmed poses P (n, 4, 4)."""
    return np.asarray(frames.base @ (invert(P) if frames.held else P) @ invert(frames.tool))


def programmed(frames: ProgramFrames, T: Array) -> Array:
    """The programmed poses of flange poses T (n, 4, 4)."""
    tool = invert(frames.base) @ T @ frames.tool
    return invert(tool) if frames.held else tool


def rest_to_rest(t: Array, q: Array) -> BSpline:
    """Fifth-order curve, four times smooth, through q (m, k) at t (m,), without speed and acceleration at its ends."""
    still = [(order, np.zeros(q.shape[1])) for order in (1, 2)]
    return make_interp_spline(t, q, k=5, bc_type=(still, still))


@dataclass(frozen=True)
class _Chart:
    """Poses as vectors (n, 6): place m, turn from the pose `middle` rad."""

    middle: Rotation

    @staticmethod
    def of(P: Array) -> "_Chart":
        return _Chart(Rotation.from_matrix(P[len(P) // 2, :3, :3]))

    def flat(self, P: Array) -> Array:
        return np.hstack([P[:, :3, 3], (self.middle.inv() * Rotation.from_matrix(P[:, :3, :3])).as_rotvec()])

    def poses(self, flat: Array) -> Array:
        return make_transform((self.middle * Rotation.from_rotvec(flat[:, 3:])).as_matrix(), flat[:, :3])


def drive_path(robot: Robot, chain: list[DrivenMotion], start: Array) -> DrivenPath | None:
    """A SPLINE, or LINs that blend into one another, from the joints `start` (6,): its duration s, q(t, nu), and when it passes
    which line of the program; None where it goes nowhere.

    Raises Infeasible: a pose out of reach.
    """
    first = chain[0]
    targets = [(motion, t) for motion in chain for t in motion.targets]
    begin = programmed(first.frames, flange(robot, start))[0]
    goals = [programmed(first.frames, flange(robot, np.asarray(t.q)))[0] if t.pose is None else t.pose for _, t in targets]
    P = np.array([begin, *goals])
    lines = np.array([first.line, *(t.line for _, t in targets)])
    chart = _Chart.of(P)
    points, paths = chart.flat(P), np.array([motion.path for motion, _ in targets])
    keep = np.concatenate([[True], _ways(points, paths) > SAME])
    points, lines, paths = points[keep], lines[keep], paths[keep[1:]]
    if len(points) < 2:
        return None
    u = np.concatenate([[0.0], np.cumsum(_ways(points, paths))])
    # Fifth order, or what the number of points allows.
    order = 5 if len(u) > 5 else 3 if len(u) > 3 else 1
    curve = make_interp_spline(u, points, k=order) if first.kind == "SPLINE" else _rounded(u, points)
    even = np.linspace(0.0, u[-1], max(8, int(np.ceil(u[-1] / STEP))) + 1)
    grid = even if first.kind == "SPLINE" else _with_sides(even, u, paths)
    q, left = follow(robot, flange_poses(first.frames, chart.poses(curve(grid))), start)
    if left.max() > REACHED:
        k = int(np.argmax(left))
        line = int(lines[min(int(np.searchsorted(u, grid[k])), len(lines) - 1)])
        raise Infeasible(f"{first.file}, line {line}: the arm {robot.name} cannot follow the path to this pose")
    joints = CubicSpline(grid, q)
    side = np.clip(np.searchsorted(u, 0.5 * (grid[1:] + grid[:-1])) - 1, 0, len(paths) - 1)
    law = _timing(robot, grid, joints, paths[side])

    def evaluate(time: Array, nu: int = 0) -> Array:
        u, v, a = law.at(np.asarray(time, float))
        if nu == 0:
            return np.asarray(joints(u))
        slope = joints(u, 1)
        return np.asarray(slope * v[..., None] if nu == 1 else joints(u, 2) * v[..., None] ** 2 + slope * a[..., None])

    return float(law.time[-1]), evaluate, (np.interp(u, grid, law.time), lines)


def timed_curve(robot: Robot, motion: DrivenMotion, times: Array, start: Array) -> BSpline:
    """The joints over time along the poses of a SPLINE at `times` (m,) s, from near `start` (6,), at rest at both ends.

    Raises Infeasible: a pose out of reach.
    """
    P = np.array([t.pose for t in motion.targets])
    chart = _Chart.of(P)
    fine = np.linspace(0.0, times[-1], max(int(np.ceil(times[-1] / FINE)), 8) + 1)
    poses = chart.poses(rest_to_rest(times, chart.flat(P))(fine))
    q, left = follow(robot, flange_poses(motion.frames, poses), start)
    if left.max() > REACHED:
        k = min(int(np.searchsorted(times, fine[int(np.argmax(left))])), len(times) - 1)
        raise Infeasible(
            f"{motion.file}, line {motion.targets[k].line}: the arm {robot.name} cannot follow the path to this pose"
        )
    return rest_to_rest(fine, q)


BOUNDED = ("$VEL.CP", "$ACC.CP", "$VEL.ORI1 or 2", "$ACC.ORI1 or 2")


def bounds_of_path(motion: DrivenMotion) -> str:
    """In a sentence, which bound of the path a timed SPLINE meets before its times; empty where none."""
    assert motion.times is not None
    P = np.array([t.pose for t in motion.targets])
    chart = _Chart.of(P)
    curve = rest_to_rest(motion.times, chart.flat(P))
    fine = np.linspace(0.0, motion.times[-1], 4 * len(P))
    R = Rotation.from_matrix(chart.poses(curve(fine))[:, :3, :3])
    turn = (R[:-1].inv() * R[1:]).as_rotvec() / np.diff(fine)[:, None]
    spin = np.diff(turn, axis=0) / np.diff(fine)[1:, None]
    needs = (curve(fine, nu=1)[:, :3], curve(fine, nu=2)[:, :3], turn, spin)
    for name, need, given in zip(BOUNDED, needs, motion.path, strict=True):
        if (most := float(np.linalg.norm(need, axis=1).max())) > given:
            return (
                f"{motion.file}, line {motion.line}: {name} lets {given:.4g} and this block needs {most:.4g} (m and rad); a "
                "controller would stretch the time there, and what was planned is not what it drives"
            )
    return ""


def _ways(points: Array, paths: Array) -> Array:
    """Length of the way to each point but the first; a turn counts by the time that it takes."""
    step = np.diff(points, axis=0)
    return np.maximum(np.linalg.norm(step[:, :3], axis=1), np.linalg.norm(step[:, 3:], axis=1) * paths[:, 0] / paths[:, 2])


def _with_sides(even: Array, u: Array, paths: Array) -> Array:
    """Stations with the corners u (n,) of a polygon, some on each of its sides, and where a change of speed begins or ends."""
    share = np.linspace(0.0, 1.0, 5)[:-1]
    inside = (u[:-1, None] + share * np.diff(u)[:, None]).ravel()
    speed, gain = np.concatenate([[0.0], paths[:, 0], [0.0]]), np.append(paths[:1, 1], paths[:, 1])
    changes = u + 0.5 * np.diff(speed**2) / gain  # rising on the side behind the corner, falling on that before it
    grid = np.unique(np.clip(np.concatenate([even, u[-1:], inside, changes]), u[0], u[-1]))
    return np.asarray(grid[np.append(True, np.diff(grid) > 1e-9)])


def _rounded(u: Array, points: Array) -> Callable[[Array], Array]:
    """A polygon whose corners are parabolas: from half the shorter side before a corner to as far behind it, as blends do at
    most. Between them it is straight, and speed along it is speed along u."""
    side = np.diff(u)
    reach = 0.5 * np.minimum(side[1:], side[:-1])
    knots = np.concatenate([[u[0]], np.column_stack([u[1:-1] - reach, u[1:-1] + reach]).ravel(), [u[-1]]])
    along = np.diff(points, axis=0) / side[:, None]
    # The slope is that of a side at both ends of it and linear between, where a corner is.
    slopes = np.repeat(along, 2, axis=0)
    way = np.vstack([points[:1], points[:1] + np.cumsum(0.5 * (slopes[1:] + slopes[:-1]) * np.diff(knots)[:, None], axis=0)])
    keep = np.append(np.diff(knots) > 0, True)
    return CubicHermiteSpline(knots[keep], way[keep], slopes[keep])


@dataclass(frozen=True)
class _Law:
    """Where on the path at what time: at `time` (n,) s stations (n,) m, speeds (n,) m/s, constant accelerations between."""

    time: Array
    station: Array
    speed: Array

    def at(self, t: Array) -> tuple[Array, Array, Array]:
        """Station, speed, acceleration at times t."""
        k = np.clip(np.searchsorted(self.time, t, side="right") - 1, 0, len(self.time) - 2)
        since = np.clip(t, 0.0, self.time[-1]) - self.time[k]
        a = (self.speed[k + 1] - self.speed[k]) / (self.time[k + 1] - self.time[k])
        return self.station[k] + since * (self.speed[k] + 0.5 * a * since), self.speed[k] + a * since, a


def _timing(robot: Robot, u: Array, joints: CubicSpline, paths: Array) -> _Law:
    """As fast as the paths (n - 1, 4) say of each interval and the axes allow, from rest to rest over the stations u (n,) m.

    With q' and q'' along the path an axis has the speed q' v and the acceleration q'' v^2 + q' a; each term gets half the limit.
    """
    slope, bend = (np.maximum(np.abs(joints(u, order)), 1e-12) for order in (1, 2))
    speed, gain = paths[:, 0], paths[:, 1]
    asked = np.minimum(np.append(speed, speed[-1]), np.append(speed[0], speed))  # where it changes the slower one
    limit = np.minimum(asked, SHARE * (robot.qd_max / slope).min(axis=1))
    v2 = np.minimum(limit**2, 0.5 * (robot.qdd_max / bend).min(axis=1))
    axes = 0.5 * (robot.qdd_max / slope).min(axis=1)
    a = np.minimum(gain, np.minimum(axes[1:], axes[:-1]))
    step = np.diff(u)
    v2[0] = v2[-1] = 0.0
    for k in range(1, len(u)):
        v2[k] = min(v2[k], v2[k - 1] + 2 * a[k - 1] * step[k - 1])
    for k in range(len(u) - 2, -1, -1):
        v2[k] = min(v2[k], v2[k + 1] + 2 * a[k] * step[k])
    v = np.sqrt(v2)
    return _Law(np.concatenate([[0.0], np.cumsum(2 * step / np.maximum(v[1:] + v[:-1], 1e-9))]), u, v)
