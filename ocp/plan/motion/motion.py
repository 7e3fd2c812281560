"""The whole motion: order of the passes, travel, engage, contact, retreat, each timed and checked at 1 ms."""

import itertools
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial

import numpy as np

from ocp.model.cell import Cell
from ocp.plan.clearance.collision import CollisionScene
from ocp.plan.motion.air import lifted, travel
from ocp.plan.passes.optimise import SolvedPass
from ocp.plan.rules import ENGAGE_SPEED, HOME_LIFT, LIFT_OFF, LIMIT_SHARE
from robots.errors import Infeasible
from robots.pose import Array
from robots.rigid_body import inverse_dynamics
from trajectories.joint_trajectory import JointTrajectory, Limits
from trajectories.timing import time_contact_path, time_joint_move

ENGAGE_POINTS = 11


@dataclass(frozen=True)
class MotionSegment:
    """A timed piece of the program: `kind` is travel, engage, contact or retreat; `place` the pass in driving order."""

    kind: str
    place: int
    trajectory: JointTrajectory
    start: float

    @property
    def end(self) -> float:
        """Program time at which it ends, s."""
        return self.start + self.trajectory.duration


@dataclass(frozen=True)
class PlannedMotion:
    """Passes in driving order and the segments of the program, one after the other without pause."""

    passes: list[SolvedPass]
    segments: list[MotionSegment]

    @property
    def duration(self) -> float:
        """Seconds from the first posture to the last."""
        return self.segments[-1].end

    def contact(self, place: int) -> MotionSegment:
        """The grinding segment of the pass at `place`."""
        return next(s for s in self.segments if s.kind == "contact" and s.place == place)


def build_motion(
    cell: Cell, scene: CollisionScene, solved: list[SolvedPass], advance: Callable[[], None] = lambda: None
) -> PlannedMotion:
    """Order the passes for short travel, join them by free moves and time everything.

    Raises Infeasible: no free way between two passes, or a limit that cannot be held.
    """
    payload = cell.workpiece.payload
    limits = Limits.of(cell.robot, partial(inverse_dynamics, cell.robot, payload.mass, payload.com), LIMIT_SHARE)
    ends = [(_clear(cell, p, 0), _clear(cell, p, -1)) for p in solved]
    order = _order(cell, [(a[-1], b[-1]) for a, b in ends])
    passes, ends = [solved[i] for i in order], [ends[i] for i in order]
    home = lifted(cell, passes[0].solution.q[0], _normal(cell, passes[0], 0), np.array([HOME_LIFT]))[0]
    segments: list[MotionSegment] = []
    time = 0.0

    def add(kind: str, place: int, trajectory: JointTrajectory) -> None:
        nonlocal time
        segments.append(MotionSegment(kind, place, trajectory, time))
        time += trajectory.duration

    where = (home, _normal(cell, passes[0], 0))
    for place, (one, (inward, outward)) in enumerate(zip(passes, ends, strict=True)):
        name = f"line {one.problem.path.line} ({one.problem.path.side})"
        entry = (inward[-1], _normal(cell, one, 0))
        way = travel(cell, scene, where, entry)
        for a, b in itertools.pairwise(way):
            if np.abs(b - a).max() > 1e-9:
                add("travel", place, time_joint_move(a, b, limits, label=f"{name}, approach"))
        distance = np.linspace(0.0, LIFT_OFF, ENGAGE_POINTS)
        add("engage", place, time_contact_path(inward[::-1], distance, ENGAGE_SPEED, limits, label=f"{name}, engage"))
        path = one.problem.path
        add("contact", place, time_contact_path(one.solution.q, path.s, path.feed, limits, label=name))
        add("retreat", place, time_contact_path(outward, distance, ENGAGE_SPEED, limits, label=f"{name}, retreat"))
        where = (outward[-1], _normal(cell, one, -1))
        advance()
    way = travel(cell, scene, where, (home, _normal(cell, passes[0], 0)))
    for a, b in itertools.pairwise(way):
        if np.abs(b - a).max() > 1e-9:
            add("travel", len(passes), time_joint_move(a, b, limits, label="way home"))
    return PlannedMotion(passes, segments)


def _normal(cell: Cell, solved: SolvedPass, k: int) -> Array:
    """Outward wheel radial (3,) in the base frame at waypoint k, from the arc angle."""
    wheel, arc = cell.wheel, solved.evaluation.arc[k]
    side = np.cross(wheel.axis, wheel.contact_direction)
    return np.asarray(np.cos(arc) * wheel.contact_direction + np.sin(arc) * side)


def _clear(cell: Cell, solved: SolvedPass, k: int) -> Array:
    """Joints (ENGAGE_POINTS, 6) from contact waypoint k straight off the wheel by LIFT_OFF."""
    q = solved.solution.q[k]
    path = solved.problem.path
    try:
        off = lifted(cell, q, _normal(cell, solved, k), np.linspace(0.0, LIFT_OFF, ENGAGE_POINTS)[1:])
    except Infeasible as error:
        raise Infeasible(f"line {path.line} ({path.side}): {error}") from None
    return np.vstack([q, off])


def _order(cell: Cell, ends: list[tuple[Array, Array]]) -> list[int]:
    """Order of passes with short travel: nearest neighbour from every start, then moves of single passes (or-opt)."""
    start, end = np.array([a for a, _ in ends]), np.array([b for _, b in ends])
    seconds = (np.abs(end[:, None] - start[None]) / cell.robot.qd_max).max(axis=-1)
    n = len(ends)

    def length(order: list[int]) -> float:
        return float(sum(seconds[a, b] for a, b in itertools.pairwise(order)))

    best = list(range(n))
    for first in range(n):
        order, left = [first], set(range(n)) - {first}
        while left:
            order.append(min(left, key=lambda j: (seconds[order[-1], j], j)))
            left.remove(order[-1])
        best = min(best, order, key=length)
    improved = True
    while improved:
        improved = False
        for i in range(n):
            for j in range(n):
                moved = best[:i] + best[i + 1 :]
                moved.insert(j, best[i])
                if length(moved) < length(best) - 1e-9:
                    best, improved = moved, True
    return best
