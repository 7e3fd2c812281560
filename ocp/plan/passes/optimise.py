"""All passes of a blade through the optimiser, side by side in worker processes, and kept on disk.

A pass is solved with what the wheel's table misses at the postures of its seed, its wheel contact is solved directly at the
solution, the difference that is left fed back as a correction, and it is solved again; then collisions and contact elsewhere on
the blade are checked at every waypoint. A seed that fails gives way to the next.
"""

from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline, PchipInterpolator

from ocp.contact.wheel.cover import Cover
from ocp.contact.wheel.law import WheelLaw
from ocp.contact.wheel.signorini import solve_force
from ocp.model.blade_gap import SurfaceCloud, contact_stations, solved_where_needed
from ocp.model.cell import Cell
from ocp.model.theta import Theta
from ocp.plan.clearance import CollisionScene, SecondaryContact, find_secondary_contact, wheel_room
from ocp.plan.passes.coarse import start_on_coarse_grid
from ocp.plan.passes.course import entry_of
from ocp.plan.passes.posture import Seed, driven, find_seeds
from ocp.plan.passes.problem import PassProblem, air_to_air_problem, at_rows, lead_room, with_direction
from ocp.plan.passes.solve import Evaluation, PassSolution, PassSolver
from ocp.plan.passes.stage import ObjectiveWeights
from ocp.plan.passes.stretches import NO_ROOM, CannotGrind, LeftOut, LineStretch, cut_out, joined
from ocp.plan.removal.dwell import DrivenLine
from ocp.plan.removal.footprint import contacts_along, shape_under
from ocp.plan.rules import (
    DIRECT_TOLERANCE,
    FLANGE_FORCE_TOLERANCE,
    LIFT_OFF,
    LIFT_RESERVE,
    RIGID_FORCE_TOLERANCE,
    SECONDARY_CONTACT_TOLERANCE,
    STROKE_RESERVE,
    WHEEL_ROOM,
)
from ocp.shell.cache import Entry, code_hash, content_key, flattened, rebuilt, remember
from ocp.shell.native import evaluated_by, left_uncompiled
from ocp.shell.processes import cores, interrupts_held_back, workers
from robots.errors import Infeasible
from robots.pose import Array
from trajectories.blade.window import GAP
from trajectories.passes import BladePath, reversed_path

CORRECTIONS = 4
LEAST_DIRECT = 0.2  # of the programmed force: with less the contact is not solved directly
WORTH_COMPILING = 1000  # waypoints: solving them by machine code saves what compiling takes
SIGN_TOLERANCE = 0.1  # of an axis' sign of motion between the program and its solution
CLEARANCE_BAND = 0.010  # m; waypoints closer than this to a margin get a clearance row
THINNING = 4  # one point in four, 1.6 mm apart: a wheel is 0.03 mm flatter over that, below the tolerance
ROUGH = 0.5  # of the force a program may be off by: by so much more or less the table misses at the next node
STATION_FORCE = 1.0  # N between waypoints solved directly on a ramp, where the table misses much
STATION_SPACING = 3e-3  # m between waypoints solved directly
LOOKED_AT = 6e-3  # m between contacts on which feeds and removal are planned
FALLBACKS = 4  # seeds tried before a pass is refused
ATTEMPTS = ((True, 1.0), (False, 1.0), (False, 0.2), (False, 0.02))
"""Whether a pass is led in and out beyond the line, and of the turn tolerance: tried in turn, the latter while a turned wheel
touches the blade elsewhere."""
END_PROBE = 1e-3  # m between the waypoints at which it is looked whether the blade could be lifted off
FILES = (".path", ".stl")  # where a file lies does not matter, what it says is in the key by value


Feeds = Callable[[Sequence[DrivenLine | None]], Sequence[Array | None]]


class TouchesElsewhere(CannotGrind):
    """The wheel would touch the blade beside the contact."""


class PassesNear(CannotGrind):
    """The wheel would pass too near to block, platform or shroud, in whatever posture the arm holds the blade there."""


@dataclass(frozen=True)
class Ground:
    """What all passes share: cell, parameters, the wheel's table and cover, the blade's vertices (m, 3) and its
    surface as a fine cloud; points (k, 3) m beside the ground surface that the wheel keeps away from."""

    cell: Cell
    theta: Theta
    weights: ObjectiveWeights
    law: WheelLaw
    cover: Cover
    vertices: Array
    cloud: SurfaceCloud
    beside: Array


def rises_between(force: Array, index: NDArray[np.int64], rough: NDArray[np.bool_]) -> NDArray[np.int64]:
    """The nodes at which the force (n,) N has changed by another STATION_FORCE, between those neighbours of `index` (k,) that are
    `rough` (k - 1,)."""
    steps = np.flatnonzero(np.diff(np.floor(force / STATION_FORCE)))
    place = np.searchsorted(index, steps, side="right") - 1
    inside = (place >= 0) & (place < len(rough)) & ~np.isin(steps, index)
    return np.asarray(steps[inside][rough[place[inside]]])


def solve_directly(ground: Ground, problem: PassProblem, force: Array, solved: Evaluation) -> Array:
    """The indentation correction (n,) m that makes the model's wheel indentation that of the contact solved directly, under the
    `force` (n,) N on the blade's real surface, at the postures of `solved`.

    The indentation varies smoothly along a pass, other than the local curvature that the table goes by: it is solved at some
    nodes; where the force is small the correction goes with it. On a ramp the force rises within a few millimetres: where what
    the table misses changes much between two nodes, it is solved at every STATION_FORCE between them too. Raises Infeasible of
    the contact solver, with the node.
    """
    path = problem.path
    bearing = np.flatnonzero(force >= LEAST_DIRECT * path.force)
    index = bearing[contact_stations(path.s[bearing], STATION_SPACING)]

    def missed(index: NDArray[np.int64]) -> Array:
        contact, indentation = None, []
        for k in index:
            shape = shape_under(ground.cell, ground.cloud, path, solved, k)
            try:
                contact = solve_force(ground.cover, float(force[k]), shape, contact)
            except Infeasible as error:
                here = np.abs(path.s - path.s[k]) <= 0.5 * STATION_SPACING
                raise CannotGrind.of(path, here, str(error), "use a narrower wheel or larger margins", int(k)) from None
            indentation.append(contact.indentation)
        return np.array(indentation) - solved.parts[index, 1]

    def off(stations: NDArray[np.int64], expected: Array, found: Array) -> Array:
        return np.abs(expected - found) * solved.stiffness[index[stations]]

    missed(index[solved.curvature[index, 0] <= 0])  # too hollow for the wheel: none of these is passed over
    chosen, more_there = solved_where_needed(path.s[index], lambda k: missed(index[k]), off, DIRECT_TOLERANCE / 3.0)
    index = index[chosen]
    rough = np.abs(np.diff(more_there)) * solved.stiffness[index[1:]] > ROUGH * force_tolerance(ground.cell)
    between = rises_between(force, index, rough)
    if len(between):
        both = np.concatenate([index, between])
        order = np.argsort(both)
        index, more_there = both[order], np.concatenate([more_there, missed(between)])[order]
    more = PchipInterpolator(path.s[index], more_there)
    inside = np.clip(np.arange(len(force)), index[0], index[-1])
    better = problem.indentation_correction + more(path.s)
    return np.asarray(better[inside] * np.where(inside == np.arange(len(force)), 1.0, force / force[inside]))


@dataclass(frozen=True)
class SolvedPass:
    """A pass that holds its force: problem (path in its direction of travel), joints, what the model says of them."""

    problem: PassProblem
    solution: PassSolution
    evaluation: Evaluation

    def at(self, nominal: Array) -> dict[str, Array]:
        """What is planned at nominal times (m,) s in contact: p, n, t (m, 3); arc length s m, and where s_mm is zero;
        speed m/s of the contact at the nominal rate; force, force_sd N; interference m."""
        way, path = self.problem.way, self.problem.path
        on = slice(way.touching.start - (way.share[0] == 0), way.touching.stop + (way.share[-1] == 0))
        curves = np.column_stack([path.p, path.n, path.t, self.solution.rate, self.solution.ratio, self.evaluation.force_sd])
        curves = np.column_stack([curves, self.evaluation.delta, path.force, path.feed])[on]
        found = CubicSpline(way.at[on], curves)(nominal)
        p, n, t = (found[:, 3 * i : 3 * i + 3] for i in range(3))
        rate, ratio, sd, delta, force, feed = found[:, 9:].T
        share = way.share_at(nominal)
        n, t = (v / np.linalg.norm(v, axis=1, keepdims=True) for v in (n, t))
        s, begin = way.arc_at(nominal), np.tile(way.arc_at(way.edges[2:3]) - path.start, len(nominal))
        planned = {"p": p, "n": n, "t": t, "s": s, "begin": begin, "speed": share * feed, "force": force * share * rate * ratio}
        return planned | {"force_sd": sd, "interference": delta}

    def grinding(self) -> "SolvedPass":
        """The pass proper alone: the nodes under its full force."""
        return self.part(self.problem.way.grinding > 0)

    def touching(self) -> "SolvedPass":
        """The pass from touch to lift: the nodes that bear force."""
        return self.part(self.problem.way.share > 0)

    def part(self, keep: NDArray[np.bool_]) -> "SolvedPass":
        """Some of the nodes (n,) alone, all arrays cut to them."""
        solution, evaluation = (at_rows(one, keep, len(keep)) for one in (self.solution, self.evaluation))
        return SolvedPass(self.problem.at_nodes(keep), solution, evaluation)


@dataclass(frozen=True)
class GroundLines:
    """Passes that hold their force, what of their lines is left out, and in words what evaluated the model for them."""

    passes: list[SolvedPass]
    left_out: list[LeftOut]
    by: str = ""

    @staticmethod
    def together(parts: Sequence["GroundLines"]) -> "GroundLines":
        """All of them in one, the passes in the order of the lines."""
        passes = sorted((p for one in parts for p in one.passes), key=lambda p: (p.problem.path.line, p.problem.path.start))
        return GroundLines(passes, joined([lost for one in parts for lost in one.left_out]))


class PassWorker:
    """Solves passes one after another with one compiled model: that of its ground, or one handed in."""

    def __init__(self, ground: Ground, solver: PassSolver | None = None) -> None:
        self.ground = ground
        self.solver = solver or PassSolver(ground.cell, ground.law, ground.theta, ground.weights)
        self.scene = CollisionScene(ground.cell, ground.vertices)

    def solve(self, path: BladePath, seeds: list[Seed], compliance: Array, looked: DrivenLine | None = None) -> SolvedPass:
        """The first seed that gives a sound pass; `looked`: the line at the first seed's postures, at whatever feed.

        Raises Infeasible with the first seed's reason where none does.
        """
        reasons: list[Infeasible] = []
        line = None if self.ground.cell.effects else looked  # with effects postures may go with the feed
        for seed in seeds[:FALLBACKS]:
            problem, turned = _from_seed(path, seed, compliance), np.inf
            for led, limit in ATTEMPTS if path.room_before or path.room_after else ATTEMPTS[1:]:
                if limit * self.ground.cell.process.turn_tolerance > turned:  # it would be the same solution
                    continue
                try:
                    line = line or self._driven(problem)
                    whole = self._whole_way(problem, line, led)
                    one = self._solve(replace(whole, turn_limit=limit * self.ground.cell.process.turn_tolerance))
                    refuse_ends(self.ground.cell, self.scene, one)
                    refuse_uneven_leads(self.ground.cell, one, float(path.s[-1]))
                    return one
                except Infeasible as error:
                    back = isinstance(error, CannotGrind) and seed.direction < 0
                    reasons.append(error.turned_round(float(path.s[-1])) if isinstance(error, CannotGrind) and back else error)
                    if not led:
                        if not isinstance(error, TouchesElsewhere):
                            break
                        turned = error.turn
            if isinstance(reasons[-1], PassesNear):
                break
            line = None
        # What takes the least of the line away.
        raise min(reasons, key=lambda e: e.nodes(path.s).sum() if isinstance(e, CannotGrind) and len(e.at) else len(path.s))

    def solve_stretch(
        self, stretch: LineStretch, seeds: list[Seed], whole: bool, looked: DrivenLine | None = None
    ) -> GroundLines:
        """All that can be ground of a piece of a line, and what is left out of it; `whole`: all of it; `looked` of `look`.

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
                found.append(self.solve(one.path, starts, one.compliance, looked if one is stretch else None))
            except Infeasible as error:
                if whole and not isinstance(error, PassesNear):  # lines end there anyway
                    raise
                pieces, gone = cut_out(one, error)
                lost += gone
                open_ += [(piece, []) for piece in pieces]
        return GroundLines(found, lost)

    def look(self, stretch: LineStretch, seed: Seed) -> DrivenLine | None:
        """A piece of a line at the postures of a seed, not optimised yet; None where that is not possible: the optimiser tells
        why."""
        with suppress(Infeasible):
            return self._driven(_from_seed(stretch.path, seed, stretch.compliance))
        return None

    def _driven(self, line: PassProblem) -> DrivenLine:
        """The line of a problem whose nodes are its waypoints. Raises CannotGrind where the wheel bears nowhere on it."""
        cell, path = self.ground.cell, line.path
        q = self.solver.seed_joints(line)
        index = contact_stations(path.s, LOOKED_AT).astype(np.int64)
        seen = self.solver.evaluate(line, q, path.force)
        patches = contacts_along(cell, self.ground.cover, self.ground.cloud, path, seen, index, passed_over=True)
        bearing = self.solver.evaluate(line, q, 0.5 * path.force).stiffness
        entry = entry_of(cell, float(path.force.mean()), float(bearing.max()))
        if patches is None:
            reason = "the wheel bears nowhere on it"
            raise CannotGrind.of(path, np.ones(len(path.s), bool), reason, "use a narrower wheel or larger margins")
        beside = np.interp(path.s, patches.at, patches.indentation) <= 0.0
        beside |= patches.hollow[np.abs(path.s[:, None] - patches.at).argmin(axis=1)]
        if beside.any():  # what bears is beyond the reach of the contact, and the wheel hangs over the line; or on both sides
            reason, remedy = "the wheel bears beside the line, not on it", "use a smaller or narrower wheel, or larger margins"
            raise CannotGrind.of(path, beside, reason, remedy, int(np.argmax(beside)))
        missed = patches.indentation - np.interp(patches.at, path.s, seen.parts[:, 1])
        return DrivenLine(path, patches, missed, entry, lead_room(path, patches, cell.process.edge_force))

    def _whole_way(self, line: PassProblem, driven: DrivenLine, led: bool) -> PassProblem:
        """The way from air to air over a line; `led`: with what leads in to it and out of it."""
        step = float(np.median(np.diff(line.path.s)))
        return air_to_air_problem(line, driven.entry, driven.patches, driven.missed, step, driven.room if led else (0.0, 0.0))

    def _solve(self, problem: PassProblem) -> SolvedPass:
        problem = self.solver.with_approach(problem)
        start = start_on_coarse_grid(self.solver, problem)
        for _ in range(CORRECTIONS):
            solution = self.solver.solve(problem, start)
            solved = self.solver.evaluate(problem, solution.q, solution.force)
            better = solve_directly(self.ground, problem, solution.force, solved)
            off = np.abs((better - problem.indentation_correction) * solved.stiffness).max()
            blocked = self._with_clearances(problem, solution.q)
            turned = self.solver.with_approach(problem, solution.q)
            if off < DIRECT_TOLERANCE and blocked is None and not _turns_differ(problem, turned):
                break
            problem = replace(blocked or problem, indentation_correction=better, approach=turned.approach)
            start = solution
        refuse_unsound(self.ground.cell, self.scene, self.ground.cloud, problem.path, solution, solved)
        refuse_near(self.ground.cell, self.ground.beside, problem.path, solved)
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
    """Raises CannotGrind: something collides, the blade touches elsewhere, the flange is near its pressed stop."""
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
        error = TouchesElsewhere.of(path, where, reason, f"use {_other_wheel(cell, beside)}, or larger margins", beside.index)
        error.turn = float(np.abs(solved.turn).max())
        raise error
    if cell.flange is not None:
        # Parts are along the normal, of which the flange's axis has a share (docs/model.md, eq. 3).
        share, limit = cell.flange_shares(path.n), 0.5 * cell.flange.stroke - STROKE_RESERVE
        beyond = solved.parts[:, 0] - limit * share
        k = int(np.argmax(beyond))
        if beyond[k] > 0:
            stroke = solved.parts[k, 0] / share[k]
            reason = f"the force flange would stand {stroke * 1e3:.2f} mm from its middle, {limit * 1e3:.2f} mm are usable"
            raise CannotGrind.of(path, beyond > 0, reason, "set force_N nearer to the flange's setpoint", k)


def refuse_near(cell: Cell, beside: Array, path: BladePath, solved: Evaluation) -> None:
    """Raises PassesNear where the wheel, as it stands turned and tilted, passes points `beside` (k, 3) m, blade frame, of
    block, platform, fillet or shroud nearer than lines keep away from them (GAP)."""
    poses = solved.T_base_blade.copy()
    # Flange, blade and arm give way: what of the overlap is not the wheel's stands between blade and wheel.
    poses[:, :3, 3] += (solved.delta - solved.parts[:, 1])[:, None] * cell.wheel.outward(solved.arc)
    room = wheel_room(cell.wheel, beside, poses)
    if room.min() < GAP:
        raise PassesNear.of(path, room < GAP, *NO_ROOM, int(np.argmin(room)))


def refuse_ends(cell: Cell, scene: CollisionScene, one: SolvedPass) -> None:
    """Raises CannotGrind with what lies before the first and behind the last waypoint at which the blade can be lifted off the
    wheel: there a pass could not be begun or ended."""
    one = one.touching()
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


def force_tolerance(cell: Cell) -> float:
    """N that the program read back may be off by, with the cell's flange or without one."""
    return RIGID_FORCE_TOLERANCE if cell.flange is None else FLANGE_FORCE_TOLERANCE


def refuse_uneven_leads(cell: Cell, one: SolvedPass, length: float) -> None:
    """Raises CannotGrind of a pass that is led in or out, beyond its line of `length` m, over a surface so uneven that its force
    would not be held between two nodes: a fillet or a step that the line itself keeps away from."""
    path, off = one.problem.path, one.problem.indentation_correction * one.evaluation.stiffness
    bend = np.concatenate([[0.0], 0.5 * np.abs(np.diff(off, 2)), [0.0]])
    where = (bend > force_tolerance(cell)) & ((path.s < 0.0) | (path.s > length))
    if where.any():
        k = int(np.argmax(bend * where))
        raise CannotGrind.of(path, where, "the surface beside the line is too uneven to be led in over", "use larger margins", k)


def _other_wheel(cell: Cell, beside: SecondaryContact) -> str:
    """The wheel that would not reach what is touched beside the contact."""
    narrower = 2.0 * abs(beside.lateral) - 2.0 * WHEEL_ROOM
    if narrower > 0.2 * cell.wheel.width:
        return f"a wheel at most {np.floor(1e3 * narrower):.0f} mm wide"
    return "a smaller or narrower wheel"


def _from_seed(path: BladePath, seed: Seed, compliance: Array) -> PassProblem:
    """The pass along the line in the seed's direction."""
    problem = PassProblem.start(path, seed, compliance)
    return problem if seed.direction > 0 else with_direction(problem, reversed_path(path))


def _turns_differ(one: PassProblem, other: PassProblem) -> bool:
    """Do the signs of the axes' motion differ by more than a tenth anywhere?"""
    if one.approach is None or other.approach is None:
        return False
    return bool(np.abs(one.approach - other.approach).max() > SIGN_TOLERANCE)


_worker: PassWorker | None = None


def _start_worker(ground: Ground, derived: dict[str, Any]) -> None:
    global _worker
    _worker = PassWorker(ground, PassSolver(ground.cell, ground.law, ground.theta, ground.weights, derived=derived))


def _look_in_worker(stretch: LineStretch, seed: Seed) -> DrivenLine | None:
    assert _worker is not None
    return _worker.look(stretch, seed)


def _solve_in_worker(stretch: LineStretch, seeds: list[Seed], whole: bool, looked: DrivenLine | None) -> GroundLines:
    assert _worker is not None
    return _worker.solve_stretch(stretch, seeds, whole, looked)


def solve_passes(
    ground: Ground,
    solver: PassSolver,
    stretches: list[LineStretch],
    seeds: list[list[Seed]],
    whole: bool = True,
    feeds: Feeds | None = None,
    advance: Callable[[], None] = lambda: None,
) -> GroundLines:
    """Solve every pass by the `solver` of its ground, in worker processes where there are several cores; what cannot be ground is
    left out.

    `feeds`: the feeds of all lines, from what they are at the postures of their seeds; without, they are driven as they are.
    Raises Infeasible of the first pass (in order) that has no sound solution if the `whole` of all of them is asked for.
    """
    jobs = min(cores(), len(stretches))
    starts = [options[0] for options in seeds]
    looked: Sequence[DrivenLine | None] = [None] * len(stretches)
    if jobs <= 1:
        worker = PassWorker(ground, solver)
        if feeds is not None:
            looked = [worker.look(*task) for task in zip(stretches, starts, strict=True)]
            stretches = _at_feeds(stretches, starts, feeds(looked))
        solved = []
        for stretch, options, line in zip(stretches, seeds, looked, strict=True):
            solved.append(worker.solve_stretch(stretch, options, whole, line))
            advance()
        return GroundLines.together(solved)
    with workers(jobs, _start_worker, ground, solver.stage.derived) as pool:
        if feeds is not None:
            looked = list(pool.map(_look_in_worker, stretches, starts))
            stretches = _at_feeds(stretches, starts, feeds(looked))
        with interrupts_held_back():
            tasks = zip(stretches, seeds, looked, strict=True)
            futures = [pool.submit(_solve_in_worker, stretch, options, whole, line) for stretch, options, line in tasks]
        for future in futures:
            future.add_done_callback(lambda _: advance())
        return GroundLines.together([future.result() for future in futures])


def compiled_solver(cell: Cell, law: WheelLaw, theta: Theta, weights: ObjectiveWeights, paths: Sequence[BladePath]) -> PassSolver:
    """What solves the passes over `paths`; machine code is made of what it evaluates where that is quicker than to do without."""
    solver = PassSolver(cell, law, theta, weights)
    if sum(len(path.s) for path in paths) >= WORTH_COMPILING:
        solver.compile()
    else:
        left_uncompiled(f"machine code is made for {WORTH_COMPILING} waypoints and more, or what is tried long")
    return solver


def _at_feeds(stretches: list[LineStretch], seeds: list[Seed], feeds: Sequence[Array | None]) -> list[LineStretch]:
    """The pieces at other feeds, given in the directions of their seeds."""
    return [
        one if feed is None else replace(one, path=replace(one.path, feed=feed[:: seed.direction]))
        for one, seed, feed in zip(stretches, seeds, feeds, strict=True)
    ]


def remembered_passes(
    ground: Ground,
    paths: list[BladePath],
    compliance: list[Array],
    solve: Callable[[], GroundLines],
    whole: bool = True,
    even: bool = False,
) -> GroundLines:
    """What can be ground of `paths` on `ground` with the blade's compliance: kept ones, else those of `solve`; `even`: at feeds
    that follow from those of the paths."""
    content = flattened((ground, paths, compliance))
    parts = [part for name, array in sorted(content.items()) if not name.endswith(FILES) for part in (name, array)]

    def counted() -> Entry:
        found = solve()
        counts = [len(found.passes), len(found.left_out)]
        return flattened({"passes": found.passes, "left_out": found.left_out, "count": counts, "by": evaluated_by()})

    entry = remember("passes", content_key(code_hash(), whole, even, *parts), counted)
    passes = [rebuilt(SolvedPass, entry, f".passes.{i}") for i in range(int(entry[".count.0"]))]
    lost = [rebuilt(LeftOut, entry, f".left_out.{i}") for i in range(int(entry[".count.1"]))]
    return GroundLines(passes, lost, str(entry[".by"]))
