"""A small program for the KRL tests: a pass of the default arm, in every kind of output."""

from dataclasses import dataclass
from functools import cache
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike

from robots.pose import Array, invert, transform_from_xyzabc
from robots.robot import Robot, load_robot
from trajectories.joint_trajectory import JointTrajectory, Limits
from trajectories.krl.dialect import KRL
from trajectories.program.build import build_program
from trajectories.program.program import Program, Setup
from trajectories.timing import time_contact_path, time_joint_move

GOLDEN = Path(__file__).parents[1] / "golden"
ROBOT: Robot = load_robot("kr210_r2700_extra")
T_FLANGE_BLADE = transform_from_xyzabc([0.01, 0.0, 0.2], np.radians([0.0, 5.0, 0.0]))
T_BASE_WHEEL = transform_from_xyzabc([1.55, 0.0, 1.0], np.radians([0.0, 0.0, 0.0]))
LIMITS = Limits(ROBOT.qd_max, ROBOT.qdd_max, ROBOT.q_min, ROBOT.q_max)


@dataclass(frozen=True)
class Leg:
    kind: str
    trajectory: JointTrajectory


def elementary_forward(q: Array) -> Array:
    """The arm as elementary motions (PHYSICS.md 2.2), independent of the MD-H code; lengths of the "extra"."""

    def turn(axis: str, angle: ArrayLike) -> Array:
        abc = np.zeros((*np.shape(angle), 3))
        abc[..., "zyx".index(axis)] = angle
        return transform_from_xyzabc([0, 0, 0], abc)

    def shift(x: float, y: float, z: float) -> Array:
        return transform_from_xyzabc([x, y, z], [0, 0, 0])

    a = np.atleast_2d(q).T
    T = shift(0, 0, 0.675) @ turn("z", -a[0]) @ shift(0.350, 0, 0) @ turn("y", a[1]) @ shift(1.150, 0, 0)
    T = T @ turn("y", a[2]) @ shift(1.200, 0, -0.041) @ turn("x", -a[3]) @ turn("y", a[4]) @ turn("x", -a[5])
    return T @ shift(0.215, 0, 0) @ turn("y", np.pi / 2)


@cache
def legs(feed: float = 0.04, scale: float = 1.0) -> list[Leg]:
    start = np.radians([5.0, -70.0, 100.0, 10.0, -40.0, 20.0])
    s = np.linspace(0.0, 0.05, 41)
    k = s[:, None] / 0.05
    bend = np.radians([1.5, -1.0, 2.0, 1.0, -1.5, 4.0]) * scale
    q = start + k * bend + np.radians(0.3) * np.sin(3 * k) * np.array([1, -1, 1, 0.5, 1, -1])
    away = np.radians([0.0, -3.0, 2.0, 0.0, 0.0, 0.0])
    return [
        Leg("travel", time_joint_move(q[0] + 2 * away, q[0] + away, LIMITS)),
        Leg("engage", time_joint_move(q[0] + away, q[0], LIMITS)),
        Leg("contact", time_contact_path(q, s, feed, LIMITS)),
        Leg("retreat", time_joint_move(q[-1], q[-1] + away, LIMITS)),
    ]


def setup(kind: str = "axis", **options: object) -> Setup:
    return Setup(
        T_FLANGE_BLADE,
        T_BASE_WHEEL,
        ROBOT,
        kind=kind,
        load_mass=25.0,
        load_com=np.array([0.01, 0.0, 0.16]),
        **options,  # type: ignore[arg-type]
    )


@cache
def example(kind: str = "axis", passes: int = 1, **options: object) -> Program:
    return build_program(
        KRL,
        "blade 1.stl",
        setup(kind, **options),
        [legs()] * passes,
        [f"line {i + 1}" for i in range(passes)],
        elementary_forward,
        comments=["made by a test"],
    )


def write(program: Program, folder: Path) -> Path:
    return KRL.write(program, folder)[0]


def contact_poses(q: Array) -> Array:
    return invert(elementary_forward(q) @ T_FLANGE_BLADE) @ T_BASE_WHEEL
