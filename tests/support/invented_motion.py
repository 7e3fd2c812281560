"""A motion of two passes with invented joints, written as a program: what a plan is made of without solving one."""

from dataclasses import replace
from functools import cache, partial
from types import SimpleNamespace

import numpy as np

from ocp.plan.motion import MotionSegment, PlannedMotion
from ocp.plan.programming import grinding_program, write_program
from robots.rigid_body import inverse_dynamics
from tests.support.example_pass import bar_pass, bundled_cell
from trajectories.joint_trajectory import Limits
from trajectories.krl.checks import check_program
from trajectories.timing import time_contact_path, time_joint_move


@cache
def cell():
    return bundled_cell()


@cache
def motion() -> PlannedMotion:
    """Two passes with approach, engage, contact, retreat, and a way home; joints invented, forces smooth."""
    robot, payload = cell().robot, cell().workpiece.payload
    limits = Limits.of(robot, partial(inverse_dynamics, robot, payload.mass, payload.com))
    start = np.radians([5.0, -70.0, 100.0, 10.0, -40.0, 20.0])
    away = np.radians([0.0, -3.0, 2.0, 0.0, 0.0, 0.0])
    path = bar_pass(n=26, length=0.05)
    k = path.s[:, None] / 0.05
    passes, segments, time = [], [], 0.0

    def add(kind, place, trajectory):
        nonlocal time
        segments.append(MotionSegment(kind, place, trajectory, time))
        time += trajectory.duration

    home = start + 2 * away
    where = home
    for place, shift in enumerate((0.0, np.radians(2.0))):
        q = start + shift + k * np.radians([1.5, -1.0, 2.0, 1.0, -1.5, 4.0]) + np.radians(0.2) * np.sin(3 * k)
        add("travel", place, time_joint_move(where, q[0] + away, limits))
        add("engage", place, time_joint_move(q[0] + away, q[0], limits))
        add("contact", place, time_contact_path(q, path.s, path.feed, limits))
        add("retreat", place, time_joint_move(q[-1], q[-1] + away, limits))
        where = q[-1] + away
        evaluation = SimpleNamespace(
            force_sd=2.0 + 10 * path.s, delta=1e-4 + 1e-3 * path.s, stiffness=np.full(len(path.s), 5000.0)
        )
        problem = SimpleNamespace(path=replace(path, line=3 + place))
        passes.append(SimpleNamespace(problem=problem, solution=SimpleNamespace(q=q, force=path.force), evaluation=evaluation))
    add("travel", 2, time_joint_move(where, home, limits))
    return PlannedMotion(passes, segments)


def written(folder, kind="axis", name="blade 1.stl"):
    program = grinding_program(cell(), motion(), kind, name)
    return program, write_program(cell(), program, folder)[0]


def checked(main):
    return check_program(main, cell().robot)
