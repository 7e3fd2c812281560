"""All passes of a blade through the optimiser, side by side in worker processes, and kept on disk.

A pass is solved, its wheel contact solved directly at the solution, the difference (what the wheel's table missed) fed back as a
correction, and solved again; then collisions and contact elsewhere on the blade are checked at every waypoint. A seed that fails
gives way to the next.
"""

import hashlib
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path

import numpy as np
from scipy.interpolate import PchipInterpolator

import ocp
import robots
import trajectories
from ocp.contact.wheel.cover import Cover
from ocp.contact.wheel.law import WheelLaw
from ocp.contact.wheel.signorini import LocalShape, solve_force
from ocp.model.blade_gap import SurfaceCloud, contact_stations, surface_shape
from ocp.model.cell import Cell
from ocp.model.theta import Theta
from ocp.plan.clearance import CollisionScene, SecondaryContact, find_secondary_contact
from ocp.plan.passes.posture import Seed, driven, find_seeds
from ocp.plan.passes.problem import PassProblem, with_direction
from ocp.plan.passes.solve import Evaluation, PassSolution, PassSolver
from ocp.plan.passes.stage import ObjectiveWeights
from ocp.plan.passes.stretches import CannotGrind, LeftOut, LineStretch, cut_out, joined
from ocp.plan.rules import DIRECT_TOLERANCE, LIFT_OFF, SECONDARY_CONTACT_TOLERANCE, STROKE_RESERVE, WHEEL_ROOM
from ocp.shell.cache import Entry, content_key, flattened, rebuilt, remember
from ocp.shell.processes import cores, interrupts_held_back, workers
from robots.errors import Infeasible
from robots.pose import Array
from trajectories.passes import BladePath, reversed_path

CORRECTIONS = 4
SIGN_TOLERANCE = 0.1  # of an axis' sign of motion between the program and its solution
CLEARANCE_BAND = 0.010  # m; waypoints closer than this to a margin get a clearance row
THINNING = 4  # one point in four, 1.6 mm apart: a wheel is 0.03 mm flatter over that, below the tolerance
STATION_SPACING = 3e-3  # m between waypoints solved directly
FALLBACKS = 4  # seeds tried before a pass is refused
TURN_LIMITS = (1.0, 0.2, 0.02)  # of the turn tolerance, tried in turn while a turned wheel touches the blade elsewhere
LIFT_RESERVE = 1e-3  # m; ways between passes are judged on the nominal arm, which stands about that far beside the bent one
END_PROBE = 1e-3  # m between the waypoints at which it is looked whether the blade could be lifted off
FILES = (".path", ".stl")  # where a file lies does not matter, what it says is in the key by value


class TouchesElsewhere(CannotGrind):
    """The wheel would touch the blade beside the contact."""


@dataclass(frozen=True)
class Ground:
    """What all passes share: cell, parameters, the wheel's table and cover, the blade's vertices (m, 3) and its
    surface as a fine cloud."""

    cell: Cell
    theta: Theta
    weights: ObjectiveWeights
    law: WheelLaw
    cover: Cover
    vertices: Array
    cloud: SurfaceCloud


def solve_directly(ground: Ground, problem: PassProblem, solved: Evaluation) -> Array:
    """The indentation correction (n,) m that makes the model's wheel indentation that of the contact solved directly, under the
    programmed force on the blade's real surface, at the postures of `solved`.

    The indentation varies smoothly along a pass, other than the local curvature that the table goes by: it is solved at some
    waypoints. Raises Infeasible of the contact solver, with the waypoint.
    """
    wheel, path = ground.cell.wheel, problem.path
    along = -wheel.travel * ground.cell.process.sigma  # zero turn: the blade moves with the belt or against it
    index = contact_stations(path.s, STATION_SPACING)
    indentation = []
    for k in index:
        kxx, kyy, kxy = (float(c) for c in solved.curvature[k])
        tilt_x, tilt_y = (float(c) for c in solved.tilt[k])
        heading = (along * float(np.cos(solved.turn[k])), along * float(np.sin(solved.turn[k])))
        base = LocalShape(kxx, kyy, kxy, float(solved.lateral[k]), tilt_x, tilt_y, heading=heading)
        shape = surface_shape(wheel, ground.cloud, base, solved.T_base_blade[k], path.p[k])
        try:
            indentation.append(solve_force(ground.cover, float(path.force[k]), shape).indentation)
        except Infeasible as error:
            here = np.abs(path.s - path.s[k]) <= 0.5 * STATION_SPACING
            raise CannotGrind.of(path, here, str(error), "use a narrower wheel or larger margins", int(k)) from None
    wanted = PchipInterpolator(path.s[index], indentation)(path.s)
    return np.asarray(problem.indentation_correction + wanted - solved.parts[:, 1])


@dataclass(frozen=True)
class SolvedPass:
    """A pass that holds its force: problem (path in its direction of travel), joints, what the model says of them."""

    problem: PassProblem
    solution: PassSolution
    evaluation: Evaluation


@dataclass(frozen=True)
class GroundLines:
    """Passes that hold their force, and what of their lines is left out."""

    passes: list[SolvedPass]
    left_out: list[LeftOut]

    @staticmethod
    def together(parts: Sequence["GroundLines"]) -> "GroundLines":
        """All of them in one, the passes in the order of the lines."""
        passes = sorted((p for one in parts for p in one.passes), key=lambda p: (p.problem.path.line, p.problem.path.start))
        return GroundLines(passes, joined([lost for one in parts for lost in one.left_out]))


class PassWorker:
    """Solves passes one after another with one compiled model."""

    def __init__(self, ground: Ground) -> None:
        self.ground = ground
        self.solver = PassSolver(ground.cell, ground.law, ground.theta, ground.weights)
        self.scene = CollisionScene(ground.cell, ground.vertices)

    def solve(self, path: BladePath, seeds: list[Seed], compliance: Array) -> SolvedPass:
        """The first seed that gives a sound pass. Raises Infeasible with the first seed's reason where none does."""
        reasons: list[Infeasible] = []
        for seed in seeds[:FALLBACKS]:
            problem = PassProblem.start(path, seed, compliance)
            if seed.direction < 0:
                problem = with_direction(problem, reversed_path(path))
            for limit in TURN_LIMITS:
                try:
                    one = self._solve(replace(problem, turn_limit=limit * self.ground.cell.process.turn_tolerance))
                    refuse_ends(self.ground.cell, self.scene, one)
                    return one
                except Infeasible as error:
                    turned = isinstance(error, CannotGrind) and seed.direction < 0
                    reasons.append(error.turned_round() if isinstance(error, CannotGrind) and turned else error)
                    if not isinstance(error, TouchesElsewhere):
                        break
        # What takes the least of the line away.
        raise min(reasons, key=lambda e: e.nodes(path.s).sum() if isinstance(e, CannotGrind) and len(e.at) else len(path.s))

    def solve_stretch(self, stretch: LineStretch, seeds: list[Seed], whole: bool) -> GroundLines:
        """All that can be ground of a piece of a line, and what is left out of it; `whole`: all of it.

        Pieces that are cut off begin from seeds of their own. Raises Infeasible where `whole` cannot be, as `solve` does.
        """
        found, lost = [], []
        open_ = [(stretch, seeds)]
        while open_:
            one, starts = open_.pop(0)
            try:
                if not starts:
                    ranked = find_seeds(self.ground.cell, self.scene, self.ground.law, [one.path])[0]
                    starts = driven(one.path, ranked, seeds[0].direction)
                found.append(self.solve(one.path, starts, one.compliance))
            except Infeasible as error:
                if whole:
                    raise
                pieces, gone = cut_out(one, error)
                lost += gone
                open_ += [(piece, []) for piece in pieces]
        return GroundLines(found, lost)

    def _solve(self, problem: PassProblem) -> SolvedPass:
        start: PassSolution | None = None
        problem = self.solver.with_approach(problem)
        for _ in range(CORRECTIONS):
            solution = self.solver.solve(problem, start)
            solved = self.solver.evaluate(problem, solution.q, solution.force)
            better = solve_directly(self.ground, problem, solved)
            off = np.abs((better - problem.indentation_correction) * solved.stiffness).max()
            blocked = self._with_clearances(problem, solution.q)
            turned = self.solver.with_approach(problem, solution.q)
            if off < DIRECT_TOLERANCE and blocked is None and not _turns_differ(problem, turned):
                break
            problem = replace(blocked or problem, indentation_correction=better, approach=turned.approach)
            start = solution
        refuse_unsound(self.ground.cell, self.scene, self.ground.cloud, problem.path, solution, solved)
        return SolvedPass(problem, replace(solution, multipliers=None), solved)

    def _with_clearances(self, problem: PassProblem, q: Array) -> PassProblem | None:
        """The problem with rows that keep what collides free, linear about q; None where nothing collides."""
        values, _ = self.scene.clearances(q, in_contact=True)
        if values.min() >= 0:
            return None
        clearances = problem.clearances.copy()
        for k in np.flatnonzero(values < CLEARANCE_BAND):
            slope = self.scene.gradient(q[k], in_contact=True)
            clearances[k] = np.roll(clearances[k], 1, axis=0)
            clearances[k, 0] = [*slope, slope @ q[k] - values[k] + 1e-3]
        return replace(problem, clearances=clearances)


def refuse_unsound(
    cell: Cell, scene: CollisionScene, cloud: SurfaceCloud, path: BladePath, solution: PassSolution, solved: Evaluation
) -> None:
    """Raises CannotGrind: something collides, the blade touches elsewhere, the flange is at the end of its stroke."""
    clearance = scene.clearance(solution.q, in_contact=True)
    if clearance.value < 0:
        where = scene.clearances(solution.q, in_contact=True)[0] < 0
        raise CannotGrind.of(path, where, clearance.sentence(), "move the wheel or the blade in its holder", clearance.index)
    points, poses = cloud.points[::THINNING], solved.T_base_blade
    beside = find_secondary_contact(cell, points, poses, path.p, solved.curvature, solved.tilt, solved.delta)
    if beside.depth > SECONDARY_CONTACT_TOLERANCE:
        reason = (
            f"the blade would touch the wheel {beside.distance * 1e3:.1f} mm beside "
            f"the contact, {beside.depth * 1e3:.2f} mm deeper than planned (at most {SECONDARY_CONTACT_TOLERANCE * 1e3:.2f})"
        )
        where = beside.depths > SECONDARY_CONTACT_TOLERANCE
        error = CannotGrind.of(path, where, reason, f"use {_other_wheel(cell, beside)}, or larger margins", beside.index)
        raise TouchesElsewhere(str(error), **vars(error))
    if cell.flange is not None:
        stroke, limit = solved.parts[:, 0], 0.5 * cell.flange.stroke - STROKE_RESERVE
        k = int(np.argmax(np.abs(stroke)))
        if abs(stroke[k]) > limit:
            reason = f"the force flange would stand {stroke[k] * 1e3:.2f} mm from its middle, {limit * 1e3:.2f} mm are usable"
            raise CannotGrind.of(path, np.abs(stroke) > limit, reason, "set force_N nearer to the flange's setpoint", k)


def refuse_ends(cell: Cell, scene: CollisionScene, one: SolvedPass) -> None:
    """Raises CannotGrind with what lies before the first and behind the last waypoint at which the blade can be lifted off the
    wheel: there a pass could not be begun or ended."""
    path, poses = one.problem.path, one.evaluation.T_base_blade.copy()
    poses[:, :3, 3] += LIFT_OFF * cell.wheel.outward(one.evaluation.arc)
    ends = scene.off_wheel(poses[[0, -1]]) - LIFT_RESERVE
    if ends.min() >= 0:
        return
    # From one waypoint to the next the gap changes by less than the way between them.
    index = np.unique(np.append(np.arange(0, len(poses), max(int(END_PROBE / np.diff(path.s).max()), 1)), len(poses) - 1))
    free = index[scene.off_wheel(poses[index]) >= LIFT_RESERVE]
    where = np.ones(len(poses), bool)
    if len(free):
        where[free[0] : free[-1] + 1] = False
    reason = f"lifted {LIFT_OFF * 1e3:.0f} mm off the wheel the blade would still be {-ends.min() * 1e3:.1f} mm too near to it"
    remedy = "use a smaller or narrower wheel, or larger margins beside block and shroud"
    raise CannotGrind.of(path, where, reason, remedy, 0 if ends[0] < 0 else len(poses) - 1)


def _other_wheel(cell: Cell, beside: SecondaryContact) -> str:
    """The wheel that would not reach what is touched beside the contact."""
    narrower = 2.0 * abs(beside.lateral) - 2.0 * WHEEL_ROOM
    if narrower > 0.2 * cell.wheel.width:
        return f"a wheel at most {np.floor(1e3 * narrower):.0f} mm wide"
    return "a smaller or narrower wheel"


def _turns_differ(one: PassProblem, other: PassProblem) -> bool:
    """Do the signs of the axes' motion differ by more than a tenth anywhere?"""
    if one.approach is None or other.approach is None:
        return False
    return bool(np.abs(one.approach - other.approach).max() > SIGN_TOLERANCE)


_worker: PassWorker | None = None


def _start_worker(ground: Ground) -> None:
    global _worker
    _worker = PassWorker(ground)


def _solve_in_worker(stretch: LineStretch, seeds: list[Seed], whole: bool) -> GroundLines:
    assert _worker is not None
    return _worker.solve_stretch(stretch, seeds, whole)


def solve_passes(
    ground: Ground,
    stretches: list[LineStretch],
    seeds: list[list[Seed]],
    whole: bool = True,
    advance: Callable[[], None] = lambda: None,
) -> GroundLines:
    """Solve every pass, in worker processes where there are several cores; what cannot be ground is left out.

    Raises Infeasible of the first pass (in order) that has no sound solution if the `whole` of all of them is asked for.
    """
    tasks = [(stretch, starts, whole) for stretch, starts in zip(stretches, seeds, strict=True)]
    jobs = min(cores(), len(tasks))
    solved = []
    if jobs <= 1:
        worker = PassWorker(ground)
        for task in tasks:
            solved.append(worker.solve_stretch(*task))
            advance()
        return GroundLines.together(solved)
    with workers(jobs, _start_worker, ground) as pool:
        with interrupts_held_back():
            futures = [pool.submit(_solve_in_worker, *task) for task in tasks]
        for future in futures:
            future.add_done_callback(lambda _: advance())
        return GroundLines.together([future.result() for future in futures])


def remembered_passes(
    ground: Ground, paths: list[BladePath], compliance: list[Array], solve: Callable[[], GroundLines], whole: bool = True
) -> GroundLines:
    """What can be ground of `paths` on `ground` with the blade's compliance: kept ones, else those of `solve`."""
    content = flattened((ground, paths, compliance))
    parts = [part for name, array in sorted(content.items()) if not name.endswith(FILES) for part in (name, array)]

    def counted() -> Entry:
        found = solve()
        return flattened({"passes": found.passes, "left_out": found.left_out, "count": [len(found.passes), len(found.left_out)]})

    entry = remember("passes", content_key(code_hash(), whole, *parts), counted)
    passes = [rebuilt(SolvedPass, entry, f".passes.{i}") for i in range(int(entry[".count.0"]))]
    return GroundLines(passes, [rebuilt(LeftOut, entry, f".left_out.{i}") for i in range(int(entry[".count.1"]))])


@cache
def code_hash() -> str:
    """Hash of the sources and the data of the three packages: so many of them shape a pass that any change counts."""
    digest = hashlib.sha256()
    for package in (ocp, robots, trajectories):
        for file in sorted(Path(str(package.__file__)).parent.rglob("*")):
            if file.suffix in (".py", ".toml"):
                digest.update(file.read_bytes())
    return digest.hexdigest()
