"""The motion as a robot program: what it is made of, its files in a folder; and as a table, plan.csv, of the points that it
emits, air moves included, with what the model says of each.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import groupby
from pathlib import Path

import numpy as np

from ocp.model.cell import Cell, wheel_frame
from ocp.plan.motion import MotionSegment, PlannedMotion
from ocp.plan.passes.optimise import force_tolerance
from ocp.plan.rules import (
    EMITTED_AIR_TOLERANCE,
    EMITTED_FORCE_SHARE,
    EMITTED_TOLERANCE,
    FLANGE_SHARE,
    LEAVING,
    RAMP_SHARE,
    RIGID_FORCE_TOLERANCE,
)
from robots.kinematics import forward
from robots.pose import Array, apply
from robots.tracker_readings import Hanging
from trajectories.dialects import dialect_named
from trajectories.joint_trajectory import sample_times
from trajectories.program.build import Leg, build_program
from trajectories.program.program import PoseSpline, Program, Setup, TimedSpline

PHASES = ("travel", "lead_in", "pass", "lead_out")
TABLE_STEP = 0.025  # s between rows of plan.csv where the program itself is not timed


def grinding_program(cell: Cell, motion: PlannedMotion, kind: str, name: str) -> Program:
    """The program of a motion; `kind` axis, cartesian or lin.

    Raises BadInput where the combination must not be written, Infeasible where the emitted points leave the plan.
    """
    groups = [list(legs) for _, legs in groupby(motion.segments, key=lambda s: s.place)]
    labels = [_label(motion, legs[0].place) for legs in groups]
    point = cell.workpiece.T_flange_blade[:3, 3]

    def moved(planned: Array, driven: Array) -> Array:
        difference = apply(forward(cell.robot, planned), point) - apply(forward(cell.robot, driven), point)
        return np.asarray(np.linalg.norm(difference, axis=1))

    ways = {id(one): motion.passes[one.place] for one in motion.segments if one.kind == "pass"}

    def tolerance(leg: Leg, t: Array) -> Array:
        if id(leg) not in ways:
            return np.full(len(t), EMITTED_AIR_TOLERANCE)
        solved = ways[id(leg)]
        way, nominal = solved.problem.way, leg.trajectory.s(t) / float(solved.problem.path.feed.mean())
        bears = way.share > 0
        stiffness = solved.evaluation.stiffness[bears]
        allowed = force_allowed(cell, stiffness, solved.solution.force[bears], solved.problem.path.force[bears])
        stiffness, allowed = (np.interp(nominal, way.at[bears], values) for values in (stiffness, allowed))
        return np.asarray(np.clip(EMITTED_FORCE_SHARE * allowed / stiffness, *EMITTED_TOLERANCE))

    dialect = dialect_named(cell.controller.dialect)
    setup = program_setup(cell, cell.workpiece.payload, kind)
    return build_program(dialect, name, setup, groups, labels, lambda q: forward(cell.robot, q), tolerance, moved)


def force_allowed(cell: Cell, stiffness: Array, force: Array, full: Array) -> Array:
    """By how much force (n,) N a program may be off where contact is so stiff (n,) N/m, under so much of the `full` force (n,) N:
    on a ramp as without a flange while that stands at its stop, as the reading back takes it."""
    allowed = np.full(len(stiffness), force_tolerance(cell))
    if cell.flange is not None:
        stopped = stiffness > cell.flange.stiffness / FLANGE_SHARE**2  # a flange that gives is softer however it stands
        bends = force < np.max(force, where=stopped & (force < RAMP_SHARE * full), initial=-np.inf) + LEAVING
        allowed[bends & (force < RAMP_SHARE * full)] = RIGID_FORCE_TOLERANCE
    return allowed


def program_setup(cell: Cell, load: Hanging, kind: str = "axis") -> Setup:
    """Frames, robot and numbers that every program of a cell needs, with what hangs on the flange."""
    return Setup(
        T_flange_blade=cell.workpiece.T_flange_blade,
        T_base_wheel=wheel_frame(cell),
        robot=cell.robot,
        **{name: getattr(cell.controller, name) for name in ("tool_no", "base_no", "absolute_accuracy")},
        kind=kind,
        load_mass=load.mass,
        load_com=load.com,
        load_inertia=load.inertia,
    )


def write_program(cell: Cell, program: Program, folder: Path) -> list[Path]:
    """Write the program's files in the dialect of the cell's controller, the main program's first."""
    return dialect_named(cell.controller.dialect).write(program, folder)


def emitted_times(motion: PlannedMotion, program: Program) -> list[Array]:
    """Times of the emitted points of every segment, s since its start; a regular table for programs without times."""
    splines = [b for sub in program.subs for b in sub.blocks if isinstance(b, TimedSpline | PoseSpline)]
    if len(splines) == len(motion.segments):
        return [np.minimum(b.t, s.trajectory.duration) for b, s in zip(splines, motion.segments, strict=True)]
    return [sample_times(s.trajectory, TABLE_STEP) for s in motion.segments]


def _label(motion: PlannedMotion, place: int) -> str:
    if place == len(motion.passes):
        return "way home"
    path = motion.passes[place].problem.path
    return f"line {path.line} {path.side}"


@dataclass(frozen=True)
class Timeline:
    """Rows of plan.csv in SI; m points. nan where there is no contact.

    time (m,) s; segment (m,) index into PlannedMotion.segments; line (m,) of the blade, 0 on the way between passes; contact
    (m,) bool, by the model; phase (m,) index into PHASES; q, qd, qdd (m, 6); p, n, t (m, 3) blade frame; s (m,) m along the
    pass, begin (m,) m: where on it s_mm is zero; feed (m,) m/s; force, force_sd (m,) N;
    interference (m,) m; limit_ratio (m,).
    """

    time: Array
    segment: Array
    line: Array
    contact: Array
    phase: Array
    q: Array
    qd: Array
    qdd: Array
    p: Array
    n: Array
    t: Array
    s: Array
    begin: Array
    feed: Array
    force: Array
    force_sd: Array
    interference: Array
    limit_ratio: Array


def build_timeline(motion: PlannedMotion, times: list[Array]) -> Timeline:
    """The rows at `times` (one array of seconds since the segment's start for each segment, ends included)."""
    parts = [_rows(motion, i, segment, t) for i, (segment, t) in enumerate(zip(motion.segments, times, strict=True))]
    return Timeline(*(np.concatenate([getattr(part, name) for part in parts]) for name in Timeline.__dataclass_fields__))


def _rows(motion: PlannedMotion, index: int, segment: MotionSegment, t: Array) -> Timeline:
    trajectory = segment.trajectory
    m = len(t)
    contact, phase, line = np.zeros(m, bool), np.zeros(m, int), 0
    vector, number = np.full((m, 3), np.nan), np.full(m, np.nan)
    values: dict[str, Array] = {name: vector.copy() for name in ("p", "n", "t")}
    values |= {name: number.copy() for name in ("s", "begin", "feed", "force", "force_sd", "interference")}
    if segment.kind == "pass":
        solved = motion.passes[segment.place]
        way, line = solved.problem.way, solved.problem.path.line
        nominal = trajectory.s(t) / float(solved.problem.path.feed.mean())
        phase = way.phase_at(nominal) % len(PHASES)
        contact = phase > 0
        seen = solved.at(nominal[contact])
        rate = trajectory.feed(t[contact]) / float(solved.problem.path.feed.mean())
        values["feed"][contact] = seen.pop("speed") * rate
        for name, value in seen.items():
            values[name][contact] = value
    return Timeline(
        time=segment.start + t,
        segment=np.full(m, index),
        line=np.full(m, line),
        contact=contact,
        phase=phase,
        q=trajectory.q(t),
        qd=trajectory.qd(t),
        qdd=trajectory.qdd(t),
        limit_ratio=trajectory.limit_ratio(t),
        **values,
    )


Column = tuple[str, Array, int]  # name, values (m,) in the unit of the name, digits after the point


def write_plan_csv(timeline: Timeline, path: Path, setpoint: float = np.nan, more: Sequence[Column] = ()) -> None:
    """Write plan.csv as FORMATS.md asks, `more` columns last; cells without meaning off contact stay empty. `setpoint` N of the
    force flange, nan without one."""
    degrees = 180 / np.pi
    columns: list[Column] = [
        ("time_s", timeline.time, 6),
        ("line", timeline.line, 0),
        ("contact", timeline.contact.astype(int), 0),
        *((f"q{i + 1}_deg", timeline.q[:, i] * degrees, 6) for i in range(6)),
        *((f"qd{i + 1}_deg_s", timeline.qd[:, i] * degrees, 5) for i in range(6)),
        *((f"qdd{i + 1}_deg_s2", timeline.qdd[:, i] * degrees, 4) for i in range(6)),
        *((f"p{a}_mm", timeline.p[:, i] * 1e3, 5) for i, a in enumerate("xyz")),
        *((f"n{a}", timeline.n[:, i], 8) for i, a in enumerate("xyz")),
        *((f"t{a}", timeline.t[:, i], 8) for i, a in enumerate("xyz")),
        ("s_mm", (timeline.s - timeline.begin) * 1e3, 4),
        ("feed_mm_s", timeline.feed * 1e3, 4),
        ("fn_N", timeline.force, 5),
        ("fn_sd_N", timeline.force_sd, 5),
        ("interference_mm", timeline.interference * 1e3, 6),
        ("limit_ratio", timeline.limit_ratio, 6),
        ("setpoint_N", np.full(len(timeline.time), setpoint), 4),
        *more,
    ]
    texts = [[_cell(v, digits) for v in values] for _, values, digits in columns]
    texts.append([PHASES[k] for k in timeline.phase])
    lines = [",".join([*(name for name, _, _ in columns), "phase"]), *(",".join(row) for row in zip(*texts, strict=True))]
    path.write_text("\n".join(lines) + "\n", encoding="ascii", newline="\n")


def _cell(value: float, digits: int) -> str:
    if not np.isfinite(value):
        return ""
    text = f"{value:.{digits}f}"
    return text.lstrip("-") if float(text) == 0 else text
