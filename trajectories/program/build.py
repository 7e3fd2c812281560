"""Timed joint trajectories -> a program: one sub-program a pass, with as many points as the controller needs."""

from collections.abc import Callable, Iterable, Sequence
from itertools import pairwise
from typing import Protocol

import numpy as np

from robots.errors import BadInput, Infeasible
from robots.pose import Array, invert
from trajectories.joint_trajectory import JointTrajectory
from trajectories.program.dialect import Dialect
from trajectories.program.interpolation import Deviation, emit, largest_axis_difference
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
from trajectories.toppra_law import times_at

SPACING = 1e-3  # m between the poses of a Cartesian program
LINE_TIME = 0.025  # s, at least, between the poses of a program of lines: the controller plans and blends each one (M)


class Leg(Protocol):
    """A timed piece of a program; `kind` is travel or what it is for."""

    @property
    def kind(self) -> str:
        """What it is for."""

    @property
    def stops(self) -> tuple[float, ...]:
        """Times s at which a program of poses, whose blocks have one speed each, begins another block."""

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
    tolerance: Callable[[Leg], float] = lambda leg: 2e-5,
    deviation: Deviation = largest_axis_difference,
    comments: Iterable[str] = (),
    taken: Iterable[str] = (),
) -> Program:
    """The program of all passes; each pass is a sequence of legs that follow one another without a gap.

    `dialect` says how it may be named and what its files hold; `labels` say per pass what it does; `forward` gives the nominal
    flange poses (n, 4, 4) of joints (n, 6): programs of poses are written through the controller's own, nominal kinematics
    (PHYSICS.md 4). `tolerance` of a leg and `deviation` as in `emit`; `taken` names on the controller. Raises BadInput (poses
    would be corrected twice; a leg of too many points) and Infeasible (a leg that cannot be emitted within the tolerance).
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
    tolerance: Callable[[Leg], float],
    deviation: Deviation,
) -> list[Block]:
    blocks: list[Block] = [PointMotion(legs[0].trajectory.q(0.0))]
    for leg in legs:
        blocks.append(Comment(leg.kind))
        if setup.kind == "axis":
            emission = emit(leg.trajectory, limits, tolerance(leg), deviation)
            blocks.append(TimedSpline(emission.q, emission.times))
        elif leg.kind == "travel":
            blocks.append(PointMotion(leg.trajectory.q(leg.trajectory.duration)))
        else:
            times = [0.0, *leg.stops, leg.trajectory.duration]
            blocks += [_pose_block(leg.trajectory, part, setup, limits.block_points, forward) for part in pairwise(times)]
    return blocks


def _pose_block(
    trajectory: JointTrajectory, part: tuple[float, float], setup: Setup, most: int, forward: Callable[[Array], Array]
) -> PoseSpline | PoseLines:
    """Poses P = (FLANGE TOOL)^-1 BASE at equal stations from the first time of `part` to its second, and the speed of P at which
    the planned feed is driven."""
    first, last = (float(s) for s in trajectory.s(np.array(part)))
    length = last - first
    n = np.ceil(length / SPACING)
    if setup.kind == "lin":
        n = min(n, np.floor((part[1] - part[0]) / LINE_TIME))
    n = int(np.clip(n, 2, most - 1))
    times = times_at(trajectory.law, np.linspace(first, last, n + 1))
    q = trajectory.q(times)
    P = invert(forward(q) @ setup.T_flange_blade) @ setup.T_base_wheel
    # Only where the wheel touches at the origin of the base frame is the speed of P the feed itself: the ratio is taken along.
    chord = np.linalg.norm(np.diff(P[:, :3, 3], axis=0), axis=1)
    feed = float(np.median(chord / np.diff(times)))
    block = PoseSpline if setup.kind == "cartesian" else PoseLines
    return block(P, q, max(feed, 1e-4))
