"""Ipopt on one pass: from a seed to joints that hold the force, or the constraint that forbids it."""

from dataclasses import dataclass, replace

import casadi as ca
import numpy as np

from ocp.contact.wheel.law import WheelLaw
from ocp.model.cell import Cell
from ocp.model.force_balance import Model, build_model
from ocp.model.theta import Theta
from ocp.plan.passes.posture import joints_near, poses_along, turned_curvature, wrist_radius
from ocp.plan.passes.problem import PassProblem, approach_signs
from ocp.plan.passes.stage import (
    N_CLEARANCE,
    N_PLAIN_ROWS,
    N_ROWS,
    N_Z,
    ROWS,
    ObjectiveWeights,
    Stage,
    build_stage,
    force_variance,
)
from ocp.plan.passes.stretches import CannotGrind
from ocp.plan.passes.transcription import Transcription, transcribe
from ocp.plan.rules import (
    AXIS_MARGIN,
    ELBOW_MARGIN,
    LEAST_INDENTATION,
    SHOULDER_MARGIN,
    SINGULARITY_SHARE,
    SPEED_SHARE,
    WRIST_MARGIN,
)
from robots.errors import Infeasible
from robots.pose import Array, invert
from trajectories.passes import BladePath

PAD = 32  # programs are built for multiples of this many waypoints and shared by passes of similar length
AIM_STEPS = 2  # each leaves a thousandth of the miss
FEASIBLE = 1e-5  # largest scaled violation of a row that counts as solved (0.01 um, 1e-5 rad)
WORST_SHARE = 0.1  # of the worst violation: where a row is broken by more, the pass is at fault and not the way to it
REMEDIES = (
    "widen tilt, turn or lateral tolerance or move the wheel",
    "widen the wheel's arc (contact_arc_deg) or move the wheel",
    "widen lateral_tolerance_mm or use a wider wheel",
    "widen turn_tolerance_deg or move the wheel",
    "widen tilt_tolerance_deg or use a narrower wheel",
    "widen tilt_tolerance_deg or use a narrower wheel",
    "move the wheel or the blade in its holder",
    "use a wheel of smaller radius or grind the other way (passes)",
    "use a narrower wheel, or one of smaller radius",
    *(("move the wheel or the blade in its holder",) * N_CLEARANCE),
)  # for each of ROWS


@dataclass(frozen=True)
class PassSolution:
    """Joints (n, 6) and force (n,) of a pass, how Ipopt got there, and its multipliers for a start close by."""

    q: Array
    force: Array
    iterations: int
    objective: float
    multipliers: tuple[Array, Array] | None = None


@dataclass(frozen=True)
class Evaluation:
    """What the model says of a path of n waypoints.

    delta, residual (n,) m; parts (n, 4) m: flange, wheel, blade, robot; arc, turn (n,) rad; lateral (n,) m; tilt (n, 2)
    slopes; curvature (n, 3) relative kxx, kyy, kxy 1/m; force_sd (n,) N; stiffness (n,) N/m of the whole chain;
    T_base_blade (n, 4, 4) of the bent, calibrated arm.
    """

    delta: Array
    residual: Array
    parts: Array
    arc: Array
    lateral: Array
    turn: Array
    tilt: Array
    curvature: Array
    force_sd: Array
    stiffness: Array
    T_base_blade: Array


class PassSolver:
    """The compiled model of a cell, solving pass after pass; programs are built once per padded length."""

    def __init__(self, cell: Cell, law: WheelLaw, theta: Theta, weights: ObjectiveWeights) -> None:
        self.cell, self.theta, self.weights = cell, theta, weights
        self.law, self.limits = law, law.limits
        self.sigma = cell.process.sigma
        self.model: Model = build_model(cell, law, self.sigma, uncertain=len(theta.values) > Theta.size)
        self.stage: Stage = build_stage(cell, self.model, weights, theta)
        self._programs: dict[tuple[int, bool], Transcription] = {}
        m = self.model
        slope = ca.jacobian(m.residual, m.F)
        known = [m.delta, m.residual, m.parts, m.arc, m.lateral, m.turn, m.tilt, m.curvature]
        outputs = [*known, ca.sqrt(force_variance(m, theta)), -1 / slope, ca.vec(m.T_base_blade.T)]
        self._evaluate = ca.Function("evaluate", [m.q, m.F, m.w, m.theta], outputs, {"cse": True})
        self._link_motion = ca.Function("link_motion", [m.q, m.w, m.theta], [m.q_real], {"cse": True})
        self._by_approach = any("approach" in e.active.effect.needs for e in cell.effects)

    def evaluate(self, problem: PassProblem, q: Array, force: Array) -> Evaluation:
        """The model at joints q (n, 6) and forces (n,)."""
        theta = np.tile(self.theta.values[:, None], len(q))
        out = self._evaluate.map(len(q))(q.T, force[None], self._waypoints(problem).T, theta)
        *numbers, pose = (np.asarray(o).T for o in out)
        values = [v[:, 0] if v.shape[1] == 1 else v for v in numbers]
        values.append(pose.reshape(-1, 4, 4))
        return Evaluation(*values)

    def _waypoints(self, problem: PassProblem) -> Array:
        """The problem's waypoints, with the conditions of the cell's effects."""
        return np.hstack([problem.waypoints, problem.conditions(self.cell)])

    def with_approach(self, problem: PassProblem, q: Array | None = None) -> PassProblem:
        """The problem with the directions in which the links turn at commanded joints q (n, 6), by default the seed's; as it is
        where no effect asks."""
        if not self._by_approach:
            return problem
        joints = self.seed_joints(problem) if q is None else q
        n = len(joints)
        real = self._link_motion.map(n)(joints.T, self._waypoints(problem).T, np.tile(self.theta.values[:, None], n))
        return replace(problem, approach=approach_signs(np.asarray(real).T, problem.path.s))

    def program(self, n: int, full: bool = False) -> Transcription:
        """The nonlinear program for n waypoints, padded."""
        key = (-(-n // PAD) * PAD, full)
        if key not in self._programs:
            self._programs[key] = transcribe(self.stage, *key)
        return self._programs[key]

    def solve(self, problem: PassProblem, start: PassSolution | None = None) -> PassSolution:
        """Joints that hold the programmed force along the pass; `start` is the solution of a problem close by.

        Raises Infeasible naming waypoint, constraint and amount.
        """
        solution = self._solve(problem, start, full=False)
        if self._breaks_lazy_rows(problem, solution.q):
            solution = self._solve(problem, replace(solution, multipliers=None), full=True)
        return solution

    def seed_joints(self, problem: PassProblem) -> Array:
        """Joints (n, 6) that lie on the wheel as the seed does, with about the overlap that the force needs."""
        path = problem.path
        kxx, kyy, kxy = turned_curvature(path.curvature, np.array(problem.seed.turn), self.cell.wheel.radius)
        zero = np.zeros(len(path.s))
        overlap = self.law.evaluate(path.force, np.maximum(kxx, self.limits["kxx"][0]), kyy, kxy, zero, zero, zero)
        goal = poses_along(self.cell, path, problem.seed, overlap + problem.indentation_correction, self.sigma)
        commanded = goal
        # The real arm sags by millimetres, a twentieth of a small wheel's arc: aim off by what it misses.
        for _ in range(AIM_STEPS):
            q = joints_near(self.cell, path, problem.seed, commanded)
            real = self.evaluate(problem, q, path.force).T_base_blade
            commanded = goal @ invert(real) @ commanded
        return joints_near(self.cell, path, problem.seed, commanded)

    def _breaks_lazy_rows(self, problem: PassProblem, q: Array) -> bool:
        """Does a solution without the rows of clearance and speed break one of them?"""
        rows = np.einsum("kij,kj->ki", problem.clearances[..., :6], q) - problem.clearances[..., 6]
        seconds = problem.seconds[:, None]
        return bool(rows.min() < 0 or (np.abs(np.diff(q, axis=0)) > SPEED_SHARE * seconds * self.cell.robot.qd_max).any())

    def _solve(self, problem: PassProblem, start: PassSolution | None, full: bool) -> PassSolution:
        path = problem.path
        n = len(path.s)
        program = self.program(n, full)
        q0 = self.seed_joints(problem) if start is None else start.q
        x0 = np.column_stack([_padded(q0, program.n), _padded(path.force, program.n)])
        lbx, ubx = self._bounds(problem, program.n)
        lbg, ubg = self._row_bounds(problem, program.n, full)
        p = Transcription.pack(*self._parameters(problem, program.n))
        x0 = np.clip(x0.ravel(), lbx, ubx)
        data = {"x0": x0, "lbx": lbx, "ubx": ubx, "lbg": lbg, "ubg": ubg, "p": p}
        solver = program.solver
        if start is not None and start.multipliers is not None and len(start.multipliers[1]) == len(lbg):
            solver = program.again
            data |= {"lam_x0": start.multipliers[0], "lam_g0": start.multipliers[1]}
        result = solver(**data)
        stats = solver.stats()
        x = np.asarray(result["x"]).reshape(program.n, N_Z)[:n]
        g = np.asarray(result["g"]).ravel()
        refuse_violated(path, np.maximum(lbg - g, g - ubg), full, stats["return_status"])
        solved = stats["success"] or stats["return_status"] == "Maximum_Iterations_Exceeded"
        if not (solved and np.isfinite(x).all()):
            raise Infeasible(f"line {path.line} ({path.side}): the optimiser stopped with {stats['return_status']}")
        multipliers = np.asarray(result["lam_x"]).ravel(), np.asarray(result["lam_g"]).ravel()
        return PassSolution(x[:, :6], x[:, 6], int(stats["iter_count"]), float(result["f"]), multipliers)

    def _bounds(self, problem: PassProblem, n: int) -> tuple[Array, Array]:
        """Bounds of the variables: axis limits with margin, the seed's side of wrist and elbow, the force."""
        robot, seed = self.cell.robot, problem.seed
        low, high = robot.q_min + AXIS_MARGIN, robot.q_max - AXIS_MARGIN
        elbow = float(np.arctan2(robot.mdh[2, 2], robot.mdh[3, 1]))
        for axis, singular, margin in ((4, 0.0, WRIST_MARGIN), (2, elbow, ELBOW_MARGIN)):
            if seed.q[0, axis] > singular:
                low[axis] = max(low[axis], singular + SINGULARITY_SHARE * margin)
            else:
                high[axis] = min(high[axis], singular - SINGULARITY_SHARE * margin)
        force = _padded(problem.path.force, n)[:, None]
        return (np.hstack([np.tile(low, (n, 1)), force]).ravel(), np.hstack([np.tile(high, (n, 1)), force]).ravel())

    def _row_bounds(self, problem: PassProblem, n: int, full: bool) -> tuple[Array, Array]:
        """Bounds of the rows in the order of `ocp.plan.passes.stage.ROWS`, then of the joint steps."""
        process, wheel = self.cell.process, self.cell.wheel
        slope = np.tan(process.tilt_tolerance)
        low, high = np.full(N_ROWS, -np.inf), np.full(N_ROWS, np.inf)
        low[0] = high[0] = 0.0
        low[1], high[1] = wheel.arc
        lateral = min(process.lateral_tolerance, 0.5 * wheel.width)
        for row, half, name in ((2, lateral, "lateral"), (4, slope, "tilt_x"), (5, slope, "tilt_y")):
            limit = self.limits.get(name, (-np.inf, np.inf))
            low[row], high[row] = max(-half, limit[0]), min(half, limit[1])
        turn = min(process.turn_tolerance, problem.turn_limit)
        low[3], high[3] = -turn, turn
        low[6] = SINGULARITY_SHARE * SHOULDER_MARGIN
        low[7], high[7] = self.limits.get("kxx", (0.0, np.inf))
        low[8] = 1e3 * LEAST_INDENTATION
        low[9:] = 0.0
        if not full:
            return np.tile(low[:N_PLAIN_ROWS], n), np.tile(high[:N_PLAIN_ROWS], n)
        step = np.full((n - 1, 6), np.inf)
        step[: len(problem.path.s) - 1] = SPEED_SHARE * problem.seconds[:, None] * self.cell.robot.qd_max
        return np.concatenate([np.tile(low, n), -step.ravel()]), np.concatenate([np.tile(high, n), step.ravel()])

    def _parameters(self, problem: PassProblem, n: int) -> tuple[Array, Array, Array, Array]:
        """Stage parameters, theta and the weights of first and second differences."""
        path, robot = problem.path, self.cell.robot
        count = len(path.s)
        sign = 1.0 if wrist_radius(self.cell, problem.seed.q[0]) > 0 else -1.0
        par = np.column_stack(
            [self._waypoints(problem), problem.clearances.reshape(count, -1), np.full(count, sign), np.full(count, 1.0 / count)]
        )
        assert par.shape[1] == self.stage.n_parameters
        seconds = problem.seconds
        first, second = np.zeros((n - 1, 6)), np.zeros((n - 2, 6))
        first[: count - 1] = self.weights.speed / count / (seconds[:, None] * robot.qd_max) ** 2
        second[: count - 2] = self.weights.acceleration / count / (seconds[1:, None] ** 2 * robot.qdd_max) ** 2
        return _padded(par, n), self.theta.values, first, second


def refuse_violated(path: BladePath, violation: Array, full: bool, status: str) -> None:
    """Raises CannotGrind with the worst row of a pass as a sentence, if `violation` of any is more than FEASIBLE.

    violation: of the rows of `ocp.plan.passes.stage.ROWS` at all waypoints, padded ones included, then (`full`) of the joint
    steps between them; `status` of the optimiser.
    """
    rows = N_ROWS if full else N_PLAIN_ROWS
    if violation.max() <= FEASIBLE:
        return
    n = (len(violation) + 6 * full) // (rows + 6 * full)
    stage = violation[: rows * n].reshape(n, rows)[: len(path.s)]
    steps = violation[rows * n :].reshape(-1, 6)
    k, row = (int(i) for i in np.unravel_index(int(np.argmax(stage)), stage.shape))
    if full and steps.max() > stage.max():
        k, axis = (int(i) for i in np.unravel_index(int(np.argmax(steps)), steps.shape))
        where = np.append(steps.max(axis=1) > WORST_SHARE * steps.max(), False)[: len(path.s)]
        reason = (
            f"axis {axis + 1} would have to move {np.degrees(steps[k, axis]):.3f} deg more per step than its speed allows at the "
            "programmed feed"
        )
        raise CannotGrind.of(path, where, reason, "lower the feed", k, _told(path, k, reason, "lower the feed"))
    name, unit, factor = ROWS[row]
    reason = f"{name} cannot be met, {stage[k, row] * factor:.3g} {unit} are missing (optimiser: {status})"
    where = stage.max(axis=1) > WORST_SHARE * stage.max()
    if status == "Maximum_Iterations_Exceeded":  # it was still on its way: what is violated yet says nothing of the place
        where[:] = False
    raise CannotGrind.of(path, where, reason, REMEDIES[row], k, _told(path, k, reason, REMEDIES[row]))


def _told(path: BladePath, k: int, reason: str, remedy: str) -> str:
    return f"line {path.line} ({path.side}), waypoint {k + 1} of {len(path.s)}: {reason}; {remedy}"


def _padded(values: Array, n: int) -> Array:
    """Repeat the last row up to n rows."""
    values = np.asarray(values, float)
    tail = np.repeat(values[-1:], n - len(values), axis=0)
    return np.concatenate([values, tail])
