"""Ipopt on one pass: from a seed to joints that hold the force, or the constraint that forbids it."""

from copy import copy
from dataclasses import dataclass, replace
from typing import Any

import casadi as ca
import numpy as np

from ocp.contact.wheel.law import WheelLaw
from ocp.model.cell import Cell, held_by_friction
from ocp.model.force_balance import Model, bending, build_model
from ocp.model.theta import Theta
from ocp.plan.passes.posture import joints_near, poses_along, turned_curvature, wrist_radius
from ocp.plan.passes.problem import PassProblem, approach_signs
from ocp.plan.passes.smoothness import axis_rows, axis_use, node_times, quadratic_form
from ocp.plan.passes.stage import (
    N_CLEARANCE,
    N_PLAIN_ROWS,
    N_ROWS,
    N_Z,
    ROWS,
    ObjectiveWeights,
    Stage,
    build_stage,
    force_sensitivity,
    scatter_root,
)
from ocp.plan.passes.stretches import CannotGrind
from ocp.plan.passes.transcription import IPOPT, N_DYNAMIC, Transcription, transcribe
from ocp.plan.rules import (
    AXIS_MARGIN,
    ELBOW_MARGIN,
    JERK_TIME,
    LEAST_INDENTATION,
    PEAK_FORCE,
    SHOULDER_MARGIN,
    SINGULARITY_SHARE,
    SPEED_SHARE,
    WRIST_MARGIN,
)
from ocp.shell.native import ColumnFunction, compile_together
from robots.errors import Infeasible
from robots.pose import Array, invert
from trajectories.passes import BladePath

PAD = 32  # programs are built for multiples of this many waypoints, short ones of half, and shared by passes of similar length
AIM_STEPS = 2  # each leaves a thousandth of the miss
LONG_TRIED = 60_000  # iterations of nodes that the virtual machine does before machine code is made: half a minute
RELINEARISED = 4  # solutions with axis limits, each with the torque linear about the one before
LEAST_RATE = 0.05  # of the nominal one
RATIO_RANGE = (0.7, 1.3)  # of force over feed over its programmed value
TURN_KEPT = 0.9  # of the turn that a line is to be ground with
# rad of turn that is left free at any tolerance: feed directions scatter by half of it, laid lines' too, and axes that have to
# follow every scatter cannot keep the feed
LEAST_TURN = np.radians(0.1)
FULL_BEARING = 0.5  # of the force, from which on the wheel has to overlap the planned point
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
    """Joints (n, 6), rate of the path parameter (n,), force over feed (n,), each over its nominal one, and force (n,) N of a
    pass, how Ipopt got there, and its multipliers at the nodes, of bounds (n, N_Z) and of rows, for a start close by; limited:
    with the rows of clearance and axis limits."""

    q: Array
    rate: Array
    ratio: Array
    force: Array
    iterations: int
    objective: float
    multipliers: tuple[Array, Array] | None = None
    limited: bool = False


@dataclass(frozen=True)
class Evaluation:
    """What the model says of a path of n waypoints.

    delta, residual (n,) m; parts (n, 4) m: flange, wheel, blade, robot; arc, turn (n,) rad; lateral (n,) m; tilt (n, 2)
    slopes; curvature (n, 3) relative kxx, kyy, kxy 1/m; stiffness (n,) N/m of the whole chain; T_base_blade (n, 4, 4) of the
    bent, calibrated arm; force_sd (n,) N.
    """

    delta: Array
    residual: Array
    parts: Array
    arc: Array
    lateral: Array
    turn: Array
    tilt: Array
    curvature: Array
    stiffness: Array
    T_base_blade: Array
    force_sd: Array


class PassSolver:
    """The compiled model of a cell, solving pass after pass; programs are built once per padded length.

    `folded`: theta's values are part of the programs; without, one solver serves `other` cells of its kind. `derived`: the
    stage's functions, from a solver of the same in another process.
    """

    def __init__(
        self,
        cell: Cell,
        law: WheelLaw,
        theta: Theta,
        weights: ObjectiveWeights,
        folded: bool = True,
        derived: dict[str, Any] | None = None,
    ) -> None:
        self.cell, self.theta, self.weights = cell, theta, weights
        self.law, self.limits = law, law.limits
        self.sigma = cell.process.sigma
        self.folded = folded
        self.model: Model = build_model(cell, law, self.sigma, len(theta.values) > Theta.size, any_bend=not folded)
        self.stage: Stage = build_stage(cell, self.model, weights, theta, folded)
        vars(self.stage).update(derived or {})
        self._programs: dict[tuple[int, bool], Transcription] = {}
        self._iterated = 0
        m = self.model
        slope = ca.jacobian(m.residual, m.F)
        known = [m.delta, m.residual, m.parts, m.arc, m.lateral, m.turn, m.tilt, m.curvature]
        outputs = [*known, -1 / slope, ca.vec(m.T_base_blade.T), force_sensitivity(m)]
        self._root = scatter_root(theta)
        self._evaluate = ColumnFunction(ca.Function("evaluate", [m.q, m.F, m.w, m.theta], outputs, {"cse": True}))
        self._link_motion = ca.Function("link_motion", [m.q, m.w, m.theta], [m.q_real], {"cse": True})
        self._by_approach = any("approach" in e.active.effect.needs for e in cell.effects)

    def other(self, cell: Cell, law: WheelLaw, theta: Theta) -> "PassSolver":
        """This solver, not `folded`, with the parameters of another calibration of its cell; cell and law have them folded in."""
        own = copy(self)
        own.cell, own.law, own.limits, own.theta, own._root = cell, law, law.limits, theta, scatter_root(theta)
        return own

    def compile(self, quietly: bool = False) -> None:
        """Have machine code made of what a pass evaluates, where there is none yet; quietly: `compile_together`."""
        compile_together([*self.stage.functions, self._evaluate], quietly)

    def evaluate(self, problem: PassProblem, q: Array, force: Array) -> Evaluation:
        """The model at joints q (n, 6) and forces (n,)."""
        theta = np.tile(self.theta.values[:, None], len(q))
        out = self._evaluate.map(len(q))(q.T, force[None], self._waypoints(problem).T, theta)
        *numbers, pose, sensitivity = (np.asarray(o).T for o in out)
        values = [v[:, 0] if v.shape[1] == 1 else v for v in numbers]
        sd = np.sqrt(np.square(np.einsum("ni,ri->nr", sensitivity, self._root)).sum(axis=1) + held_by_friction(self.cell) ** 2)
        return Evaluation(*[*values, pose.reshape(-1, 4, 4), sd])

    def _waypoints(self, problem: PassProblem) -> Array:
        """The problem's waypoints, with the conditions of the cell's effects and, where no cell is folded in, what bends."""
        more = [] if self.folded else [np.tile(bending(self.cell), (len(problem.waypoints), 1))]
        return np.hstack([problem.waypoints, problem.conditions(self.cell), *more])

    def with_approach(self, problem: PassProblem, q: Array | None = None) -> PassProblem:
        """The problem with the directions in which the links turn at commanded joints q (n, 6), by default the seed's; as it is
        where no effect asks."""
        if not self._by_approach:
            return problem
        joints = self.seed_joints(problem) if q is None else q
        n = len(joints)
        real = self._link_motion.map(n)(joints.T, self._waypoints(problem).T, np.tile(self.theta.values[:, None], n))
        return replace(problem, approach=approach_signs(np.asarray(real).T, problem.way.at * float(problem.path.feed.mean())))

    def program(self, n: int, full: bool = False) -> Transcription:
        """The nonlinear program for n waypoints, padded."""
        pad = PAD if n > 2 * PAD else PAD // 2
        key = (-(-n // pad) * pad, full)
        if key not in self._programs:
            self._programs[key] = transcribe(self.stage, *key)
        return self._programs[key]

    def solve(self, problem: PassProblem, start: PassSolution | None = None) -> PassSolution:
        """Joints that hold the programmed force along the pass; `start` is the solution of a problem close by, which needed the
        rows that this one needs.

        Raises Infeasible naming waypoint, constraint and amount.
        """
        try:
            solution = self._solve(problem, start, full=start is not None and start.limited)
        except Infeasible:
            if start is None:
                raise
            # A start of a problem that is not so close after all leads astray, and tells another reason than the seed's.
            solution = self._solve(problem, None, full=False)
        for _ in range(RELINEARISED):
            if not self._breaks_lazy_rows(problem, solution):
                return solution
            solution = self._solve(problem, replace(solution, multipliers=None), full=True)
        return solution

    def seed_joints(self, problem: PassProblem) -> Array:
        """Joints (n, 6) that lie on the wheel as the seed does, with about the overlap that the force needs."""
        path, course, force = problem.path, problem.way, self.nominal_force(problem)
        kxx, kyy, kxy = turned_curvature(path.curvature, np.array(problem.seed.turn), self.cell.wheel.radius)
        zero = np.zeros(len(path.s))
        overlap = self.law.evaluate(force, np.maximum(kxx, self.limits["kxx"][0]), kyy, kxy, zero, zero, zero) - course.gap
        if self.cell.flange is not None and course.entry is not None:
            half = 0.5 * self.cell.flange.stroke
            overlap = overlap + np.clip((force - self.cell.flange.setpoint) / self.cell.flange.stiffness, -half, half)
        goal = poses_along(self.cell, path, problem.seed, overlap + problem.indentation_correction, self.sigma)
        commanded = goal
        # The real arm sags by millimetres, a twentieth of a small wheel's arc: aim off by what it misses.
        for _ in range(AIM_STEPS):
            q = joints_near(self.cell, path, problem.seed, commanded)
            real = self.evaluate(problem, q, force).T_base_blade
            commanded = goal @ invert(real) @ commanded
        return joints_near(self.cell, path, problem.seed, commanded)

    @staticmethod
    def nominal_force(problem: PassProblem) -> Array:
        """Force (n,) N at the nodes at nominal rate and ratio."""
        return np.asarray(problem.path.force * problem.way.share)

    def _breaks_lazy_rows(self, problem: PassProblem, solution: PassSolution) -> bool:
        """Does a solution without the rows of clearance and axis limits break one of them?"""
        q = solution.q
        rows = np.einsum("kij,kj->ki", problem.clearances[..., :6], q) - problem.clearances[..., 6]
        return bool(rows.min() < 0 or axis_use(self.cell, problem.way, q, solution.rate).max() > SPEED_SHARE + FEASIBLE)

    def _solve(self, problem: PassProblem, start: PassSolution | None, full: bool) -> PassSolution:
        path = problem.path
        n = len(path.s)
        program = self.program(n, full)
        q0 = self.seed_joints(problem) if start is None else start.q
        fresh = np.ones((n, 2)) if start is None else np.column_stack([start.rate, start.ratio])
        x0 = _padded(np.column_stack([q0, fresh]), program.n)
        lbx, ubx = self._bounds(problem, program.n)
        lbg, ubg = self._row_bounds(problem, program.n, full)
        Q, c = quadratic_form(self.cell, problem, self.weights, program.n)
        limits = axis_rows(self.cell, problem.way, q0, program.n) if full else None
        p = program.pack(self._parameters(problem, program.n), self.theta.values, Q, c, limits)
        x0 = np.clip(x0.ravel(), lbx, ubx)
        data = {"x0": x0, "lbx": lbx, "ubx": ubx, "lbg": lbg, "ubg": ubg, "p": p}
        solver = program.solver
        if start is not None and start.multipliers is not None and not full:
            solver, beyond = program.again, ((0, program.n - n), (0, 0))
            both = zip(("lam_x0", "lam_g0"), start.multipliers, strict=True)
            data |= {name: np.pad(values, beyond, "edge").ravel() for name, values in both}
        result = solver(**data)
        stats = solver.stats()
        self._count(int(stats["iter_count"]) * program.n)
        x = np.asarray(result["x"]).reshape(program.n, N_Z)[:n]
        g = np.asarray(result["g"]).ravel()
        refuse_violated(path, np.maximum(lbg - g, g - ubg), full, stats["return_status"])
        # At an optimum whose complementarity rounding hides, Ipopt looks for a better one until it gives up.
        there = stats["return_status"] == "Restoration_Failed" and stats["iterations"]["inf_du"][-1] <= IPOPT["acceptable_tol"]
        solved = stats["success"] or there or stats["return_status"] == "Maximum_Iterations_Exceeded"
        if not (solved and np.isfinite(x).all()):
            raise Infeasible(f"line {path.line} ({path.side}): the optimiser stopped with {stats['return_status']}")
        found = [np.asarray(result[name]).reshape(program.n, -1)[:n] for name in ("lam_x", "lam_g")]
        multipliers = None if full else (found[0], found[1])
        force = self.nominal_force(problem) * x[:, 6] * x[:, 7]
        return PassSolution(x[:, :6], x[:, 6], x[:, 7], force, int(stats["iter_count"]), float(result["f"]), multipliers, full)

    def _count(self, iterations: int) -> None:
        """Of nodes: few waypoints that cannot be ground are tried so often that machine code, of the same bits, pays too."""
        before = self._iterated
        self._iterated += iterations
        if before < LONG_TRIED <= self._iterated and self._evaluate.library is None:
            self.compile(quietly=True)
            self._programs.clear()

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
        bound = np.tile(low, (n, 1)), np.tile(high, (n, 1))
        free = _padded(np.column_stack([np.ones(len(problem.path.s)), problem.way.share > 0]), n) * (
            problem.way.entry is not None
        )
        rate, ratio = (
            np.where(free.T > 0, [[LEAST_RATE], [RATIO_RANGE[0]]], 1.0),
            np.where(free.T > 0, [[1.0], [RATIO_RANGE[1]]], 1.0),
        )
        return np.hstack([bound[0], rate.T]).ravel(), np.hstack([bound[1], ratio.T]).ravel()

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
        turn = max(min(process.turn_tolerance, problem.turn_limit), LEAST_TURN)
        # What the seed has of the turn that the line is to be ground with is kept.
        sign = np.sign(problem.path.turn)
        asked = TURN_KEPT * min(abs(problem.path.turn), sign * problem.seed.turn)
        kept = asked if 0 < asked < turn else -turn
        low[3], high[3] = (kept, turn) if sign > 0 else (-turn, -kept)
        low[6] = SINGULARITY_SHARE * SHOULDER_MARGIN
        low[7], high[7] = self.limits.get("kxx", (0.0, np.inf))
        low[10:] = 0.0
        each = np.tile(low, (n, 1)), np.tile(high, (n, 1))
        bearing, force = _padded(problem.way.share, n) > FULL_BEARING, _padded(problem.path.force, n)
        each[0][:, 8] = np.where(bearing, 1e3 * LEAST_INDENTATION, -np.inf)
        each[1][:, 9] = PEAK_FORCE * force
        if not full:
            return each[0][:, :N_PLAIN_ROWS].ravel(), each[1][:, :N_PLAIN_ROWS].ravel()
        robot = self.cell.robot
        limits = np.concatenate([robot.qd_max, robot.qdd_max, np.ones(6), robot.qdd_max / JERK_TIME])
        use = np.tile(SPEED_SHARE * limits, n)
        return np.concatenate([each[0].ravel(), -use]), np.concatenate([each[1].ravel(), use])

    def _parameters(self, problem: PassProblem, n: int) -> Array:
        """Parameters of the stages (n, Stage.n_parameters)."""
        path, course = problem.path, problem.way
        count = len(path.s)
        sign = 1.0 if wrist_radius(self.cell, problem.seed.q[0]) > 0 else -1.0
        own = [
            self.nominal_force(problem),
            course.gap,
            course.grinding,
            np.zeros((count, 2)) if problem.lean is None else problem.lean,
            np.full(count, sign),
            node_times(course) / np.ptp(course.at),
        ]
        par = np.column_stack([self._waypoints(problem), problem.clearances.reshape(count, -1), *own])
        assert par.shape[1] == self.stage.n_parameters
        return _padded(par, n)


def refuse_violated(path: BladePath, violation: Array, full: bool, status: str) -> None:
    """Raises CannotGrind with the worst row of a pass as a sentence, if `violation` of any is more than FEASIBLE.

    violation: of the rows of `ocp.plan.passes.stage.ROWS` at all nodes, padded ones included, then (`full`) of the axis limits;
    `status` of the optimiser.
    """
    rows = N_ROWS if full else N_PLAIN_ROWS
    if violation.max() <= FEASIBLE:
        return
    n = len(violation) // (rows + N_DYNAMIC * full)
    stage = violation[: rows * n].reshape(n, rows)[: len(path.s)]
    limits = violation[rows * n :].reshape(-1, N_DYNAMIC)
    k, row = (int(i) for i in np.unravel_index(int(np.argmax(stage)), stage.shape))
    if full and limits.max() > stage.max():
        k, row = (int(i) for i in np.unravel_index(int(np.argmax(limits)), limits.shape))
        where = limits.max(axis=1)[: len(path.s)] > WORST_SHARE * limits.max()
        what = ("speed", "acceleration", "torque", "jerk")[row // 6]
        reason = f"the {what} of axis {row % 6 + 1} cannot be kept within its limit (optimiser: {status})"
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
