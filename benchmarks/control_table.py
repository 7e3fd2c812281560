"""One pass by the optimal control and by three simpler ways, on one judge: `python -m benchmarks.control_table`.

The middle line of the bundled blade's convex side, spanwise and chordwise, at 40, 100 and 200 mm/s: lines `pass_spacing_mm`
apart, every line at `process.feed` as it is (no dwell fit). All methods get the way from air to air, the seed, the corrections
by direct contact and the model of the plan; all are timed by the same law under the same limits.

ours: the plan's nonlinear program. fixed time: the same with rate and ratio at 1. raw: inverse kinematics pose by pose on the
line's frames, on a straight line through the seed's places on the arc and on its turn, in the middle of the wheel, untilted, the
overlap of every pose corrected until the force is right. smoothed: the same on frames smoothed over 10 mm.
docs/process.md has what came out.
"""

import time
from collections.abc import Callable
from dataclasses import dataclass, fields, replace
from functools import partial
from pathlib import Path
from typing import Annotated

import numpy as np
import typer
from scipy.interpolate import CubicSpline, PchipInterpolator

from ocp.data import CELL
from ocp.model.blade_gap import contact_stations
from ocp.model.cell import read_cell
from ocp.model.prepare import prepare_contact
from ocp.model.theta import believed_theta
from ocp.plan.clearance import CollisionScene
from ocp.plan.motion import PASS_WINDOW
from ocp.plan.passes.optimise import Ground, PassWorker, SolvedPass
from ocp.plan.passes.posture import joints_near, seeds_of
from ocp.plan.passes.problem import PassProblem
from ocp.plan.passes.smoothness import quadratic_form
from ocp.plan.passes.solve import PassSolution, PassSolver
from ocp.plan.passes.stage import N_PLAIN_ROWS, N_Z, ROWS, ObjectiveWeights, build_stage
from ocp.plan.passes.stretches import whole_lines
from ocp.plan.paths import PlanOptions, lay_paths
from ocp.plan.removal.dwell import even_spacing
from ocp.plan.removal.footprint import LinePatches, contacts_along, line_footprint
from ocp.plan.rules import LIMIT_SHARE
from ocp.shell.progress import Phases
from robots.errors import Infeasible
from robots.kinematics import forward
from robots.pose import Array
from robots.rigid_body import inverse_dynamics
from trajectories.joint_trajectory import SAMPLE, JointTrajectory, Limits
from trajectories.passes import BladePath
from trajectories.timing import time_contact_path
from trajectories.toppra_law import times_at

BETWEEN = 12  # places from one line to the next at which their sum is looked at
EVENLY = 2.5e-4  # m between places at which frames are smoothed
SMOOTHED = 0.010  # m of arc over which the frames of a peer are smoothed
STATION = 6e-3  # m between the contacts whose patches are solved, as in the plan's map
FORCE_SETTLED = 1e-6  # N: where the correction of the overlap stops
MOST_CORRECTIONS = 50
OUTSIDE = 1e-5  # of a row, as in ocp.plan.passes.solve


@dataclass(frozen=True)
class Job:
    """A line of a blade: its solver, its corrected problem, the patches that it was planned with, and what judges it."""

    worker: PassWorker
    fixed: "FixedTime"
    problem: PassProblem
    planned: LinePatches

    @property
    def solver(self) -> PassSolver:
        """The plan's own."""
        return self.worker.solver


def prepared(cell_file: Path, passes: str, feed: float, side: str, step: float, slow: float, weights: ObjectiveWeights) -> Job:
    """The middle line, solved by the plan's own worker: of that the corrections are kept, for all methods alike."""
    cell = read_cell(cell_file)
    cell = replace(cell, robot=replace(cell.robot, qdd_max=slow * cell.robot.qdd_max))
    cell = replace(cell, process=replace(cell.process, passes=passes, feed=feed, side=side))
    assert cell.workpiece.stl is not None
    laid = lay_paths(cell, cell.workpiece.stl, PlanOptions(step=step, even=False))
    contact = prepare_contact(cell, laid.blade, laid.paths, Phases())
    place = len(laid.paths) // 2
    scene = CollisionScene(cell, laid.blade.vertices)
    ground = Ground(cell, believed_theta(cell), weights, contact.law, contact.cover, laid.blade.vertices, laid.cloud, laid.beside)
    stretch = whole_lines(laid.paths, [np.asarray(c) for c in contact.compliance.per_pass])[0][place]
    seeds = sorted(seeds_of(cell, scene, contact.law, stretch.path), key=lambda seed: seed.cost)
    worker = PassWorker(ground)
    problem = worker.solve(stretch.path, seeds, stretch.compliance).problem
    driven = worker.look(stretch, problem.seed)
    assert driven is not None
    fixed = FixedTime(cell, ground.law, ground.theta, ground.weights)
    for solver in (worker.solver, fixed):
        solver.program(len(problem.path.s))
    return Job(worker, fixed, problem, driven.patches)


# -- methods --------------------------------------------------------------------------------------------------------


class FixedTime(PassSolver):
    """The plan's program with rate and ratio at 1."""

    def _bounds(self, problem: PassProblem, n: int) -> tuple[Array, Array]:
        bounds = [bound.reshape(n, N_Z).copy() for bound in super()._bounds(problem, n)]
        for bound in bounds:
            bound[:, 6:] = 1.0
        return bounds[0].ravel(), bounds[1].ravel()


def optimal(job: Job) -> PassSolution:
    """The plan's own."""
    return job.solver.solve(job.problem)


def fixed_time(job: Job) -> PassSolution:
    """Without rate and ratio."""
    return job.fixed.solve(job.problem)


def pose_by_pose(job: Job, frames: Callable[[BladePath], BladePath]) -> PassSolution:
    """Inverse kinematics on `frames` of the line, every pose moved along the wheel's radial until its force is right."""
    solver, problem, cell = job.solver, job.problem, job.solver.cell
    force = solver.nominal_force(problem)
    seed = problem.seed
    straight = np.clip(np.polyval(np.polyfit(seed.at, seed.arc, 1), seed.at), *cell.wheel.arc)
    q = solver.seed_joints(replace(problem, path=frames(problem.path), seed=replace(seed, arc=straight)))
    count, done = 0, False
    while not done:
        count += 1
        now = solver.evaluate(problem, q, force)
        miss = now.residual + problem.way.gap
        done = bool(np.abs(miss * now.stiffness).max() < FORCE_SETTLED) or count == MOST_CORRECTIONS
        T = forward(cell.robot, q) @ cell.workpiece.T_flange_blade
        T[:, :3, 3] += miss[:, None] * cell.wheel.outward(now.arc)
        q = joints_near(cell, problem.path, problem.seed, T)
    ones = np.ones(len(q))
    return PassSolution(q, ones, ones, force, count, float("nan"))


def smoothed(path: BladePath) -> BladePath:
    """The frames by local straight lines under a tricube weight SMOOTHED wide (Cleveland 1979, J. Am. Stat. Assoc. 74, 829), on
    even places first: nodes crowd where the way touches and lifts."""
    at = np.linspace(path.s[0], path.s[-1], int(np.ptp(path.s) / EVENLY) + 2)
    s, first = np.unique(path.s, return_index=True)
    away = at[:, None] - at
    weight = np.clip(1.0 - np.abs(away / (0.5 * SMOOTHED)) ** 3, 0.0, None) ** 3
    m0, m1, m2 = (np.sum(weight * away**k, axis=1)[:, None] for k in range(3))
    kernel = weight * (m2 - m1 * away) / (m0 * m2 - m1**2)
    n, t = (CubicSpline(at, kernel @ PchipInterpolator(s, of[first])(at))(path.s) for of in (path.n, path.t))
    n /= np.linalg.norm(n, axis=1, keepdims=True)
    t -= np.sum(t * n, axis=1, keepdims=True) * n
    return replace(path, n=n, t=t / np.linalg.norm(t, axis=1, keepdims=True))


METHODS: dict[str, Callable[[Job], PassSolution]] = {
    "ours": optimal,
    "fixed time": fixed_time,
    "raw": partial(pose_by_pose, frames=lambda path: path),
    "smoothed": partial(pose_by_pose, frames=smoothed),
}


# -- judge ----------------------------------------------------------------------------------------------------------


def timed(job: Job, q: Array, rate: Array) -> JointTrajectory:
    """As `ocp.plan.motion` times a way, but where the feed falls behind it is told in the table and not refused."""
    cell, path, course = job.solver.cell, job.problem.path, job.problem.way
    payload, feed = cell.workpiece.payload, float(path.feed.mean())
    limits = Limits.of(cell.robot, partial(inverse_dynamics, cell.robot, payload.mass, payload.com), LIMIT_SHARE)
    return time_contact_path(q, course.at * feed, rate * feed, limits, PASS_WINDOW, "way", at_rest=True)


def line_depth(job: Job, one: SolvedPass, met: Array) -> tuple[Array, Array, Array]:
    """Depth over what the programmed force and feed would take off, without ends, on the patches that the line was planned with:
    at the line's own centre, all along; a patch's half-length inside its ends; and there with neighbours ground alike, as near as
    these patches ask for, from line to line, over its mean. `met` (n,): timed feed over the planned one at the nodes, the force
    being what was planned there."""
    ground, bearing = job.worker.ground, one.touching()
    path, planned = bearing.problem.path, job.planned
    index = contact_stations(path.s, STATION).astype(np.int64)
    patches = contacts_along(ground.cell, ground.cover, ground.cloud, path, bearing.evaluation, index, passed_over=True)
    assert patches is not None
    r = bearing.solution.ratio / met[one.problem.way.share > 0]
    own, spacing = np.zeros(1), even_spacing(planned)
    between = np.linspace(0.0, spacing, BETWEEN, endpoint=False)
    lines = between + spacing * np.arange(-int(2 * planned.x[-1] / spacing) - 1, int(2 * planned.x[-1] / spacing) + 2)[:, None]
    alone = line_footprint(path.s, patches)
    centre = alone @ (r[:, None] * _across(patches, path.s, own)) / _across(planned, path.s, own)
    summed = sum(alone @ (r[:, None] * _across(patches, path.s, y)) for y in lines)
    wanted = np.mean(sum(_across(planned, path.s, y) for y in lines), axis=1, keepdims=True)
    inside = np.minimum(path.s - planned.at[0], planned.at[-1] - path.s)
    core = inside >= float(planned.half_axes[:, 0].max())
    return centre[inside >= -1e-9], centre[core], (summed / wanted)[core]


def _across(patches: LinePatches, s: Array, y: Array) -> Array:
    """Pressure per newton 1/m at distances y (m,) m beside the line, summed along it, at arc lengths s (n,) m: (n, m)."""
    profile = patches.share.sum(axis=1) * (patches.x[1] - patches.x[0])
    at = np.array([np.interp(y, patches.x, one, left=0.0, right=0.0) for one in profile])
    return np.column_stack([np.interp(s, patches.at, one) for one in at.T])


def freedoms(job: Job, one: SolvedPass) -> list[float]:
    """Share of its box, from least to most in contact, that arc, lateral, turn, tilt along and across take."""
    process, wheel, seen = job.solver.cell.process, job.solver.cell.wheel, one.touching().evaluation
    slope = 2.0 * float(np.tan(process.tilt_tolerance))
    boxes = [(seen.arc, float(np.ptp(wheel.arc))), (seen.lateral, 2.0 * min(process.lateral_tolerance, 0.5 * wheel.width))]
    boxes += [(seen.turn, 2.0 * min(process.turn_tolerance, job.problem.turn_limit))]
    boxes += [(seen.tilt[:, 0], slope), (seen.tilt[:, 1], slope)]
    return [float(np.ptp(values)) / box for values, box in boxes]


def outside(job: Job, one: SolvedPass) -> str:
    """Nodes in contact with a row outside its bounds and the row that most of them break, force balance left out."""
    solver, problem, n = job.solver, job.problem, len(one.problem.path.s)
    x = np.column_stack([one.solution.q, one.solution.rate, one.solution.ratio])
    theta = np.tile(solver.theta.values[:, None], n)
    rows = np.asarray(solver.stage.value.map(n)(x.T, solver._parameters(problem, n).T, theta)[1]).T[:, :N_PLAIN_ROWS]
    low, high = (bound.reshape(n, N_PLAIN_ROWS) for bound in solver._row_bounds(problem, n, False))
    broken = (np.maximum(low - rows, rows - high) > OUTSIDE)[problem.way.share > 0]
    broken[:, 0] = False
    count = int(broken.any(axis=1).sum())
    return f"{count}" + (f" ({ROWS[int(broken.sum(axis=0).argmax())][0]})" if count else "")


HEADER = (
    "method",
    "contact s",
    "feed off %",
    "depth",
    "with neighbours",
    "with ends",
    "lean %",
    "acceleration",
    "jerk rad/s3",
    "force off N",
    "arc, lateral, turn, tilts %",
    "rate",
    "ratio",
    "outside",
    "iterations",
    "ms a node",
    "objective",
)


def judged(job: Job, solution: PassSolution, seconds: float, objective: float) -> list[str]:
    """A row of the table below HEADER but for the method's name."""
    problem, course = job.problem, job.problem.way
    one = SolvedPass(problem, solution, job.solver.evaluate(problem, solution.q, solution.force))
    trajectory, feed = timed(job, solution.q, solution.rate), float(problem.path.feed.mean())
    touch, lift = times_at(trajectory.law, course.edges[[1, 4]] * feed)
    t = np.arange(touch, lift, SAMPLE)
    planned = np.interp(trajectory.s(t) / feed, course.at, solution.rate) * feed
    met = trajectory.feed(times_at(trajectory.law, course.at * feed)) / (solution.rate * feed)
    ends, depth, summed = line_depth(job, one, met)
    qdd = trajectory.qdd(t)
    on = course.share > 0
    assert problem.lean is not None
    lean = np.linalg.norm(problem.lean * one.evaluation.tilt, axis=1)[course.grinding > 0]
    force = np.abs((one.evaluation.residual + course.gap) * one.evaluation.stiffness)[on].max()
    return [
        f"{lift - touch:.3f}",
        f"{100 * np.abs(trajectory.feed(t) / planned - 1).max():.2f}",
        f"{depth.min():.3f} .. {depth.max():.3f}",
        f"{summed.min():.3f} .. {summed.max():.3f}",
        f"{ends.min():.3f} .. {ends.max():.3f}",
        f"{100 * lean.max():.1f}",
        f"{(np.abs(qdd) / trajectory.limits.qdd).max():.3f}",
        f"{np.abs(np.diff(qdd, axis=0)).max() / SAMPLE:.1f}",
        f"{force:.0e}",
        ", ".join(f"{100 * share:.0f}" for share in freedoms(job, one)),
        f"{solution.rate[on].min():.3f}",
        f"{solution.ratio[on].min():.3f} .. {solution.ratio[on].max():.3f}",
        outside(job, one),
        f"{solution.iterations}",
        f"{1e3 * seconds / len(course.at):.1f}",
        f"{objective:.4f}",
    ]


# -- shares of the objective ----------------------------------------------------------------------------------------


def terms(job: Job, solution: PassSolution) -> dict[str, tuple[float, float]]:
    """Value and norm of the gradient of every term of the objective at a solution, its weight counted; time less what it is at
    the nominal rate. Gradients in rad and in shares of rate and ratio, along the surface on which every node's force balance
    holds."""
    solver, problem, n = job.solver, job.problem, len(job.problem.path.s)
    x = np.column_stack([solution.q, solution.rate, solution.ratio])
    own = x.T, solver._parameters(problem, n).T, np.tile(solver.theta.values[:, None], n)
    normal = np.asarray(solver.stage.jacobian.map(n)(*own)).reshape(len(ROWS), n, N_Z)[0]
    free = np.ones((n, N_Z))
    free[problem.way.share == 0, 7] = 0.0
    normal = normal * free
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)

    def along(slope: Array) -> float:
        slope = slope.reshape(n, N_Z) * free
        return float(np.linalg.norm(slope - np.sum(slope * normal, axis=1, keepdims=True) * normal))

    none = ObjectiveWeights(**{field.name: 0.0 for field in fields(ObjectiveWeights)})
    found: dict[str, tuple[float, float]] = {}
    for field in fields(ObjectiveWeights):
        weights = replace(none, **{field.name: getattr(solver.weights, field.name)})
        Q, c = quadratic_form(solver.cell, problem, weights, n)
        shift = x - np.array([*np.zeros(7), 1.0]) if field.name == "removal" else x  # the square is about r = 1
        if Q.count_nonzero():
            value = 0.5 * float(shift.ravel() @ (Q @ shift.ravel()))
            found[field.name] = value, along(Q @ x.ravel() + c)
        if field.name in ("removal", "force", "time", "middle"):
            stage = build_stage(solver.cell, solver.model, weights, solver.theta)
            value = float(np.asarray(stage.value.map(n)(*own)[0]).sum()) - (weights.time if field.name == "time" else 0.0)
            slope = np.asarray(stage.gradient.map(n)(*own)).T
            found["lean" if field.name == "removal" else field.name] = value, along(slope)
    return found


def shares(found: dict[str, tuple[float, float]]) -> dict[str, str]:
    """Each term's share of value and gradient norm, in per cent."""
    value, slope = (max(sum(one[i] for one in found.values()), 1e-300) for i in range(2))
    return {name: f"{100 * one[0] / value:.1f} / {100 * one[1] / slope:.1f}" for name, one in found.items()}


# -- tables ---------------------------------------------------------------------------------------------------------


def line(cells: list[str]) -> str:
    """A row in Markdown."""
    return f"| {' | '.join(cells)} |"


def table(job: Job) -> tuple[list[str], list[list[str]]]:
    """The rows of all methods, and those of their shares of the objective, names first; a method that fails says so."""
    rows, parts = [], []
    for name, method in METHODS.items():
        start = time.perf_counter()
        try:
            solution = method(job)
            seconds = time.perf_counter() - start
            found = terms(job, solution)
            rows.append(line([name, *judged(job, solution, seconds, sum(v for v, _ in found.values()))]))
            parts.append([name, *shares(found).values()])
        except Infeasible as error:
            rows.append(f"| {name} | {error} |")
    return rows, parts


def main(
    cell: Annotated[Path, typer.Option(help="cell file")] = CELL,
    passes: Annotated[list[str] | None, typer.Option(help="spanwise, chordwise; default both")] = None,
    feeds: Annotated[list[float] | None, typer.Option(help="mm/s; default 40, 100, 200")] = None,
    side: Annotated[str, typer.Option(help="convex or concave")] = "convex",
    step: Annotated[float, typer.Option(help="mm between waypoints")] = 0.5,
    slow: Annotated[float, typer.Option(help="share of the axes' accelerations that there is")] = 1.0,
    removal: Annotated[float, typer.Option(help="weight of the removal")] = ObjectiveWeights.removal,
) -> None:
    """Print the tables."""
    names = ("removal", "lean", "force", "time", "middle", "speed", "acceleration", "even_rate", "even_ratio")
    collected: list[list[str]] = []
    for way in passes or ("spanwise", "chordwise"):
        for feed in feeds or (40.0, 100.0, 200.0):
            try:
                job = prepared(cell, way, 1e-3 * feed, side, 1e-3 * step, slow, ObjectiveWeights(removal=removal))
            except Infeasible as error:
                print(f"\n{way}, {feed:g} mm/s: {error}", flush=True)
                continue
            path, course = job.problem.path, job.problem.way
            touched = f"{1e3 * np.ptp(path.s):.1f} mm from touch to lift, {len(path.s)} nodes"
            print(f"\n{way}, {feed:g} mm/s: line {path.line}, {touched}, at most {100 * course.peak:.0f} % of that feed\n")
            print(f"{line(list(HEADER))}\n{line(['---'] * len(HEADER))}")
            rows, parts = table(job)
            print("\n".join(rows), flush=True)
            collected += [[f"{way} {feed:g}, {part[0]}", *part[1:]] for part in parts]
    print(f"\n{line(['value / gradient %', *names])}\n{line(['---'] * (len(names) + 1))}")
    print("\n".join(line(row) for row in collected))


if __name__ == "__main__":
    typer.run(main)
