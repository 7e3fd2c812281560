"""Timed joint trajectories -> a program: one sub-program a pass, with as many points as the controller needs."""

from collections.abc import Callable, Iterable, Sequence
from functools import partial
from typing import Protocol

import numpy as np

from robots.errors import BadInput, Infeasible
from robots.pose import Array, invert
from trajectories.joint_trajectory import SAMPLE, JointTrajectory
from trajectories.program.dialect import Dialect
from trajectories.program.driven import path_peaks
from trajectories.program.execution import Frames, PathBounds
from trajectories.program.interpolation import Deviation, LaidPoses, emit, largest_axis_difference
from trajectories.program.program import (
    Block,
    Comment,
    FileLimits,
    PointMotion,
    PoseLines,
    PoseSpline,
    Program,
    Setup,
    SubProgram,
    TimedSpline,
    refuse_poses,
    split_blocks,
)

ROOM = 2.0  # of what a block of poses asks for: its bounds, so that nothing but its times rules it
LINE_ROOM = 4.0  # the same of the acceleration between straight motions of one speed each, which change it in steps
LINE_TIME = 0.025  # s, at least, between the poses of straight motions: the controller plans and blends each one (M)
LINE_WAY = 5e-5  # m, at least, between them: a thousandth of it is what printing rounds


class Leg(Protocol):
    """A timed piece of a program; `kind` is travel or what it is for."""

    @property
    def kind(self) -> str:
        """What it is for."""

    @property
    def trajectory(self) -> JointTrajectory:
        """Its joints over time, from rest to rest."""


def build_program(
    dialect: Dialect,
    name: str,
    setup: Setup,
    passes: Sequence[Sequence[Leg]],
    labels: Sequence[str],
    forward: Callable[[Array], Array],
    tolerance: Callable[[Leg, Array], Array] = lambda leg, t: np.full(len(t), 2e-5),
    deviation: Deviation = largest_axis_difference,
    comments: Iterable[str] = (),
    taken: Iterable[str] = (),
) -> Program:
    """The program of all passes; each pass is a sequence of legs that follow one another without a gap.

    `dialect` says how it may be named and what its files hold; `labels` say per pass what it does; `forward` gives the nominal
    flange poses (n, 4, 4) of joints (n, 6): programs of poses are written through the controller's own, nominal kinematics
    (PHYSICS.md 4). `tolerance` of a leg at times (n,) s and `deviation` as in `emit`; `taken` names on the controller. Raises
    BadInput (poses would be corrected twice; a leg of too many points) and Infeasible (a leg that cannot be emitted within the
    tolerance).
    """
    refuse_poses(setup)
    groups, limits = [], dialect.limits
    for label, legs in zip(labels, passes, strict=True):
        try:
            groups.append(split_blocks(_blocks(legs, setup, limits, forward, tolerance, deviation), limits.file_points))
        except (BadInput, Infeasible) as error:
            raise type(error)(f"{label}: {error}") from None
    main, names = dialect.program_names(name, len(groups), [len(g) for g in groups], taken)
    subs = tuple(
        SubProgram(sub, tuple(blocks), label)
        for label, parts, part_names in zip(labels, groups, names, strict=True)
        for sub, blocks in zip(part_names, parts, strict=True)
    )
    return Program(main, setup, subs, tuple(comments))


def _blocks(
    legs: Sequence[Leg],
    setup: Setup,
    limits: FileLimits,
    forward: Callable[[Array], Array],
    tolerance: Callable[[Leg, Array], Array],
    deviation: Deviation,
) -> list[Block]:
    frames = Frames(setup.T_flange_blade, setup.T_base_wheel, external_tcp=True)

    def posed(q: Array) -> Array:
        # P = (FLANGE TOOL)^-1 BASE: the robot holds the workpiece
        return np.asarray(invert(forward(q) @ setup.T_flange_blade) @ setup.T_base_wheel)

    laid = LaidPoses(limits, frames, setup.robot, posed)
    blocks: list[Block] = [PointMotion(legs[0].trajectory.q(0.0))]
    for leg in legs:
        blocks.append(Comment(leg.kind))
        way = leg.trajectory
        if setup.kind == "lin":
            blocks.append(PointMotion(way.q(way.duration)) if leg.kind == "travel" else _lines(way, laid))
        elif setup.kind == "axis" or leg.kind == "travel":
            emission = emit(way, limits, partial(tolerance, leg), deviation)
            blocks.append(TimedSpline(emission.points, emission.times))
        else:
            emission = emit(way, limits, partial(tolerance, leg), deviation, laid=laid)
            t = emission.times
            blocks.append(PoseSpline(emission.points, way.q(t), t, _bounds(way, laid, ROOM)))
    return blocks


def _bounds(trajectory: JointTrajectory, laid: LaidPoses, room: float) -> PathBounds:
    """Bounds that leave a path of poses `room` times its speeds and accelerations, where the controller has that much.

    Raises Infeasible where it has not even what is asked for.
    """
    peaks = path_peaks(laid.posed(trajectory.q(np.arange(0.0, trajectory.duration, SAMPLE))))
    found = []
    for name, most in vars(laid.limits.path).items():
        peak = getattr(peaks, name)
        if peak > most:
            raise Infeasible(
                f"its poses need {peak:.3g} of {name.replace('_', ' ')} (SI) and a controller gives a path {most:.3g}; choose "
                "the axis program"
            )
        found.append(min(room * peak, most))
    return PathBounds(*found)


def _lines(trajectory: JointTrajectory, laid: LaidPoses) -> PoseLines:
    """Poses at least LINE_TIME and LINE_WAY apart, and the speed on the way to each that takes the planned time."""
    t = np.append(np.arange(0.0, trajectory.duration - 0.5 * SAMPLE, SAMPLE), trajectory.duration)
    p = laid.posed(trajectory.q(t))[:, :3, 3]
    kept, last = [0], len(t) - 1
    for k in range(1, last):
        if t[k] - t[kept[-1]] > LINE_TIME - 1e-9 and np.linalg.norm(p[k] - p[kept[-1]]) > LINE_WAY:
            kept.append(k)
    while len(kept) > 1 and (t[last] - t[kept[-1]] < LINE_TIME or np.linalg.norm(p[last] - p[kept[-1]]) < LINE_WAY):
        kept.pop()
    q = trajectory.q(t[[*kept, last]])
    poses = laid.points(q)
    ways = np.linalg.norm(np.diff(poses[:, :3, 3], axis=0), axis=1)
    return PoseLines(poses, q, ways / np.diff(t[[*kept, last]]), _bounds(trajectory, laid, LINE_ROOM))
