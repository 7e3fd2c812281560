"""The way through the poses, the programs that drive it, one a payload, and their reading back: what stops where.

Payload by payload, short travel, every move checked: nearest neighbour, 2-opt, then via points.
"""

import itertools
import re
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ocp.model.cell import Cell
from ocp.plan.clearance import CollisionScene
from ocp.plan.motion import connect, is_free
from ocp.plan.programming import program_setup, write_program
from ocp.poses.rules import APPROACH_SHARE, READ_BACK_TOLERANCE
from robots.errors import Infeasible
from robots.pose import Array
from robots.robot import Robot
from robots.tracker_readings import Hanging
from trajectories.dialects import dialect_named
from trajectories.program import program as written

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
    found = connect(scene, robot.q_min, robot.q_max, start, goal, seed)
    if found is None:
        raise Infeasible(f"no free way leads from {_text(start)} to {_text(goal)} deg; take another --seed, or clear the cell")
    return found


def _text(q: Array) -> str:
    return "(" + ", ".join(f"{v:.0f}" for v in np.degrees(q)) + ")"


MOST = 300  # poses of one sub-program; six points each at most without detours


@dataclass(frozen=True)
class MeasurementCampaign:
    """What is measured with one payload: its name and mass, stops in the order of the tour, their nests, the tour."""

    payload: str
    hanging: Hanging
    stops: list[MeasuringPose]
    targets: list[str]
    tour: Tour


def measuring_program(
    cell: Cell, campaign: MeasurementCampaign, angle: float, wait: written.Wait, name: str, speed: int, taken: set[str]
) -> written.Program:
    """The program of a campaign, which waits at every reading; `speed` percent of the axis speeds, `taken` names already used
    in the folder."""
    blocks: list[written.Block] = [written.PointMotion(campaign.tour.home, speed)]
    groups: list[list[written.Block]] = []
    for k, (pose, target, way) in enumerate(zip(campaign.stops, campaign.targets, campaign.tour.ways, strict=False)):
        blocks += [written.PointMotion(q, speed) for q in way[1:]]
        for reading, start in zip((1, 2), approaches(pose, angle), strict=True):
            if reading == 2:
                blocks.append(written.PointMotion(start, speed))
            text = f"pose {k + 1} of {len(campaign.stops)}, reading {reading}, target {target}"
            blocks += [written.Comment(text), written.PointMotion(pose.q, speed), wait]
        if (k + 1) % MOST == 0:
            groups.append(blocks)
            blocks = [written.PointMotion(pose.q, speed)]
    blocks += [written.PointMotion(q, speed) for q in campaign.tour.ways[-1][1:]]
    groups.append(blocks)
    dialect = dialect_named(cell.controller.dialect)
    main, names = dialect.program_names(f"{name}_{campaign.payload}", len(groups), taken=taken)
    label = f"readings with payload {campaign.payload}"
    subs = tuple(written.SubProgram(n[0], tuple(b), label) for n, b in zip(names, groups, strict=True))
    setup = program_setup(cell, campaign.hanging)
    comments = (
        f"mount payload {campaign.payload}, {campaign.hanging.mass:g} kg, before this program starts",
        f"{len(campaign.stops)} poses, each read twice: after its axes came from either side",
        "the first move, to the home posture, starts where the robot stands: drive it in T1",
    )
    return written.Program(main, setup, subs, comments)


def write_and_check(
    cell: Cell, scene: CollisionScene, program: written.Program, campaign: MeasurementCampaign, angle: float, folder: Path
) -> list[str]:
    """Write a program into `folder`, read it back and compare. Names of its files.

    Raises BadInput as the independent checks do, Infeasible where the text does not stop where it should, comes from another
    side, or passes through something.
    """
    files = write_program(cell, program, folder)
    main, controller = files[0], cell.controller
    execution = dialect_named(controller.dialect).check(main, cell.robot, controller.absolute_accuracy, pauses=True)
    points = [s.q[-1] for s in execution.segments if s.q is not None]
    stopped = execution.stops
    wanted = [(pose.q, sign) for pose in campaign.stops for sign in (pose.sign, -pose.sign)]
    if len(stopped) != len(wanted):
        raise Infeasible(f"{main.name} read back stops {len(stopped)} times, {len(wanted)} readings were planned")
    for k, (at, (q, sign)) in enumerate(zip(stopped, wanted, strict=True)):
        last = points[at] - points[at - 1]
        wrong_side = (np.sign(last) != sign).any() or np.abs(last).min() < APPROACH_SHARE * angle
        if np.abs(points[at] - q).max() > READ_BACK_TOLERANCE or wrong_side:
            raise Infeasible(f"{main.name} read back is not where reading {k + 1} was planned, or comes from another side")
    if not is_free(scene, np.array(points)):
        raise Infeasible(f"{main.name} read back touches something between its points")
    return [file.name for file in files]


def base_name(text: str) -> str:
    """What a program is called before the payload's name is added: at most 8 letters and digits."""
    return re.sub(r"[^A-Za-z0-9]", "", text)[:8] or "POSES"
