"""The main job as a function: cell and blade in, a verified motion out. Writing it is `ocp.plan.files`."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cache, partial
from pathlib import Path

import numpy as np

from ocp.contact.wheel.cover import Cover
from ocp.contact.wheel.law import WheelLaw
from ocp.effects.effect import Effect
from ocp.effects.patch import PATCH, lengths_outside
from ocp.model.blade_gap import SurfaceCloud
from ocp.model.cell import Cell, floor_notices, history_notices, load_notices, named_files, read_cell
from ocp.model.prepare import ContactModel, prepare_contact
from ocp.model.theta import Theta, registered
from ocp.plan.accuracy import WorkingAccuracy, working_accuracy
from ocp.plan.clearance import CollisionScene
from ocp.plan.motion import PlannedMotion, build_motion
from ocp.plan.passes.optimise import Ground, GroundLines, SolvedPass, compiled_solver, remembered_passes, solve_passes
from ocp.plan.passes.posture import seeds_of_stretches
from ocp.plan.passes.stage import ObjectiveWeights
from ocp.plan.passes.stretches import (
    CannotGrind,
    LeftOut,
    as_driven,
    joined,
    refuse_mostly_left_out,
    ungrindable_notices,
    whole_lines,
    without_places,
)
from ocp.plan.paths import LaidPaths, PlanOptions, lay_paths, refuse_flange
from ocp.plan.programming import program_setup
from ocp.plan.removal.dwell import even_feeds, feeds_told
from ocp.plan.removal.result import Removal, find_removal
from ocp.plan.rules import LEAST_STEP, MOST_STEP
from ocp.shell.progress import Phases
from robots.errors import BadInput, Infeasible
from robots.inverse import refuse_other_arm
from robots.payload import refuse_overload
from robots.robot import refuse_left_out
from trajectories.blade import Blade
from trajectories.passes import BladePath, reversed_path
from trajectories.program.program import KINDS, refuse_poses

FULL = 0.99  # of the force asked for, from which a line is said to reach it
FORCE_SD_WEIGHT = 1.0  # of the objective where a calibration tells how sure the force is and posture changes it


@dataclass(frozen=True)
class Plan:
    """A motion that holds the force, with all that the files and the report need; `lines` as they were laid, and what of them is
    left out; in words, what `evaluated_by`."""

    cell: Cell
    theta: Theta
    blade: Blade
    motion: PlannedMotion
    cover: Cover
    cloud: SurfaceCloud
    kind: str
    name: str
    inputs: tuple[tuple[str, Path], ...]
    notices: tuple[str, ...]
    wheel_error: float
    compliance_error: float
    removal: Removal
    accuracy: tuple[WorkingAccuracy, ...]
    lines: tuple[BladePath, ...]
    left_out: tuple[LeftOut, ...]
    whole: bool
    evaluated_by: str
    again: Callable[[GroundLines], "Plan"]

    def without(self, error: CannotGrind) -> "Plan":
        """The plan of the other passes than those that `error` names. Raises Infeasible where too little remains."""
        lost = [replace(one, turned=0.0) for one in self.left_out]
        return self.again(left_out_too(GroundLines(self.motion.passes, lost, self.evaluated_by), [error, *error.others]))

    @property
    def force_sd(self) -> float:
        """Largest standard deviation of the force on the real cell, N, where all of it is asked for."""
        return max(float(p.grinding().evaluation.force_sd.max()) for p in self.motion.passes)

    @property
    def waypoints(self) -> int:
        """Waypoints of all passes."""
        return sum(len(p.problem.path.s) for p in self.motion.passes)


def make_plan(cell_file: Path, blade_file: Path | None, options: PlanOptions, phases: Phases) -> Plan:
    """Plan the grinding of a blade in a cell.

    Raises BadInput (exit code 2) and Infeasible (exit code 1) of every part, one sentence each.
    """
    believed, told = cell_to_plan(cell_file, blade_file, options)
    cell, theta = registered(believed)
    stl = cell.workpiece.stl
    assert stl is not None
    with phases.phase("passes"):
        laid = lay_paths(cell, stl, options)
        refuse_flange(cell, laid.paths)
    weights = objective_weights(cell)

    def compiled(law: WheelLaw) -> None:
        with phases.phase("machine code"):
            compiled_solver(cell, law, theta, weights, laid.paths)

    contact = prepare_contact(cell, laid.blade, laid.paths, phases, compiled)
    _refuse_forces(laid.paths, contact.law.limits["force"], options)
    scene = CollisionScene(cell, laid.blade.vertices)
    ground = Ground(cell, theta, weights, contact.law, contact.cover, laid.blade.vertices, laid.cloud, laid.beside)
    compliance = [np.asarray(c) for c in contact.compliance.per_pass]

    # What is beyond reach is told with the depths of this run: it stays out of what is remembered.
    whole, short = whole_lines(laid.paths, compliance, options.whole)
    whole, deep = without_places(whole, laid.beyond, options.whole)
    refuse_mostly_left_out(laid.paths, [*short, *deep])

    feeds = partial(even_feeds, cell, laid.flanks, laid.wanted) if options.fitted else None

    def solve() -> GroundLines:
        solver = cache(lambda: compiled_solver(cell, contact.law, theta, weights, [one.path for one in whole]))
        with phases.phase("postures"):
            stretches, seeds, lost = seeds_of_stretches(cell, scene, contact.law, whole, options.whole, solver)
        with phases.phase("optimal control", len(stretches)) as advance:
            found = solve_passes(ground, solver(), stretches, seeds, options.whole, feeds, advance)
        return GroundLines(found.passes, joined([*lost, *found.left_out]))

    solved = remembered_passes(ground, laid.paths, compliance, solve, options.whole, options.fitted)
    solved = replace(solved, left_out=joined([*short, *deep, *solved.left_out]))
    notices = (*(cell.calibration.notices if cell.calibration is not None else ()), *laid.notices, *told)
    job = Job(believed, ground, scene, laid, contact, options, phases, notices)
    return planned_motion(job, solved)


def cell_to_plan(cell_file: Path, blade_file: Path | None, options: PlanOptions) -> tuple[Cell, list[str]]:
    """The cell as its file has it, and what could not be checked of it. Raises BadInput: it, or what is asked for, cannot be
    planned whatever the blade is."""
    cell = read_cell(cell_file, blade_file)
    refuse_left_out(cell_file, cell.robot, "a plan")
    refuse_other_arm(cell_file, cell.robot, "a plan")
    if cell.workpiece.stl is None:
        raise BadInput(f"{cell_file}: no blade; name it on the command line or as workpiece.stl")
    _refuse_options(cell_file, cell, options)
    hanging = {cell.workpiece.payload_name: cell.workpiece.payload}
    told = history_notices(cell, "no part of the plan; friction of the flange is in the force's standard deviation")
    return cell, told + load_notices(cell) + floor_notices(cell) + refuse_overload(str(cell_file), cell.robot, hanging)


@dataclass(frozen=True)
class Job:
    """All that a plan is made of before its passes are put in order; `believed`: the cell as its file has it."""

    believed: Cell
    ground: Ground
    scene: CollisionScene
    laid: LaidPaths
    contact: ContactModel
    options: PlanOptions
    phases: Phases
    notices: tuple[str, ...]

    def inputs(self) -> tuple[tuple[str, Path], ...]:
        """The files that the plan is made from, by their part."""
        cell, options = self.believed, self.options
        there = named_files(cell.path, cell.tables)
        named = [("cell", cell.path), ("blade", cell.workpiece.stl), ("robot", there.get("robot"))]
        named += [("path", options.path), ("program", options.program), ("stock", options.stock)]
        named += [("calibration", there.get("calibration"))]
        return tuple((role, file) for role, file in named if file is not None)


def planned_motion(job: Job, solved: GroundLines) -> Plan:
    """The motion through the passes, what it takes off the blade and what is left out.

    Raises Infeasible: no motion, or too little of the surface on it.
    """
    cell, laid, contact, whole = job.ground.cell, job.laid, job.contact, job.options.whole
    with job.phases.phase("timing", len(solved.passes)) as advance:
        motion, lost = reachable_motion(cell, job.scene, solved, whole, advance)
    refuse_mostly_left_out(laid.paths, lost)
    lost = as_driven(lost, laid.paths, {p.problem.path.line for p in motion.passes if p.problem.seed.direction < 0})
    accuracy = cache(lambda: working_accuracy(job.believed, cell, job.ground.theta, contact.law, motion.passes))
    with job.phases.phase("removal"):
        removal = find_removal(cell, motion, contact.cover, laid.cloud, laid.flanks, laid.wanted, accuracy)
    told = [
        *removal.beside_told(),
        *corrected_for(cell),
        *patch_notices(cell, motion.passes),
        *softer_notices([p.grinding() for p in motion.passes]),
    ]
    if job.options.fitted:
        told.insert(0, feeds_told(cell, [p.grinding().problem.path for p in motion.passes], laid.wanted, job.options.laid))

    return Plan(
        cell=cell,
        theta=job.ground.theta,
        blade=laid.blade,
        motion=motion,
        cover=contact.cover,
        cloud=laid.cloud,
        kind=job.options.kind,
        name=job.options.name or Path(str(cell.workpiece.stl)).name,
        inputs=job.inputs(),
        notices=(*job.notices, *told, *ungrindable_notices(lost)),
        wheel_error=contact.law.error,
        compliance_error=float(np.max(contact.compliance.interpolation_error)),
        removal=removal,
        accuracy=tuple(accuracy()),
        lines=tuple(laid.paths),
        left_out=tuple(lost),
        whole=whole,
        evaluated_by=solved.by,
        again=partial(planned_motion, job),
    )


def softer_notices(passes: Sequence[SolvedPass]) -> list[str]:
    """A sentence on the lines that are too short, at their feed, for the force to rise to what is asked for."""
    softer = sorted((one.problem.way.peak, i) for i, one in enumerate(passes) if one.problem.way.peak < FULL)
    if not softer:
        return []
    peak, worst = softer[0]
    path = passes[worst].problem.path
    feed, force = 1e3 * float(path.feed.mean()), float(path.force.max())
    others = ", ".join(str(passes[i].problem.path.line) for _, i in softer[1:])
    less = f" (less so lines {others})" if others else ""
    return [
        f"line {path.line} ({path.side}) is too short at {feed:.3g} mm/s for the force to rise and fall: it "
        f"reaches {peak * force:.1f} of {force:g} N, at as much less of its feed{less}; "
        f"for the whole force ask for at most {peak * feed:.3g} mm/s there, or make the line longer"
    ]


def corrected_for(cell: Cell) -> list[str]:
    """A sentence on what of the cell the commands are corrected for beside its calibration."""
    moving = [e for e in cell.effects if _moves(e.active.effect)]
    names = [f"{e.name} of joint {e.joint}" if e.joint else e.name for e in moving]
    return [f"the commands are corrected for what {cell.path.name} names: {', '.join(names)}"] if names else []


def _moves(effect: Effect) -> bool:
    """Whether it moves the arm, wheel or blade, and is no matter of when something is recorded."""
    hooks = effect.joint, effect.torque, effect.twist, effect.overlap, effect.push
    return effect.subsystem != "timing" and any(hook is not None for hook in hooks)


def patch_notices(cell: Cell, passes: Sequence[SolvedPass]) -> list[str]:
    """Sentences on the cell's patches whose measured range of joints the passes leave: there they fade, and correct nothing."""
    q, found = np.concatenate([one.solution.q for one in passes]), []
    axes = {f"q{j + 1}": q[:, j] for j in range(6)}
    for one in (effect.active for effect in cell.effects if effect.name.startswith(PATCH)):
        ranges = [r for r in one.scanned["range"] if r[0] in axes]
        away = lengths_outside(replace(one, scanned={**one.scanned, "range": ranges}), axes) > 1.0
        if away.any():
            told = ", ".join(f"{name} {np.degrees(low):.0f} to {np.degrees(high):.0f} deg" for name, low, high in ranges)
            found.append(
                f"{np.count_nonzero(away)} of {len(away)} waypoints lie outside what a {one.effect.title} of {cell.path.name} "
                f"was fitted to ({told}): there it fades out and corrects little or nothing"
            )
    return found


def left_out_too(ground: GroundLines, errors: list[CannotGrind]) -> GroundLines:
    """Without the passes that the errors name."""
    passes, lost = list(ground.passes), list(ground.left_out)
    for error in errors:
        place = next(i for i, p in enumerate(passes) if (p.problem.path.line, p.problem.path.start) == error.whose)
        gone = passes.pop(place).problem
        path = gone.path if gone.seed.direction > 0 else reversed_path(gone.path)
        lost.append(LeftOut(path.line, path.side, path.start, path.start + path.s[-1], error.reason, error.would_do))
    return GroundLines(passes, lost, ground.by)


def objective_weights(cell: Cell) -> ObjectiveWeights:
    """The standard deviation of the force is an aim only where it moves: on a rigid mount of a calibrated cell.

    A force flange divides it by the ratio of the stiffnesses, in every posture alike.
    """
    aims = cell.calibration is not None and cell.flange is None
    return ObjectiveWeights(force_sd=FORCE_SD_WEIGHT if aims else 0.0)


def reachable_motion(
    cell: Cell, scene: CollisionScene, solved: GroundLines, whole: bool, advance: Callable[[], None]
) -> tuple[PlannedMotion, list[LeftOut]]:
    """The motion through all passes that the arm can come to and leave, and what is left out with those that it cannot.

    Raises Infeasible as `build_motion` does if the `whole` of them is asked for, or nothing remains.
    """
    while solved.passes:
        try:
            return build_motion(cell, scene, solved.passes, advance), joined(solved.left_out)
        except CannotGrind as error:
            if whole:
                raise
            solved = left_out_too(solved, [error])
    worst = max(joined(solved.left_out), key=lambda one: one.length)
    raise Infeasible(
        f"nothing of the blade can be ground: {worst.clause()}; what of the cell looks wrong says "
        f"python -m ocp.cell check {cell.path}"
    )


def _refuse_options(cell_file: Path, cell: Cell, options: PlanOptions) -> None:
    """Refuse what the command line asks for and nobody can plan, or what this cell's controller would correct twice."""
    if options.kind not in KINDS:
        raise BadInput(f"--kind '{options.kind}' is not axis, cartesian or lin")
    refuse_poses(program_setup(cell, cell.workpiece.payload, options.kind), f"{cell_file}: ")
    if options.path is not None and options.program is not None:
        raise BadInput("--path and --program both say where the path comes from; give one of them")
    if not LEAST_STEP <= options.step <= MOST_STEP:
        raise BadInput(
            f"--step {options.step * 1e3:g} mm is not between {LEAST_STEP * 1e3:g} and {MOST_STEP * 1e3:g} mm; 1 is usual"
        )


def _refuse_forces(paths: list[BladePath], limits: tuple[float, float], options: PlanOptions) -> None:
    """A path made elsewhere may ask for forces that the wheel's table was not made for."""
    for path in paths:
        for k in np.flatnonzero((path.force < limits[0]) | (path.force > limits[1]))[:1]:
            raise BadInput(
                f"{options.path or options.program}: line {path.line}, point {k + 1} asks for {path.force[k]:g} N; the wheel's "
                f"contact is known from {limits[0]:.1f} to {limits[1]:.1f} N about process.force_N; change that or the path"
            )
