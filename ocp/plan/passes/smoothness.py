"""What couples the nodes of a pass: derivatives along the way, smoothness and removal as a quadratic form, axis limits."""

import numpy as np
import scipy.sparse as sp

from ocp.model.cell import Cell
from ocp.plan.passes.course import PassCourse
from ocp.plan.passes.problem import PassProblem
from ocp.plan.passes.stage import N_Z, ObjectiveWeights
from ocp.plan.passes.transcription import N_MOTION, REACH
from ocp.plan.rules import JERK_TIME
from robots.pose import Array
from robots.rigid_body import inverse_dynamics

CHANGE_TIME = 0.1  # s over which a change of rate or ratio counts in full


def node_times(course: PassCourse) -> Array:
    """Nominal time (n,) s that each node stands for."""
    half = 0.5 * np.diff(course.at)
    return np.concatenate([[0.0], half]) + np.concatenate([half, [0.0]])


def derivative_weights(at: Array) -> tuple[sp.csr_matrix, sp.csr_matrix]:
    """Matrices (n, n) of first and second derivatives at nodes `at` (n,), by parabolas through neighbours; zero at the ends."""
    n, h = len(at), np.diff(at)
    a, b = h[:-1], h[1:]
    first = np.column_stack([-b / (a * (a + b)), (b - a) / (a * b), a / (b * (a + b))])
    second = np.column_stack([2 / (a * (a + b)), -2 / (a * b), 2 / (b * (a + b))])
    rows = np.repeat(np.arange(1, n - 1), 3)
    columns = (np.arange(1, n - 1)[:, None] + np.arange(-1, 2)).ravel()
    made = [sp.csr_matrix((values.ravel(), (rows, columns)), shape=(n, n)) for values in (first, second)]
    return made[0], made[1]


def between_bends(at: Array) -> Array:
    """Parameter (n-1,) between the places of which neighbouring nodes `at` (n,) have the second derivative: a parabola through
    three nodes has that of their mean, however unevenly they lie."""
    return np.diff(np.concatenate([at[:1], (at[:-2] + at[1:-1] + at[2:]) / 3.0, at[-1:]]))


def quadratic_form(cell: Cell, problem: PassProblem, weights: ObjectiveWeights, n: int) -> tuple[sp.csc_matrix, Array]:
    """Q (N_Z n, N_Z n) and c (N_Z n,) of x'Qx/2 + c'x: smoothness of joints, rate and ratio; removal against what is wanted.

    Every term is a mean over the way's nominal time; the removal's over the asked stretch. Nodes beyond the problem's count
    are padding and cost nothing.
    """
    course, robot = problem.way, cell.robot
    count, total = len(course.at), float(np.ptp(course.at))
    share = sp.diags(node_times(course) / total)
    D2 = derivative_weights(course.at)[1]
    step = sp.csr_matrix(sp.diags([-np.ones(count - 1), np.ones(count - 1)], [0, 1], shape=(count - 1, count)))
    h = np.diff(course.at)
    between = sp.diags(h / total)
    if course.entry is not None:
        # At rest at both ends: the way goes on as its mirror image.
        ends = sp.csr_matrix(
            (
                [-2 / h[0] ** 2, 2 / h[0] ** 2, 2 / h[-1] ** 2, -2 / h[-1] ** 2],
                ([0, 0, -1 % count, -1 % count], [0, 1, count - 2, count - 1]),
            ),
            shape=(count, count),
        )
        D2 = D2 + ends
    rate1 = sp.diags(1.0 / h) @ step
    smooth = ((weights.speed, rate1.T @ between @ rate1, robot.qd_max), (weights.acceleration, D2.T @ share @ D2, robot.qdd_max))
    Q = sum(sp.kron(2 * w * form, sp.diags([*(1.0 / scale**2), 0.0, 0.0])) for w, form, scale in smooth)
    even = 2 * CHANGE_TIME**2 * (rate1.T @ between @ rate1)
    Q = Q + sp.kron(even, sp.diags([0.0] * 6 + [weights.even_rate, weights.even_ratio]))
    c = np.zeros(N_Z * n)
    if problem.depth is not None:
        part, c_r = _removal(problem, weights.removal)
        Q = Q + sp.kron(part, sp.diags([0.0] * 7 + [1.0]))
        c[7 : N_Z * count : N_Z] = c_r
    inside = Q.tocoo()
    return sp.csc_matrix((inside.data, (inside.row, inside.col)), shape=(N_Z * n, N_Z * n)), c


def _removal(problem: PassProblem, weight: float) -> tuple[sp.csr_matrix, Array]:
    """The removal's part of the quadratic form in the ratios: weight times the mean over the line of (M (r - 1))^2, M r what
    is taken off and M 1 what the line's force and feed were chosen for, all lines summed (ocp.plan.removal.dwell)."""
    course, M = problem.way, problem.depth
    assert M is not None
    on = course.touching
    s, m = course.s[on], on.stop - on.start
    near = np.abs(np.subtract.outer(np.arange(m), np.arange(m))) <= REACH // 2
    M = M * near
    edges = np.concatenate([s[:1], 0.5 * (s[1:] + s[:-1]), s[-1:]])
    omega = np.diff(edges) / (s[-1] - s[0])
    count = len(course.at)
    Q, c = np.zeros((count, count)), np.zeros(count)
    Q[on, on] = 2 * weight * M.T @ (omega[:, None] * M)
    c[on] = -Q[on, on] @ np.ones(m)
    return sp.csr_matrix(Q), c


def motion_of(course: PassCourse, q: Array, rate: Array) -> tuple[Array, Array]:
    """Speeds and accelerations (n, 6) of joints q (n, 6) at the nodes, driven at `rate` (n,) of the nominal one."""
    D1, D2 = derivative_weights(course.at)
    q1, q2 = D1 @ q, D2 @ q
    return q1 * rate[:, None], q2 * rate[:, None] ** 2 + 0.5 * q1 * (D1 @ rate**2)[:, None]


def axis_use(cell: Cell, course: PassCourse, q: Array, rate: Array) -> Array:
    """Speed, acceleration, gear torque and jerk up to the next node (n, 24) of the six axes at the nodes over their limits."""
    qd, qdd = motion_of(course, q, rate)
    payload, robot = cell.workpiece.payload, cell.robot
    torque = inverse_dynamics(robot, payload.mass, payload.com, q, qd, qdd)
    jerk = np.zeros_like(qdd)
    jerk[:-1] = np.diff(qdd, axis=0) * (0.5 * (rate[1:] + rate[:-1]) / between_bends(course.at))[:, None]
    limits = (robot.qd_max, robot.qdd_max, robot.torque_max, robot.qdd_max / JERK_TIME)
    return np.abs(np.hstack([use / limit for use, limit in zip((qd, qdd, torque, jerk), limits, strict=True)]))


def axis_rows(cell: Cell, course: PassCourse, q: Array, n: int) -> Array:
    """What the rows of axis limits know of each node (n, N_MOTION): weights of the derivatives, and the torque over its limit,
    linear in the acceleration about joints q (count, 6)."""
    D1, D2 = derivative_weights(course.at)
    count, payload, robot = len(course.at), cell.workpiece.payload, cell.robot
    qd = motion_of(course, q, np.ones(count))[0]

    def torque(qd: Array, qdd: Array) -> Array:
        return np.asarray(inverse_dynamics(robot, payload.mass, payload.com, q, qd, qdd)) / robot.torque_max

    still = np.zeros_like(q)
    rest = torque(still, still)
    inertia = np.stack([torque(still, still + unit) - rest for unit in np.eye(6)], axis=1)  # (count, acceleration, torque)
    rows = np.zeros((n, N_MOTION))
    inner = np.arange(1, count - 1)
    for column, D in ((0, D1), (3, D2)):
        for i in range(3):
            rows[inner, column + i] = np.asarray(D[inner, inner + i - 1]).ravel()
    rows[:count, 6:42] = inertia.reshape(count, 36)
    rows[:count, 42:48] = torque(qd, still)
    rows[: count - 1, 48:54] = rows[1:count, :6]
    rows[: count - 1, 54] = 1.0 / between_bends(course.at)
    return rows
