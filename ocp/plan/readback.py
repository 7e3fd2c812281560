"""The written text taken as the only truth: read, re-interpolated, and its force predicted by the second route."""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from scipy.interpolate import PchipInterpolator

from ocp.contact.wheel.cover import Cover
from ocp.model.blade_gap import SurfaceCloud
from ocp.model.cell import Cell
from ocp.plan.motion import MotionSegment, PlannedMotion
from ocp.plan.passes.optimise import LEAST_DIRECT, SolvedPass
from ocp.plan.passes.stretches import CannotGrind
from ocp.plan.rules import (
    BLOCK_TIME_TOLERANCE,
    EMITTED_TOLERANCE,
    FLANGE_FORCE_TOLERANCE,
    GAP_TOLERANCE,
    READ_BACK_LIMIT,
    RIGID_FORCE_TOLERANCE,
)
from ocp.plan.second_route import BelievedRobot, VerifiedPass, gaps, verify_pass
from ocp.shell.processes import cores, interrupts_held_back, workers
from robots.errors import Infeasible
from robots.inverse import inverse_branches
from robots.pose import Array, invert
from trajectories.dialects import dialect_named
from trajectories.joint_trajectory import SAMPLE
from trajectories.passes import BladePath
from trajectories.program.execution import Execution
from trajectories.program.interpolation import pose_spline, reinterpolate

POSE_STEP = 2e-3  # m between poses of a Cartesian program at which its axes are found


@dataclass(frozen=True)
class Readback:
    """What the text says: force by the second route per pass in driving order; largest differences to the plan.

    force_error N against the programmed force; axis_error rad and time_error s against the planned motion; limit_ratio
    of the re-interpolated axes at 1 ms (nan for programs whose timing is the controller's); touching_in_air s: contact of blade
    and wheel where none is planned.
    """

    passes: list[VerifiedPass]
    force_error: float
    axis_error: float
    time_error: float
    limit_ratio: float
    touching_in_air: float


def read_back(
    cell: Cell, believed: BelievedRobot, cover: Cover, cloud: SurfaceCloud, motion: PlannedMotion, main: Path
) -> Readback:
    """Read the program `main` and judge it.

    Raises BadInput as the reader does, CannotGrind of the passes whose force is not what was planned, Infeasible where times or
    limits are not.
    """
    controller = cell.controller
    execution = dialect_named(controller.dialect).check(main, cell.robot, controller.absolute_accuracy)
    timed = all(s.times is not None or s.kind == "point" for s in execution.segments)
    driven, axis_error, time_error, ratio = (_timed if timed else _posed)(cell, motion, execution)
    passes, worst, in_air, tasks = [], 0.0, 0.0, []
    unheld: list[CannotGrind] = []
    for one, rows in zip(motion.passes, driven, strict=True):
        in_air += _touching_in_air(cell, believed, one, *rows)
        tasks.append(_bearing(cell, one, *rows))
    for (path, *_), checked in zip(tasks, _verified(cell, believed, cover, cloud, tasks), strict=True):
        try:
            worst = max(worst, force_error(cell, path, checked))
        except CannotGrind as error:
            unheld.append(error)
        passes.append(checked)
    if unheld:
        raise unheld[0].with_others(unheld[1:])
    return Readback(passes, worst, axis_error, time_error, ratio, in_air)


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

    Raises CannotGrind where it is more than a program may be off by.
    """
    tolerance = RIGID_FORCE_TOLERANCE if cell.flange is None else FLANGE_FORCE_TOLERANCE
    off = np.abs(seen.force - seen.planned)
    k = int(np.argmax(off))
    if off[k] > tolerance:
        reason = (
            f"the force read back from the program is {seen.force[k]:.2f} N by the independent route, {off[k]:.2f} N off "
            f"(at most {tolerance:g})"
        )
        message = f"line {path.line} ({path.side}), {seen.s[k] * 1e3:.1f} mm along it: {reason}; nothing is written"
        where = np.interp(path.s, seen.s, off) > tolerance
        raise CannotGrind.of(path, where, reason, "use a shorter --step or a narrower wheel", message=message)
    return float(off[k])


_shared: tuple[Cell, BelievedRobot, Cover, SurfaceCloud] | None = None


def _share(*shared: Any) -> None:
    global _shared
    _shared = shared


def _verify(*task: Any) -> VerifiedPass:
    assert _shared is not None
    return verify_pass(*_shared, *task)


def _verified(
    cell: Cell, believed: BelievedRobot, cover: Cover, cloud: SurfaceCloud, tasks: list[tuple[Any, ...]]
) -> list[VerifiedPass]:
    """`verify_pass` of every task (path, compliance, time, q, s), in worker processes where there are several cores."""
    jobs = min(cores(), len(tasks))
    if jobs <= 1:
        return [verify_pass(cell, believed, cover, cloud, *task) for task in tasks]
    with workers(jobs, _share, cell, believed, cover, cloud) as pool:
        with interrupts_held_back():
            futures = [pool.submit(_verify, *task) for task in tasks]
        return [future.result() for future in futures]


Driven = list[tuple[Array, Array, Array]]  # times s, joints, nominal times s of every pass


def _nominal(motion: PlannedMotion, segment: MotionSegment, t: Array) -> Array:
    """Nominal time (m,) s of a pass at times t (m,) s since its start."""
    return np.asarray(segment.trajectory.s(t) / float(motion.passes[segment.place].problem.path.feed.mean()))


def _timed(cell: Cell, motion: PlannedMotion, execution: Execution) -> tuple[Driven, float, float, float]:
    """Axis programs: the pieces of the text are the segments of the motion, one to one."""
    program = reinterpolate(execution, cell.robot.qd_max, cell.robot.qdd_max)
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


def _posed(cell: Cell, motion: PlannedMotion, execution: Execution) -> tuple[Driven, float, float, float]:
    """Pose programs: the controller's nominal kinematics turn the curve through the poses into axes."""
    blocks: list[Array] = []
    before: tuple[str, float | None] = ("", None)
    for s in execution.segments:
        follows = s.kind == "line" and before == ("line", s.speed)
        starts_where_ended = s.kind == "line" and before[0] == "line"
        before = (s.kind, s.speed)
        # Straight motions do not write the pose where the robot stands; a new speed begins a new block.
        if s.poses is not None and follows:
            blocks[-1] = np.vstack([blocks[-1], s.poses])
        elif s.poses is not None and starts_where_ended:
            blocks.append(np.vstack([blocks[-1][-1:], s.poses]))
        elif s.poses is not None:
            blocks.append(s.poses)
    planned = [s for s in motion.segments if s.kind == "pass"]
    if len(blocks) != 3 * len(planned):
        raise Infeasible(f"the program read back has {len(blocks)} pose blocks, {3 * len(planned)} were planned")
    frames = next(s.frames for s in execution.segments if s.poses is not None)
    if frames.tool is None or frames.base is None:
        raise Infeasible("the program read back does not set its tool and base frames")
    driven: Driven = []
    axis_error = 0.0
    for segment, poses in zip(planned, blocks[1::3], strict=True):
        curve, length = pose_spline(poses)
        chord = np.append(0.0, np.cumsum(np.linalg.norm(np.diff(poses[:, :3, 3], axis=0), axis=1)))
        first, last = segment.trajectory.s(np.array(segment.stops))
        u = np.linspace(0.0, length, max(int(np.ceil(length / POSE_STEP)) * 4, 8))
        along = np.interp(u, chord, np.linspace(first, last, len(poses)))
        t = np.interp(along, segment.trajectory.stations, segment.trajectory.times)
        expected = segment.trajectory.path(along)
        T = frames.base @ invert(curve(u)) @ invert(frames.tool)
        q = _axes(cell, T, expected)
        axis_error = max(axis_error, float(np.abs(q - expected).max()))
        driven.append((t, q, along / float(motion.passes[segment.place].problem.path.feed.mean())))
    return driven, axis_error, 0.0, float("nan")


def _axes(cell: Cell, T: Array, near: Array) -> Array:
    """Axes (m, 6) of nominal flange poses (m, 4, 4): the branch and turn next to `near` (m, 6)."""
    q, _ = inverse_branches(cell.robot, T)
    q = near[:, None] + (q - near[:, None] + np.pi) % (2 * np.pi) - np.pi
    best = np.nanargmin(np.abs(q - near[:, None]).max(axis=-1), axis=1)
    return np.asarray(q[np.arange(len(q)), best])
