"""The way through the poses: payload by payload, short travel, every move checked; nearest neighbour, 2-opt, then via points."""

import itertools
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ocp.plan.clearance.collision import CollisionScene
from ocp.plan.motion.air import connect, is_free
from ocp.plan.rules import COLLISION_STEP
from robots.errors import Infeasible
from robots.pose import Array
from robots.robot import Robot

Index = NDArray[np.int64]

HOME = np.radians([0.0, -90.0, 90.0, 0.0, 0.0, 0.0])  # upright with the forearm level: where programs of such arms begin
BLOCKED = 60.0  # s added for a straight move that is not free: going around costs time, and a search
ROUNDS = 4  # of checking a tour and mending it


@dataclass(frozen=True)
class MeasuringPose:
    """One pose: joints (6,) rad and the signs (6,) of the first of its two approaches."""

    q: Array
    sign: Array


@dataclass(frozen=True)
class Tour:
    """Order (n,) of the poses, home (6,) rad, and `ways`, n + 1 polylines (k, 6) rad: from home to the first approach, from
    pose to the next approach, from the last pose home; `seconds` of travel at full axis speed."""

    order: Index
    home: Array
    ways: list[Array]
    seconds: float


def approaches(stop: MeasuringPose, angle: float) -> tuple[Array, Array]:
    """Joints (6,) from which a pose is approached, first against its signs, then with them; `angle` rad away on every axis."""
    return stop.q - angle * stop.sign, stop.q + angle * stop.sign


def find_tour(robot: Robot, scene: CollisionScene, stops: list[MeasuringPose], angle: float, seed: int) -> Tour:
    """A short, free tour from home through all stops and back. Raises Infeasible: a pose that no free way leads to."""
    home = _home(robot, scene, stops)
    enter = np.array([home, *(approaches(s, angle)[0] for s in stops)])
    leave = np.array([home, *(s.q for s in stops)])
    seconds = (np.abs(leave[:, None] - enter[None]) / robot.qd_max).max(axis=-1)
    free: dict[tuple[int, int], bool] = {}
    order = _two_opt(seconds, _nearest(seconds))
    for _ in range(ROUNDS):
        legs = list(itertools.pairwise([0, *order, 0]))
        for a, b in legs:
            if (a, b) not in free:
                free[a, b] = is_free(scene, np.array([leave[a], enter[b]]))
                seconds[a, b] += 0.0 if free[a, b] else BLOCKED
        if all(free[leg] for leg in legs):
            break
        order = _two_opt(seconds, order)
    ways = [_way(robot, scene, leave[a], enter[b], home, seed) for a, b in itertools.pairwise([0, *order, 0])]
    travel = sum((np.abs(np.diff(way, axis=0)) / robot.qd_max).max(axis=1).sum() for way in ways)
    return Tour(np.array(order, dtype=np.int64) - 1, home, ways, float(travel))


def _home(robot: Robot, scene: CollisionScene, stops: list[MeasuringPose]) -> Array:
    """HOME, or the stop with the most room where HOME is not free."""
    inside = bool(((HOME > robot.q_min) & (HOME < robot.q_max)).all())
    if inside and scene.clearance(HOME[None], in_contact=False).value >= 0:
        return HOME
    q = np.array([s.q for s in stops])
    return np.asarray(q[int(np.argmax(scene.clearances(q, in_contact=False)[0]))])


def _nearest(seconds: Array) -> list[int]:
    """Nearest neighbour from node 0 (home), which is left out of the list."""
    left, order, at = set(range(1, len(seconds))), [], 0
    while left:
        at = min(left, key=lambda j: (seconds[at, j], j))
        order.append(at)
        left.remove(at)
    return order


def _two_opt(seconds: Array, order: list[int]) -> list[int]:
    """Reverse stretches of the closed tour through node 0 while that shortens it (costs need not be symmetric)."""

    def length(tour: list[int]) -> float:
        nodes = np.array([0, *tour, 0])
        return float(seconds[nodes[:-1], nodes[1:]].sum())

    best, shortest, improved = list(order), length(order), True
    while improved:
        improved = False
        for i, j in itertools.combinations(range(len(best) + 1), 2):
            tour = best[:i] + best[i:j][::-1] + best[j:]
            if (new := length(tour)) < shortest - 1e-9:
                best, shortest, improved = tour, new, True
    return best


def _way(robot: Robot, scene: CollisionScene, start: Array, goal: Array, home: Array, seed: int) -> Array:
    """A free polyline: straight, over home, or found by a search."""
    for way in (np.array([start, goal]), np.array([start, home, goal])):
        if is_free(scene, way):
            return way
    found = connect(scene, robot.q_min, robot.q_max, start, goal, COLLISION_STEP, seed)
    if found is None:
        raise Infeasible(f"no free way leads from {_text(start)} to {_text(goal)} deg; take another --seed, or clear the cell")
    return found


def _text(q: Array) -> str:
    return "(" + ", ".join(f"{v:.0f}" for v in np.degrees(q)) + ")"
