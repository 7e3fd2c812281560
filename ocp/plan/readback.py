"""The written text taken as the only truth: read, re-interpolated, and its force predicted by the second route."""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from scipy.interpolate import PchipInterpolator

from ocp.contact.wheel.cover import Cover
from ocp.model.blade_gap import SurfaceCloud
from ocp.model.cell import Cell
from ocp.plan.motion import MotionSegment, PlannedMotion
from ocp.plan.passes.optimise import LEAST_DIRECT, SolvedPass, force_tolerance
from ocp.plan.passes.stretches import CannotGrind
from ocp.plan.rules import (
    BLOCK_TIME_TOLERANCE,
    EMITTED_TOLERANCE,
    GAP_TOLERANCE,
    LEAST_STRETCH,
    LEAVING,
    RAMP_SHARE,
    READ_BACK_LIMIT,
    RIGID_FORCE_TOLERANCE,
    STRAY,
)
from ocp.plan.second_route import BelievedRobot, VerifiedPass, gaps, verify_pass
from ocp.shell.processes import side_by_side
from robots.errors import Infeasible
from robots.pose import Array
from trajectories.dialects import dialect_named
from trajectories.joint_trajectory import SAMPLE, JointTrajectory
from trajectories.passes import BladePath
from trajectories.program.driven import axes_along, axis_gains, drive_lines, programmed_poses, reinterpolate
from trajectories.program.execution import Execution, ProgramSegment
from trajectories.toppra_law import times_at

PROJECTIONS = 4  # Newton steps to the planned instant whose posture is nearest


@dataclass(frozen=True)
class BlendError:
    """What the blending of straight motions costs by the model of this reader, at most over all passes: force N off the planned
    one on the ramps, and as a share the integral of force over time along any LEAST_STRETCH of a line."""

    force: float
    dose: float


@dataclass(frozen=True)
class Readback:
    """What the text says: force by the second route per pass in driving order; largest differences to the plan.

    force_error N against the programmed force; axis_error rad and time_error s against the planned motion; limit_ratio
    of the re-interpolated axes at 1 ms (nan for programs whose timing is the controller's); touching_in_air s: contact of blade
    and wheel where none is planned; blends: of programs of straight motions, whose force is held against the plan in the passes
    alone.
    """

    passes: list[VerifiedPass]
    force_error: float
    axis_error: float
    time_error: float
    limit_ratio: float
    touching_in_air: float
    blends: BlendError | None = None


def read_back(
    cell: Cell,
    believed: BelievedRobot,
    cover: Cover,
    cloud: SurfaceCloud,
    motion: PlannedMotion,
    main: Path,
    meanwhile: Callable[[], None] = lambda: None,
) -> Readback:
    """Read the program `main` and judge it; `meanwhile` is done while others predict its forces.

    Raises BadInput as the reader does, CannotGrind of the passes whose force is not what was planned, Infeasible where times or
    limits are not.
    """
    controller = cell.controller
    execution = dialect_named(controller.dialect).check(main, cell.robot, controller.absolute_accuracy)
    timed = all(s.times is not None or s.kind == "point" for s in execution.segments)
    driven, axis_error, time_error, ratio = (_timed if timed else _chained)(cell, motion, execution)
    blends = None if timed else BlendError(0.0, 0.0)
    passes, worst, in_air = [], 0.0, 0.0
    unheld: list[CannotGrind] = []
    tasks = [(one, *rows) for one, rows in zip(motion.passes, driven, strict=True)]
    with side_by_side(_checked, tasks, cell, believed, cover, cloud) as checks:
        meanwhile()
        found = list(checks)
    for place, (seconds, path, checked) in enumerate(found):
        held, in_air = checked, in_air + seconds
        if blends is not None:
            held, off = _apart(motion, place, driven[place], checked)
            blends = BlendError(max(blends.force, off.force), max(blends.dose, off.dose))
        try:
            worst = max(worst, force_error(cell, path, held))
        except CannotGrind as error:
            unheld.append(error)
        passes.append(checked)
    if unheld:
        raise unheld[0].with_others(unheld[1:])
    return Readback(passes, worst, axis_error, time_error, ratio, in_air, blends)


def _checked(
    cell: Cell, believed: BelievedRobot, cover: Cover, cloud: SurfaceCloud, one: SolvedPass, *rows: Array
) -> tuple[float, BladePath, VerifiedPass]:
    """Seconds of touching in the air of a pass, its path where it bears, and the force there. Raises as `_touching_in_air`."""
    seconds = _touching_in_air(cell, believed, one, *rows)
    task = _bearing(cell, one, *rows)
    return seconds, task[0], verify_pass(cell, believed, cover, cloud, *task)


def _bearing(cell: Cell, one: SolvedPass, t: Array, q: Array, nominal: Array) -> tuple[Any, ...]:
    """The task of `verify_pass` for the rows of a pass (times t, joints q, nominal times) that bear LEAST_DIRECT of its force:
    with the force that is planned there."""
    bears = one.solution.force >= LEAST_DIRECT * one.problem.path.force
    part = one.part(bears)
    first, last = part.problem.way.at[[0, -1]]
    rows = (nominal >= first) & (nominal <= last)
    planned, conditions = one.at(nominal[rows]), part.problem.named_conditions(cell)
    return part.problem.path, part.problem.compliance, t[rows], q[rows], planned["s"], conditions, planned["force"]


def _touching_in_air(cell: Cell, believed: BelievedRobot, one: SolvedPass, t: Array, q: Array, nominal: Array) -> float:
    """Seconds in which blade and wheel touch on the way through the air, before the force is planned to rise and after it fell,
    deeper than the text is rounded.

    Raises CannotGrind where the plan has a gap of more than GAP_TOLERANCE there.
    """
    way, path, seconds = one.problem.way, one.problem.path, 0.0
    for end, rows in ((0, nominal < way.edges[1]), (-1, nominal > way.edges[4])):
        if not rows.any():
            continue
        named = one.problem.named_conditions(cell)
        conditions = {name: PchipInterpolator(way.at, value)(nominal[rows]) for name, value in named.items()}
        touching = -gaps(cell, believed, path, end, one.problem.compliance[end], q[rows], conditions)
        early = touching[way.gap_at(nominal[rows]) > GAP_TOLERANCE].max(initial=-np.inf)
        if early >= 0:
            reason = f"blade and wheel would touch in the air, {early * 1e3:.2f} mm deep, by the independent route"
            raise CannotGrind.of(path, np.ones(len(path.s), bool), reason, "move the wheel or the blade in its holder")
        seconds += float((touching > EMITTED_TOLERANCE[1]).sum()) * float(np.median(np.diff(t)))
    return seconds


def force_error(cell: Cell, path: BladePath, seen: VerifiedPass) -> float:
    """Largest difference N along a pass between the force read back and the one asked for.

    Raises CannotGrind where it is more than a program may be off by; on a ramp as without a flange until that leaves its stop,
    which is as stiff.
    """
    full = np.interp(seen.s, path.s, path.force)
    stiff = (seen.stopped > 0) & (seen.planned < np.minimum(seen.stopped + LEAVING, RAMP_SHARE * full))
    tolerance = np.where(stiff, RIGID_FORCE_TOLERANCE, force_tolerance(cell))
    off = np.abs(seen.force - seen.planned)
    k = int(np.argmax(off / tolerance))
    if off[k] > tolerance[k]:
        reason = (
            f"the force read back from the program is {seen.force[k]:.2f} N by the independent route, {off[k]:.2f} N off "
            f"(at most {tolerance[k]:g})"
        )
        would_do = "use a shorter --step or a narrower wheel"
        if stiff[k]:
            reason += f", where the flange bears on its stop, up to {seen.stopped[k]:.1f} N"
            would_do = "lower force_flange.setpoint_N until its stroke and stiffness carry it"
        message = f"line {path.line} ({path.side}), {seen.s[k] * 1e3:.1f} mm along it: {reason}; nothing is written"
        where = np.interp(path.s, seen.s, off / tolerance) > 1.0
        raise CannotGrind.of(path, where, reason, would_do, message=message)
    return float(off.max())


Driven = list[tuple[Array, Array, Array]]  # times s, joints, nominal times s of every pass


def _nominal(motion: PlannedMotion, segment: MotionSegment, t: Array) -> Array:
    """Nominal time (m,) s of a pass at times t (m,) s since its start."""
    return np.asarray(segment.trajectory.s(t) / float(motion.passes[segment.place].problem.path.feed.mean()))


def _timed(cell: Cell, motion: PlannedMotion, execution: Execution) -> tuple[Driven, float, float, float]:
    """Programs of timed blocks: the pieces of the text are the segments of the motion, one to one."""
    program = reinterpolate(execution, cell.robot)
    if len(program.pieces) != len(motion.segments):
        raise Infeasible(f"the program read back has {len(program.pieces)} timed blocks, {len(motion.segments)} were planned")
    ends = np.append(program.starts[1:], program.duration)
    driven: Driven = []
    axis_error = time_error = ratio = 0.0
    for segment, start, end in zip(motion.segments, program.starts, ends, strict=True):
        time_error = max(time_error, abs(end - start - segment.trajectory.duration))
        t = np.append(np.arange(0.0, end - start, SAMPLE), end - start)
        q = program.q(start + np.minimum(t, end - start - 1e-9))
        axis_error = max(axis_error, float(np.abs(q - segment.trajectory.q(t)).max()))
        use = np.abs(program.qd(start + t[:-1]) / cell.robot.qd_max), np.abs(program.qdd(start + t[:-1]) / cell.robot.qdd_max)
        ratio = max(ratio, float(use[0].max()), float(use[1].max()))
        if segment.kind == "pass":
            driven.append((t, q, _nominal(motion, segment, t)))
    if time_error > BLOCK_TIME_TOLERANCE:
        raise Infeasible(f"a block of the program lasts {time_error * 1e3:.2f} ms longer or shorter than planned (at most 1)")
    if ratio > READ_BACK_LIMIT:
        raise Infeasible(f"the program read back would use {ratio:.3f} of an axis limit between its points; nothing is written")
    return driven, axis_error, time_error, ratio


def _chained(cell: Cell, motion: PlannedMotion, execution: Execution) -> tuple[Driven, float, float, float]:
    """Programs of straight motions that blend: one chain a pass, from air to air.

    Raises Infeasible where the robot would rest between, or goes elsewhere than planned.
    """
    chains: list[list[ProgramSegment]] = []
    begins: list[Array] = []
    where, on = np.zeros(6), False
    for s in execution.segments:
        if s.kind == "line" and not on:
            chains.append([])
            begins.append(where)
        if s.kind == "line":
            chains[-1].append(s)
        elif s.q is not None:
            where = s.q[-1]
        on = s.blended
    planned = [s for s in motion.segments if s.kind == "pass"]
    if len(chains) != len(planned):
        raise Infeasible(
            f"the program read back has {len(chains)} chains of straight motions, {len(planned)} were planned: the robot would "
            "rest between"
        )
    driven: Driven = []
    axis_error = time_error = 0.0
    for segment, chain, begin in zip(planned, chains, begins, strict=True):
        frames, way = chain[0].frames, segment.trajectory
        if frames.tool is None or frames.base is None:
            raise Infeasible("the program read back does not set its tool and base frames")
        poses = np.concatenate(
            [programmed_poses(frames, cell.robot, begin[None]), *(s.poses for s in chain if s.poses is not None)]
        )
        written = axes_along(cell.robot, frames, poses, begin)
        lost = np.flatnonzero(np.isnan(written).any(axis=1))
        if len(lost):
            raise Infeasible(f"{chain[max(lost[0] - 1, 0)].place()}: the arm does not reach this pose; nothing is written")
        lines = drive_lines(chain, poses[0], axis_gains(cell.robot, poses, written))
        q = axes_along(cell.robot, frames, lines.poses, begin)
        at = _nearest(way, q)
        off = np.abs(q - way.q(at)).max(axis=1)
        ends = max(float(np.abs(q[k] - way.q(end)).max()) for k, end in ((0, 0.0), (-1, way.duration)))
        if not max(float(off.max()), ends) <= STRAY:
            raise Infeasible(f"{chain[0].place()}: the straight motions read back leave the plan; nothing is written")
        axis_error, time_error = max(axis_error, float(off.max())), max(time_error, abs(lines.times[-1] - way.duration))
        driven.append((lines.times, q, _nominal(motion, segment, at)))
    return driven, axis_error, time_error, float("nan")


def _nearest(way: JointTrajectory, q: Array) -> Array:
    """When (m,) s the planned motion is nearest to postures q (m, 6) that follow it in order."""
    times = np.append(np.arange(0.0, way.duration, SAMPLE), way.duration)
    planned = way.q(times)
    at = times[np.array([int(np.argmin(np.abs(planned - one).max(axis=1))) for one in q])]
    for _ in range(PROJECTIONS):
        speed = way.qd(at)
        step = np.einsum("ij,ij->i", q - way.q(at), speed) / np.maximum(np.einsum("ij,ij->i", speed, speed), 1e-9)
        at = np.clip(at + np.clip(step, -SAMPLE, SAMPLE), 0.0, way.duration)
    return np.asarray(np.maximum.accumulate(at))


def _apart(
    motion: PlannedMotion, place: int, rows: tuple[Array, Array, Array], checked: VerifiedPass
) -> tuple[VerifiedPass, BlendError]:
    """Of a pass of straight motions what was verified under its full force, and how far the ramps beside are off."""
    one, (t, _, nominal) = motion.passes[place], rows
    at = np.interp(checked.time, t, nominal)
    _, _, begin, end, *_ = one.problem.way.edges
    full = (at >= begin) & (at <= end)
    off = np.abs(checked.force - checked.planned)[~full].max(initial=0.0)
    when = times_at(motion.way(place).trajectory.law, at * float(one.problem.path.feed.mean()))
    first, last = checked.s[0], checked.s[-1]
    begins = np.linspace(first, max(first, last - LEAST_STRETCH), 200)
    doses = []
    for force, clock in ((checked.force, checked.time), (checked.planned, when)):
        total = np.concatenate([[0.0], np.cumsum(0.5 * (force[1:] + force[:-1]) * np.diff(clock))])
        doses.append(np.interp(np.minimum(begins + LEAST_STRETCH, last), checked.s, total) - np.interp(begins, checked.s, total))
    dose = float(np.abs(doses[0] / doses[1] - 1.0).max())
    return VerifiedPass(**{name: value[full] for name, value in vars(checked).items()}), BlendError(float(off), dose)
