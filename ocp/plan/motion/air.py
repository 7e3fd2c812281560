"""Moves off contact: engaging along the contact normal, and the way from one pass to the next."""

import itertools

import numpy as np

from ocp.model.cell import Cell
from ocp.plan.clearance.collision import CollisionScene
from ocp.plan.rules import COLLISION_STEP
from robots.errors import Infeasible
from robots.kinematics import forward, jacobian
from robots.pose import Array

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


def is_free(scene: CollisionScene, points: Array, step: float = COLLISION_STEP) -> bool:
    """True if the straight joint moves along `points` (k, 6), looked at every `step` rad, keep all margins off contact."""
    return scene.clearance(dense(points, step), in_contact=False).value >= 0


def travel(cell: Cell, scene: CollisionScene, start: tuple[Array, Array], goal: tuple[Array, Array]) -> Array:
    """Via points (k, 6), ends included, of a free way between two clear poses.

    `start` and `goal` are (contact joints lifted by LIFT_OFF, outward wheel radial (3,)) of the passes. Straight first,
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
    found = connect(scene, cell.robot.q_min, cell.robot.q_max, qa, qb, COLLISION_STEP)
    if found is None:
        clearance = scene.clearance(dense(direct), in_contact=False)
        raise Infeasible(f"no free way between two passes: on the straight move {clearance.sentence()}; move the wheel")
    return found


def connect(
    scene: CollisionScene, low: Array, high: Array, start: Array, goal: Array, step: float, seed: int = 0
) -> Array | None:
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
        reached = _extend(scene, trees[a], parents[a], rng.uniform(lower, upper), step)
        if reached is None:
            continue
        target = trees[a][reached]
        while (other := _extend(scene, trees[1 - a], parents[1 - a], target, step)) is not None:
            if np.allclose(trees[1 - a][other], target):
                ends = (reached, other) if a == 0 else (other, reached)
                points = _branch(trees[0], parents[0], ends[0])[::-1] + _branch(trees[1], parents[1], ends[1])[1:]
                return _shortened(scene, np.array(points), step, rng)
    return None


def _extend(scene: CollisionScene, tree: list[Array], parents: list[int], target: Array, step: float) -> int | None:
    """Grow the tree one edge toward target; the new node's index, or None where something is in the way."""
    nodes = np.array(tree)
    nearest = int(np.argmin(np.linalg.norm(nodes - target, axis=1)))
    direction = target - nodes[nearest]
    length = np.abs(direction).max()
    new = target if length <= GROW else nodes[nearest] + direction * (GROW / length)
    if length < 1e-12 or not is_free(scene, np.array([nodes[nearest], new]), step):
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


def _shortened(scene: CollisionScene, points: Array, step: float, rng: np.random.Generator) -> Array:
    """Cut corners where the straight move is free."""
    for _ in range(SHORTCUTS):
        if len(points) <= 2:
            break
        i, j = sorted(rng.choice(len(points), 2, replace=False))
        if j > i + 1 and is_free(scene, points[[i, j]], step):
            points = np.vstack([points[: i + 1], points[j:]])
    return points
