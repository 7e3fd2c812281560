"""The pass of `benchmarks/pass_peers.py` as numbers, and each peer's way to solve it."""

from collections.abc import Callable
from dataclasses import replace

import casadi as ca
import numpy as np
from calibration_peer_runs import urdf
from scipy.interpolate import CubicSpline, make_lsq_spline
from scipy.optimize import minimize
from scipy.spatial.transform import Rotation

from ocp.data import CELL
from ocp.model.cell import read_cell
from ocp.model.prepare import prepare_contact
from ocp.model.theta import believed_theta
from ocp.plan.clearance import CollisionScene
from ocp.plan.passes.posture import seeds_of
from ocp.plan.passes.problem import PassProblem, with_direction
from ocp.plan.passes.smoothness import quadratic_form
from ocp.plan.passes.solve import PassSolver
from ocp.plan.passes.stage import N_PLAIN_ROWS, N_Z, ObjectiveWeights
from ocp.plan.paths import PlanOptions, lay_paths
from ocp.shell.progress import Phases
from robots.kinematics import forward
from robots.pose import Array, make_transform
from trajectories.passes import reversed_path

Joints = Array  # (n, 6) rad
MINK_STEPS = 20  # a pose at most
HELD, LEVER = 1e-5, 0.1  # m: how near Drake's spline holds a waypoint and a point so far out along its normal
OPTIMALITY = 1e-4  # of SNOPT there: at its own, 1e-6, it stops at its limit of iterations
KEEP_BODIES = '<mujoco><compiler fusestatic="false"/></mujoco>'


class Pass:
    """The problem as numbers: rows, bounds, quadratic form, start."""

    def __init__(self, nodes: int) -> None:
        self.cell = cell = read_cell(CELL)
        options = PlanOptions(step=1e-3, even=False)
        laid = lay_paths(cell, cell.workpiece.stl, options)
        convex = [path for path in laid.paths if path.side == "convex"]
        path = convex[len(convex) // 2]
        laid = lay_paths(cell, cell.workpiece.stl, replace(options, step=float(path.s[-1]) / (nodes - 1)))
        path = next(one for one in laid.paths if one.line == path.line)
        contact = prepare_contact(cell, laid.blade, [path], Phases())
        seed = min(seeds_of(cell, CollisionScene(cell, laid.blade.vertices), contact.law, path), key=lambda seed: seed.cost)
        problem = PassProblem.start(path, seed, np.asarray(contact.compliance.per_pass[0]))
        self.problem = with_direction(problem, reversed_path(path)) if seed.direction < 0 else problem
        self.n = n = len(path.s)
        self.weights = ObjectiveWeights()
        self.solver = solver = PassSolver(cell, contact.law, believed_theta(cell), self.weights)
        self.start = solver.seed_joints(self.problem)
        self.low, self.high = (bound.reshape(n, N_Z)[:, :6] for bound in solver._bounds(self.problem, n))
        self.rows = [bound.reshape(n, N_PLAIN_ROWS) for bound in solver._row_bounds(self.problem, n, False)]
        self.parameters, self.theta = solver._parameters(self.problem, n), solver.theta.values
        self.Q, self.c = quadratic_form(cell, self.problem, self.weights, n)
        self.step = float(np.diff(self.problem.way.at).mean())
        assert np.allclose(np.diff(self.problem.way.at), self.step)

    def judged(self, q: Joints) -> tuple[float, float]:
        """Largest miss of the force N; objective without the time's term, which is the same for all at nominal rate."""
        now = self.solver.evaluate(self.problem, q, self.solver.nominal_force(self.problem))
        z = np.column_stack([q, np.ones((self.n, 2))])
        stages = self.solver.stage.value.map(self.n)(z.T, self.parameters.T, np.tile(self.theta[:, None], self.n))[0]
        x = z.ravel()
        objective = float(ca.sum2(stages)) + float(0.5 * x @ self.Q @ x + self.c @ x) - self.weights.time
        return float(np.abs(now.residual * now.stiffness).max()), objective


# -- the same program -----------------------------------------------------------------------------------------------


def opti(job: Pass, solver: str) -> Callable[[], Joints]:
    """Objective and rows of every node, joints and their differences as states, second differences as inputs."""
    n, h, robot, weights, opti = job.n, job.step, job.cell.robot, job.weights, ca.Opti()
    stage, total = job.solver.stage.value.function, (job.n - 1) * job.step
    speed, bend = 1 / (h * robot.qd_max), 1 / (h * h * robot.qdd_max)
    x, u = [], []
    for k in range(n):
        x.append(opti.variable(12))
        u.append(opti.variable(6) if k < n - 1 else None)
    objective = 0
    for k in range(n):
        q, d = x[k][:6], x[k][6:]
        if k < n - 1:
            opti.subject_to(x[k + 1] == ca.vertcat(q + d + u[k], d + u[k]))
        if k == 0:
            opti.subject_to(d == 0)
        value, rows = stage(ca.vertcat(q, 1, 1), job.parameters[k], job.theta)
        objective += value
        if k > 0:
            objective += weights.speed * h / total * ca.sumsqr(speed * d)
        if 0 < k < n - 1:
            objective += weights.acceleration * h / total * ca.sumsqr(bend * u[k])
        opti.subject_to(rows[0] == 0)
        for i in range(1, N_PLAIN_ROWS):
            low, high = job.rows[0][k, i], job.rows[1][k, i]
            if i == 9:  # the force is given where rate and ratio are
                continue
            if np.isfinite(low) and np.isfinite(high):
                opti.subject_to(opti.bounded(low, rows[i], high))
            elif np.isfinite(low):
                opti.subject_to(rows[i] >= low)
            elif np.isfinite(high):
                opti.subject_to(rows[i] <= high)
        opti.subject_to(opti.bounded(job.low[k], q, job.high[k]))
    opti.minimize(objective)
    options = {"print_time": False}
    if solver == "ipopt":
        opti.solver("ipopt", options | {"ipopt": {"print_level": 0, "sb": "yes", "tol": 1e-6}})
    else:
        opti.solver("fatrop", options | {"structure_detection": "auto", "fatrop": {"print_level": 0, "tolerance": 1e-6}})

    def solve() -> Joints:
        d = np.vstack([np.zeros(6), np.diff(job.start, axis=0)])
        for k in range(n):
            opti.set_initial(x[k], np.concatenate([job.start[k], d[k]]))
            if k < n - 1:
                opti.set_initial(u[k], d[k + 1] - d[k])
        found = opti.solve()
        return np.array([found.value(one[:6]) for one in x])

    return solve


# -- pose by pose ---------------------------------------------------------------------------------------------------


def slsqp(job: Pass) -> Callable[[], Joints]:
    """Each node's own objective and rows, and how fast the axes come from the pose before; derivatives of the plan's stage."""
    stage, h, robot = job.solver.stage, job.step, job.cell.robot
    value, gradient, jacobian = stage.value.function, stage.gradient.function, stage.jacobian.function

    def node(k: int, before: Array) -> Array:
        at, low, high = (job.parameters[k], job.theta), *(bound[k] for bound in job.rows)
        below, above = np.flatnonzero(np.isfinite(low[1:9])) + 1, np.flatnonzero(np.isfinite(high[1:9])) + 1
        scale = job.weights.speed / (h * robot.qd_max) ** 2

        def rows(q: Array) -> Array:
            return np.asarray(value([*q, 1, 1], *at)[1]).ravel()

        def slopes(q: Array) -> Array:
            return np.asarray(jacobian([*q, 1, 1], *at))[:, :6]

        def cost(q: Array) -> tuple[float, Array]:
            z, away = [*q, 1, 1], q - before
            return (
                job.n * float(value(z, *at)[0]) + float(scale @ away**2),
                job.n * np.asarray(gradient(z, *at)).ravel()[:6] + 2 * scale * away,
            )

        def inside(q: Array) -> Array:
            g = rows(q)
            return np.concatenate([g[below] - low[below], high[above] - g[above]])

        def inside_slopes(q: Array) -> Array:
            J = slopes(q)
            return np.concatenate([J[below], -J[above]])

        constraints = (
            {"type": "eq", "fun": lambda q: rows(q)[:1], "jac": lambda q: slopes(q)[:1]},
            {"type": "ineq", "fun": inside, "jac": inside_slopes},
        )
        bounds = list(zip(job.low[k], job.high[k], strict=True))
        return np.asarray(minimize(cost, before, method="SLSQP", jac=True, bounds=bounds, constraints=constraints).x)

    def solve() -> Joints:
        q = [node(0, job.start[0])]
        for k in range(1, job.n):
            q.append(node(k, q[-1]))
        return np.array(q)

    return solve


# -- on the start's poses of a rigid arm ----------------------------------------------------------------------------


def contact_frames(job: Pass) -> tuple[Array, Array]:
    """Frames (t, b, n) at the waypoints in the flange frame, and where the start has them in the base frame, both (n, 4, 4)."""
    path = job.problem.path
    local = make_transform(np.stack([path.t, np.cross(path.n, path.t), path.n], axis=-1), path.p)
    in_flange = job.cell.workpiece.T_flange_blade @ local
    return in_flange, forward(job.cell.robot, job.start) @ in_flange


def mink_steps(job: Pass) -> Callable[[], Joints]:
    """A frame task a pose, without cost on the turn about the normal; its QP steps from the pose before until nothing moves."""
    import mink
    import mujoco

    spec = mujoco.MjSpec.from_string(urdf(job.cell.robot.mdh, np.zeros(3)).replace(">", f">{KEEP_BODIES}", 1))
    in_flange, wanted = contact_frames(job)
    for k, T in enumerate(in_flange):
        quaternion = np.roll(Rotation.from_matrix(T[:3, :3]).as_quat(), 1)
        spec.body("flange").add_site(name=f"waypoint_{k}", pos=T[:3, 3], quat=quaternion)
    configuration, sign = mink.Configuration(spec.compile()), job.cell.robot.sign

    def solve() -> Joints:
        configuration.update(sign * job.start[0])
        q = []
        for k, T in enumerate(wanted):
            task = mink.FrameTask(f"waypoint_{k}", "site", position_cost=1.0, orientation_cost=[1.0, 1.0, 0.0])
            task.set_target(mink.SE3.from_matrix(T))
            for _ in range(MINK_STEPS):
                speed = mink.solve_ik(configuration, [task], 1.0, "daqp", damping=1e-9)
                configuration.integrate_inplace(speed, 1.0)
                if np.abs(speed).max() < 1e-9:
                    break
            q.append(sign * configuration.q)
        return np.array(q)

    return solve


def drake_spline(job: Pass) -> Callable[[], Joints]:
    """Points and normals held at every waypoint, the turn free; the integral of the squared speeds as cost; its own solver."""
    from pydrake.multibody.inverse_kinematics import AngleBetweenVectorsConstraint, PositionConstraint
    from pydrake.multibody.parsing import Parser
    from pydrake.multibody.plant import MultibodyPlant
    from pydrake.planning import KinematicTrajectoryOptimization
    from pydrake.solvers import SnoptSolver, SolverOptions
    from pydrake.trajectories import BsplineTrajectory

    sign, plant, at = job.cell.robot.sign, MultibodyPlant(0.0), np.linspace(0.0, 1.0, job.n)
    Parser(plant).AddModelsFromString(urdf(job.cell.robot.mdh, np.zeros(3)), "urdf")
    plant.WeldFrames(plant.world_frame(), plant.GetFrameByName("link_0"))
    plant.Finalize()
    context, world, flange = plant.CreateDefaultContext(), plant.world_frame(), plant.GetFrameByName("flange")
    spline = KinematicTrajectoryOptimization(6, job.n, 4, job.step * (job.n - 1))
    spline.AddDurationConstraint(job.step * (job.n - 1), job.step * (job.n - 1))
    spline.AddPathEnergyCost()
    ends = np.sort(np.stack([sign * job.low[0], sign * job.high[0]]), axis=0)
    spline.AddPositionBounds(*ends)
    turn = job.cell.process.turn_tolerance
    for s, own, T in zip(at, *contact_frames(job), strict=True):
        for out in (0.0, LEVER):  # the waypoint, and a point straight out of it for the normal
            place, point = (frame[:3, 3] + out * frame[:3, 2] for frame in (T, own))
            held = PositionConstraint(plant, world, place - HELD, place + HELD, flange, point, context)
            spline.AddPathPositionConstraint(held, s)
        angle = AngleBetweenVectorsConstraint(plant, world, T[:3, 0], flange, own[:3, 0], 0.0, turn, context)
        spline.AddPathPositionConstraint(angle, s)
    options = SolverOptions()
    options.SetOption(SnoptSolver.id(), "Major optimality tolerance", OPTIMALITY)
    basis = spline.basis()
    dense = np.linspace(0.0, 1.0, 10 * job.n)
    fitted = make_lsq_spline(dense, sign * CubicSpline(at, job.start)(dense), np.asarray(basis.knots()), 3).c
    spline.SetInitialGuess(BsplineTrajectory(basis, list(fitted[:, :, None])))

    def solve() -> Joints:
        found = SnoptSolver().Solve(spline.prog(), spline.prog().initial_guess(), options)
        if not found.is_success():
            raise RuntimeError(f"SNOPT: {found.get_solution_result().name}")
        way = spline.ReconstructTrajectory(found)
        return sign * way.vector_values(at * way.end_time()).T

    return solve
