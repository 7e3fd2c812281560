"""The controller's own kinematics: the nominal arm forward, its Jacobian, an inverse by Newton steps, status and turn.

A controller knows the design numbers only. Everything is written from the MD-H table of the robot (docs/robot.md):
A_i = Rz(theta_i) Tz(d_i) Tx(a_i) Rx(alpha_i) Ry(beta_i), theta_i = sign_i q_i + offset_i.
"""

from itertools import product

import numpy as np
from scipy.spatial.transform import Rotation

from robots.pose import Array, make_transform, rot_x, rot_y, rot_z
from robots.robot import Robot

STEPS = 40  # Newton steps at most; from a neighbouring posture three are enough
CLOSE = 1e-10  # m and rad, where Newton's steps end
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
    """Joints along a path of poses (n, 4, 4) that begins near `start` (6,): no jump of branch. As `solve`."""
    knots = np.unique(np.append(np.arange(0, len(goal), coarse), len(goal) - 1))
    found = np.empty((len(knots), 6))
    q = start
    for k, index in enumerate(knots):
        q = solve_posture(robot, goal[index : index + 1], q[None])[0][0]
        found[k] = q
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
    for q in found[left < 1e-7]:
        q = (q + np.pi) % whole - np.pi
        turns = [
            [v for v in (x, x - whole, x + whole) if lo <= v <= hi] for x, lo, hi in zip(q, robot.q_min, robot.q_max, strict=True)
        ]
        for choice in product(*turns):
            s, t = status_turn(robot, np.array(choice))
            if s == status & 7 and (turn is None or t == turn):
                return np.array(choice)
    return None
