"""The whole motion: order of the passes, travel between them, each timed and checked at 1 ms.

The way from one pass to the next is made here. The ways of the passes, from rest in the air to rest in the air, come from
plan/passes with the speed profile that they were planned for.
"""

import itertools
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial

import numpy as np

from ocp.model.cell import Cell
from ocp.plan.clearance import CollisionScene
from ocp.plan.passes.optimise import SolvedPass
from ocp.plan.passes.stretches import CannotGrind
from ocp.plan.rules import COLLISION_STEP, FEED_TOLERANCE, HOME_LIFT, LIMIT_SHARE, RAMP_FEED_TOLERANCE
from ocp.shell.processes import side_by_side
from robots.errors import Infeasible
from robots.kinematics import forward, jacobian
from robots.pose import Array
from robots.rigid_body import inverse_dynamics
from trajectories.joint_trajectory import JointTrajectory, Limits, sample_times
from trajectories.timing import time_contact_path, time_joint_move

PASS_WINDOW = 0.01  # s, running mean of a pass's time law: its rate is smooth already


@dataclass(frozen=True)
class MotionSegment:
    """A timed piece of the program: `kind` is travel or pass; `place` the pass in driving order."""

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

    def way(self, place: int) -> MotionSegment:
        """The segment of the pass at `place`, from air to air."""
        return next(s for s in self.segments if s.kind == "pass" and s.place == place)


def build_motion(
    cell: Cell, scene: CollisionScene, solved: list[SolvedPass], advance: Callable[[], None] = lambda: None
) -> PlannedMotion:
    """Order the passes for short travel, join them by free moves and time everything.

    Raises Infeasible: no free way through the air, or a limit that cannot be held.
    """
    payload = cell.workpiece.payload
    limits = Limits.of(cell.robot, partial(inverse_dynamics, cell.robot, payload.mass, payload.com), LIMIT_SHARE)
    order = _order(cell, [(p.solution.q[0], p.solution.q[-1]) for p in solved])
    passes = [solved[i] for i in order]
    home = lifted(cell, passes[0].solution.q[0], _normal(cell, passes[0], 0), np.array([HOME_LIFT]))[0]
    segments: list[MotionSegment] = []
    time = 0.0

    def add(kind: str, place: int, trajectory: JointTrajectory) -> None:
        nonlocal time
        segments.append(MotionSegment(kind, place, trajectory, time))
        time += trajectory.duration

    def go(place: int, start: tuple[Array, Array], goal: tuple[Array, Array], label: str) -> None:
        try:
            points = travel(cell, scene, start, goal)
        except Infeasible as error:
            stuck = place > 0 and not is_free(scene, start[0][None])
            raise _out_of_reach(passes[min(place - stuck, len(passes) - 1)], error) from None
        for a, b in itertools.pairwise(points):
            if np.abs(b - a).max() > 1e-9:
                add("travel", place, time_joint_move(a, b, limits, label=label))

    where = at_home = (home, _normal(cell, passes[0], 0))
    names = [f"line {one.problem.path.line} ({one.problem.path.side})" for one in passes]
    with side_by_side(_timed, list(zip(passes, names, strict=True)), limits) as ways:
        for place, (one, name) in enumerate(zip(passes, names, strict=True)):
            go(place, where, (one.solution.q[0], _normal(cell, one, 0)), f"{name}, approach")
            add("pass", place, next(ways))
            where = (one.solution.q[-1], _normal(cell, one, -1))
            advance()
    go(len(passes), where, at_home, "way home")
    return PlannedMotion(passes, segments)


def _out_of_reach(solved: SolvedPass, error: Infeasible) -> CannotGrind:
    """The whole of a pass that the arm cannot come to or leave."""
    path = solved.problem.path
    remedy = "move the wheel or use a smaller one, or a longer holder"
    return CannotGrind.of(path, np.ones(len(path.s), bool), str(error).removesuffix("; move the wheel"), remedy, 0, str(error))


def _normal(cell: Cell, solved: SolvedPass, k: int) -> Array:
    """Outward wheel radial (3,) in the base frame at waypoint k, from the arc angle."""
    return cell.wheel.outward(solved.evaluation.arc[k])


def _timed(limits: Limits, one: SolvedPass, name: str) -> JointTrajectory:
    """The way of a pass at the rate it was planned for; its parameter is nominal time times the line's mean feed, m.

    Raises CannotGrind where that rate is not met in contact.
    """
    path, course = one.problem.path, one.problem.way
    feed = float(path.feed.mean())
    stations, bound = course.at * feed, one.solution.rate * feed
    trajectory = time_contact_path(one.solution.q, stations, bound, limits, PASS_WINDOW, name, at_rest=True)
    t = sample_times(trajectory)
    nominal = trajectory.s(t) / feed
    on = (nominal > course.edges[1]) & (nominal < course.edges[4])
    met = (trajectory.feed(t) / np.interp(nominal, course.at, one.solution.rate * feed))[on]
    full = (nominal[on] >= course.edges[2]) & (nominal[on] <= course.edges[3])
    least = 1 - np.where(full, FEED_TOLERANCE, RAMP_FEED_TOLERANCE)
    i = int(np.argmin(met - least))
    if met[i] < least[i]:
        k = int(np.argmin(np.abs(course.at - nominal[on][i])))
        reason = f"the arm reaches {100 * met[i]:.1f} % of the planned feed (at least {100 * least[i]:g})"
        raise CannotGrind.of(path, np.ones(len(path.s), bool), reason, "lower the feed", k)
    return trajectory


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


FAR = (0.10, 0.20, 0.35)  # m off contact, tried in turn as via points between passes
GROW = np.radians(10.0)  # longest edge of a tree
ATTEMPTS = 3000
SHORTCUTS = 60


def lifted(cell: Cell, q: Array, normal: Array, distances: Array) -> Array:
    """Joints (m, 6) with the blade of contact joints q (6,) moved off the wheel by `distances` (m,) along normal (3,).

    The pose relative to the contact is exact in the nominal kinematics; the calibrated arm differs from it by far less
    than a clearance. Raises Infeasible: an axis limit or a singularity is in the way.
    """
    T0 = forward(cell.robot, q[None])[0]
    joints, current = [], np.asarray(q, float).copy()
    travelled = 0.0
    for distance in distances:
        for goal in np.linspace(travelled, distance, 1 + int(np.ceil(abs(distance - travelled) / 0.03)))[1:]:
            current = _track(cell, current, T0, goal * normal)
        travelled = float(distance)
        joints.append(current.copy())
    result = np.array(joints)
    over = np.maximum(cell.robot.q_min - result, result - cell.robot.q_max)
    if over.max() > 0:
        axis = int(np.argmax(over.max(axis=0)))
        raise Infeasible(
            f"lifting the blade {max(distances) * 1e3:.0f} mm off the wheel drives axis {axis + 1} "
            f"{np.degrees(over.max()):.1f} deg beyond its limit; move the wheel or the blade in its holder"
        )
    return result


def _track(cell: Cell, q: Array, T0: Array, shift: Array) -> Array:
    """Newton steps from q to the pose T0 moved by `shift` (3,)."""
    for _ in range(20):
        T = forward(cell.robot, q[None])[0]
        R = T0[:3, :3] @ T[:3, :3].T
        rotation = 0.5 * np.array([R[2, 1] - R[1, 2], R[0, 2] - R[2, 0], R[1, 0] - R[0, 1]])
        error = np.concatenate([T0[:3, 3] + shift - T[:3, 3], rotation])
        if np.abs(error).max() < 1e-12:
            break
        q = q + np.linalg.solve(jacobian(cell.robot, q[None])[0], error)
    if np.abs(error).max() > 1e-9:
        raise Infeasible(
            f"the arm cannot follow the contact normal {np.linalg.norm(shift) * 1e3:.0f} mm off the wheel (singular posture)"
        )
    return q


def dense(points: Array, step: float = COLLISION_STEP) -> Array:
    """A joint polyline (k, 6) sampled so that no axis moves more than `step` rad between neighbours."""
    pieces = [points[:1]]
    for a, b in itertools.pairwise(points):
        m = max(1, int(np.ceil(np.abs(b - a).max() / step)))
        pieces.append(a + (b - a) * (np.arange(1, m + 1) / m)[:, None])
    return np.vstack(pieces)


def is_free(scene: CollisionScene, points: Array) -> bool:
    """True if the straight joint moves along `points` (k, 6), looked at every COLLISION_STEP, keep all margins off contact."""
    return scene.clearance(dense(points), in_contact=False).value >= 0


def travel(cell: Cell, scene: CollisionScene, start: tuple[Array, Array], goal: tuple[Array, Array]) -> Array:
    """Via points (k, 6), ends included, of a free way between two clear poses.

    `start` and `goal` are (joints at rest in the air, outward wheel radial (3,)) of the passes. Straight first,
    then by retreat points farther out, then by a search. Raises Infeasible where nothing is found.
    """
    (qa, na), (qb, nb) = start, goal
    direct = np.array([qa, qb])
    if is_free(scene, direct):
        return direct
    for far in FAR:
        try:
            via = np.array([qa, lifted(cell, qa, na, np.array([far]))[0], lifted(cell, qb, nb, np.array([far]))[0], qb])
        except Infeasible:
            continue
        if is_free(scene, via):
            return via
    found = connect(scene, cell.robot.q_min, cell.robot.q_max, qa, qb)
    if found is None:
        clearance = scene.clearance(dense(direct), in_contact=False)
        raise Infeasible(f"no free way through the air: on the straight move {clearance.sentence()}; move the wheel")
    return found


def connect(scene: CollisionScene, low: Array, high: Array, start: Array, goal: Array, seed: int = 0) -> Array | None:
    """A collision-free joint polyline (k, 6) from `start` to `goal` within low..high, or None after `ATTEMPTS` samples.

    Two trees are grown toward each other (RRT-Connect, Kuffner and LaValle 2000).

    Same inputs, same answer: the samples come from a generator with a fixed seed.
    """
    rng = np.random.default_rng(seed)
    trees: list[list[Array]] = [[np.asarray(start, float)], [np.asarray(goal, float)]]
    parents: list[list[int]] = [[-1], [-1]]
    lower, upper = np.minimum(start, goal) - np.radians(60), np.maximum(start, goal) + np.radians(60)
    lower, upper = np.maximum(lower, low), np.minimum(upper, high)
    for attempt in range(ATTEMPTS):
        a = attempt % 2
        reached = _extend(scene, trees[a], parents[a], rng.uniform(lower, upper))
        if reached is None:
            continue
        target = trees[a][reached]
        while (other := _extend(scene, trees[1 - a], parents[1 - a], target)) is not None:
            if np.allclose(trees[1 - a][other], target):
                ends = (reached, other) if a == 0 else (other, reached)
                points = _branch(trees[0], parents[0], ends[0])[::-1] + _branch(trees[1], parents[1], ends[1])[1:]
                return _shortened(scene, np.array(points), rng)
    return None


def _extend(scene: CollisionScene, tree: list[Array], parents: list[int], target: Array) -> int | None:
    """Grow the tree one edge toward target; the new node's index, or None where something is in the way."""
    nodes = np.array(tree)
    nearest = int(np.argmin(np.linalg.norm(nodes - target, axis=1)))
    direction = target - nodes[nearest]
    length = np.abs(direction).max()
    new = target if length <= GROW else nodes[nearest] + direction * (GROW / length)
    if length < 1e-12 or not is_free(scene, np.array([nodes[nearest], new])):
        return None
    tree.append(new)
    parents.append(nearest)
    return len(tree) - 1


def _branch(tree: list[Array], parents: list[int], node: int) -> list[Array]:
    """Nodes from `node` to the root."""
    points = []
    while node >= 0:
        points.append(tree[node])
        node = parents[node]
    return points


def _shortened(scene: CollisionScene, points: Array, rng: np.random.Generator) -> Array:
    """Cut corners where the straight move is free."""
    for _ in range(SHORTCUTS):
        if len(points) <= 2:
            break
        i, j = sorted(rng.choice(len(points), 2, replace=False))
        if j > i + 1 and is_free(scene, points[[i, j]]):
            points = np.vstack([points[: i + 1], points[j:]])
    return points
