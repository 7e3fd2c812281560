"""Three ways to solve one grinding pass, for `benchmarks/plan.py`, and one judge for all of them.

The product's own transcription; the same program as one writes it first in CasADi's Opti; inverse kinematics with the
overlap of every pose corrected. All take the same model, seed, bounds, weights and tolerances.
"""

import time
from collections.abc import Callable

import casadi as ca
import numpy as np

from ocp.plan.passes.optimise import Ground
from ocp.plan.passes.posture import joints_near, poses_along
from ocp.plan.passes.problem import PassProblem
from ocp.plan.passes.solve import PassSolver
from ocp.plan.passes.stage import N_PLAIN_ROWS, N_Z
from ocp.plan.passes.transcription import IPOPT
from robots.pose import Array

FORCE_SETTLED = 1e-6  # N: where the correction of the overlap stops
MOST_CORRECTIONS = 50

Answer = tuple[Array, float, float, int]  # joints (n, 6), build s, solve s, iterations


def product(solver: PassSolver, problem: PassProblem) -> Answer:
    """The product's own transcription."""
    start = time.perf_counter()
    solver.program(len(problem.path.s))
    build = time.perf_counter() - start
    solution = solver.solve(problem)
    return solution.q, build, time.perf_counter() - start - build, solution.iterations


def opti(solver: PassSolver, problem: PassProblem, expand: bool) -> Answer:
    """The same program as one writes it first: Opti, the model called at every waypoint, derivatives by default."""
    start = time.perf_counter()
    n = len(problem.path.s)
    par, theta, first, second = solver._parameters(problem, n)
    low, high = (b.reshape(n, N_Z)[0, :6] for b in solver._bounds(problem, n))
    row_low, row_high = (b.reshape(n, N_PLAIN_ROWS)[0] for b in solver._row_bounds(problem, n, False))
    program, cost = ca.Opti(), ca.MX(0)
    Q = program.variable(6, n)
    bounded = [i for i in range(1, N_PLAIN_ROWS) if np.isfinite(row_low[i]) or np.isfinite(row_high[i])]
    for k in range(n):
        value, rows = solver.stage.value(ca.vertcat(Q[:, k], problem.path.force[k]), par[k], theta)
        cost += value
        program.subject_to(rows[0] == 0)
        program.subject_to(program.bounded(row_low[bounded], rows[bounded], row_high[bounded]))
        program.subject_to(program.bounded(low, Q[:, k], high))
        if k > 0:
            cost += ca.dot(first[k - 1], (Q[:, k] - Q[:, k - 1]) ** 2)
        if k > 1:
            cost += ca.dot(second[k - 2], (Q[:, k] - 2 * Q[:, k - 1] + Q[:, k - 2]) ** 2)
    program.minimize(cost)
    program.set_initial(Q, np.clip(solver.seed_joints(problem), low, high).T)
    program.solver("ipopt", {"expand": expand, "print_time": False, "record_time": True}, IPOPT)
    q = program.solve().value(Q).T
    seconds, stats = time.perf_counter() - start, program.stats()
    return q, seconds - stats["t_wall_total"], stats["t_wall_total"], stats["iter_count"]


def kinematic(solver: PassSolver, problem: PassProblem) -> Answer:
    """Inverse kinematics on the seed's arc and turn, the overlap of each pose corrected until the force is right."""
    start, path = time.perf_counter(), problem.path
    overlap = np.zeros(len(path.s))
    for step in range(1, MOST_CORRECTIONS + 1):
        q = joints_near(solver.cell, path, problem.seed, poses_along(solver.cell, path, problem.seed, overlap, solver.sigma))
        now = solver.evaluate(problem, q, path.force)
        if step == MOST_CORRECTIONS or np.abs(now.residual * now.stiffness).max() < FORCE_SETTLED:
            break
        overlap = overlap - now.residual
    return q, 0.0, time.perf_counter() - start, step


def judged(solver: PassSolver, problem: PassProblem, q: Array) -> str:
    """Force error N, largest axis step deg, acceleration over its limit, rows outside their bounds, objective."""
    n, path = len(q), problem.path
    now = solver.evaluate(problem, q, path.force)
    par, theta, first, second = solver._parameters(problem, n)
    z = np.column_stack([q, path.force])
    value, rows = (np.asarray(v) for v in solver.stage.value.map(n)(z.T, par.T, np.tile(theta[:, None], n)))
    low, high = (b.reshape(n, N_PLAIN_ROWS) for b in solver._row_bounds(problem, n, False))
    outside = np.maximum(low - rows.T[:, :N_PLAIN_ROWS], rows.T[:, :N_PLAIN_ROWS] - high)[:, 1:] > 1e-5
    step, bend = np.diff(q, axis=0), np.diff(q, 2, axis=0)
    share = np.abs(bend) / problem.seconds[1:, None] ** 2 / solver.cell.robot.qdd_max
    cost = value.sum() + (first * step**2).sum() + (second * bend**2).sum()
    force = np.abs(now.residual * now.stiffness).max()
    return f"{force:11.1e}{np.degrees(np.abs(step).max()):10.4f}{share.max():10.4f}{outside.sum():9d}{cost:11.5f}"


METHODS: dict[str, Callable[[PassSolver, PassProblem], Answer]] = {
    "product": product,
    "Opti": lambda solver, problem: opti(solver, problem, False),
    "Opti, expand": lambda solver, problem: opti(solver, problem, True),
    "kinematic": kinematic,
}
HEADER = (
    f"{'':14}{'build s':>9}{'solve s':>9}{'its':>6}{'force N':>11}{'step deg':>10}{'accel':>10}{'outside':>9}{'objective':>11}"
)


def row(ground: Ground, problem: PassProblem, name: str) -> str:
    """A row of the table below HEADER: one method on one problem."""
    solver = PassSolver(ground.cell, ground.law, ground.theta, ground.weights)
    q, build, solve, iterations = METHODS[name](solver, problem)
    return f"{name:14}{build:9.2f}{solve:9.2f}{iterations:6d}{judged(solver, problem, q)}"
