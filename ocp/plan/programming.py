"""The motion as a robot program: what it is made of, and its files in a folder."""

from itertools import groupby
from pathlib import Path

import numpy as np

from ocp.model.cell import Cell, wheel_frame
from ocp.plan.motion.motion import PlannedMotion
from ocp.plan.rules import EMITTED_AIR_TOLERANCE, EMITTED_FORCE_ERROR, EMITTED_TOLERANCE
from robots.kinematics import forward
from robots.pose import Array, apply
from trajectories.dialects import dialect_named
from trajectories.joint_trajectory import sample_times
from trajectories.program.build import Leg, build_program
from trajectories.program.program import Program, Setup, TimedSpline

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

    stiffness = max(float(p.evaluation.stiffness.max()) for p in motion.passes)
    fine = float(np.clip(EMITTED_FORCE_ERROR / stiffness, *EMITTED_TOLERANCE))

    def tolerance(leg: Leg) -> float:
        return fine if leg.kind == "contact" else EMITTED_AIR_TOLERANCE

    dialect, payload = dialect_named(cell.controller.dialect), cell.workpiece.payload
    setup = program_setup(cell, payload.mass, payload.com, kind)
    return build_program(dialect, name, setup, groups, labels, lambda q: forward(cell.robot, q), tolerance, moved)


def program_setup(cell: Cell, load_mass: float, load_com: Array, kind: str = "axis") -> Setup:
    """Frames, robot and numbers that every program of a cell needs, with what hangs on the flange (kg, m)."""
    return Setup(
        T_flange_blade=cell.workpiece.T_flange_blade,
        T_base_wheel=wheel_frame(cell),
        robot=cell.robot,
        tool_no=cell.controller.tool_no,
        base_no=cell.controller.base_no,
        kind=kind,
        absolute_accuracy=cell.controller.absolute_accuracy,
        load_mass=load_mass,
        load_com=load_com,
    )


def write_program(cell: Cell, program: Program, folder: Path) -> list[Path]:
    """Write the program's files in the dialect of the cell's controller, the main program's first."""
    return dialect_named(cell.controller.dialect).write(program, folder)


def emitted_times(motion: PlannedMotion, program: Program) -> list[Array]:
    """Times of the emitted points of every segment, s since its start; a regular table for programs without times."""
    splines = [b for sub in program.subs for b in sub.blocks if isinstance(b, TimedSpline)]
    if len(splines) == len(motion.segments):
        return [np.minimum(b.t, s.trajectory.duration) for b, s in zip(splines, motion.segments, strict=True)]
    return [sample_times(s.trajectory, TABLE_STEP) for s in motion.segments]


def _label(motion: PlannedMotion, place: int) -> str:
    if place == len(motion.passes):
        return "way home"
    path = motion.passes[place].problem.path
    return f"line {path.line} {path.side}"
