"""A motion of two passes with invented joints, written as a program: what a plan is made of without solving one."""

from dataclasses import replace
from functools import cache, partial
from types import SimpleNamespace

import numpy as np

from ocp.plan.motion import PASS_WINDOW, MotionSegment, PlannedMotion
from ocp.plan.passes.course import Engagement, air_to_air, path_at
from ocp.plan.passes.optimise import SolvedPass
from ocp.plan.passes.posture import Seed
from ocp.plan.passes.problem import PassProblem
from ocp.plan.passes.solve import PassSolution
from ocp.plan.programming import grinding_program, write_program
from robots.rigid_body import inverse_dynamics
from tests.support.example_pass import bar_pass, bundled_cell
from trajectories.joint_trajectory import Limits
from trajectories.krl.checks import check_program
from trajectories.timing import time_contact_path, time_joint_move

FEED = 0.04  # m/s, of the lines
SEED = Seed(1, 0, np.zeros(2), 0.0, np.zeros((2, 6)), np.array([0.0, 1.0]), 0.0)


@cache
def cell():
    return bundled_cell()


@cache
def motion() -> PlannedMotion:
    """Two passes from air to air with travel between them, and a way home; joints invented, forces smooth."""
    robot, payload = cell().robot, cell().workpiece.payload
    limits = Limits.of(robot, partial(inverse_dynamics, robot, payload.mass, payload.com))
    start = np.radians([5.0, -70.0, 100.0, 10.0, -40.0, 20.0])
    away = np.radians([0.0, -3.0, 2.0, 0.0, 0.0, 0.0])
    line = bar_pass(n=60, length=0.05)
    course = air_to_air(line, Engagement(0.3, 0.004, 0.02, 0.8, 4900.0, 20.0), 0.02)
    k, out = course.s[:, None] / 0.05, course.gap[:, None] / 0.02
    passes, segments, time = [], [], 0.0

    def add(kind, place, trajectory):
        nonlocal time
        segments.append(MotionSegment(kind, place, trajectory, time))
        time += trajectory.duration

    home = start + 2 * away
    where = home
    for place, shift in enumerate((0.0, np.radians(2.0))):
        q = start + shift + k * np.radians([1.5, -1.0, 2.0, 1.0, -1.5, 4.0]) + np.radians(0.2) * np.sin(3 * k) + out * away
        add("travel", place, time_joint_move(where, q[0], limits))
        timed = time_contact_path(q, course.at * FEED, np.full(len(q), FEED), limits, PASS_WINDOW, at_rest=True)
        add("pass", place, timed)
        where = q[-1]
        path, n = replace(path_at(line, course.s), line=3 + place), len(q)
        evaluation = SimpleNamespace(force_sd=2.0 + 10 * path.s, delta=1e-4 + 1e-3 * path.s, stiffness=np.full(n, 5000.0))
        problem = replace(PassProblem.start(path, SEED, np.zeros((n, 3))), course=course)
        solution = PassSolution(q, np.ones(n), np.ones(n), path.force * course.share, 0, 0.0)
        passes.append(SolvedPass(problem, solution, evaluation))
    add("travel", 2, time_joint_move(where, home, limits))
    return PlannedMotion(passes, segments)


def written(folder, kind="axis", name="blade 1.stl"):
    program = grinding_program(cell(), motion(), kind, name)
    return program, write_program(cell(), program, folder)[0]


def checked(main):
    return check_program(main, cell().robot)
