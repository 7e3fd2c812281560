"""A way around obstacles in joint space: two trees grown toward each other (RRT-Connect, Kuffner and LaValle 2000)."""

import numpy as np

from ocp.plan.motion.collision import Scene
from robots.pose import Array

GROW = np.radians(10.0)  # longest edge of a tree
ATTEMPTS = 3000
SHORTCUTS = 60


def connect(scene: Scene, low: Array, high: Array, start: Array, goal: Array, step: float, seed: int = 0) -> Array | None:
    """A collision-free joint polyline (k, 6) from `start` to `goal` within low..high, or None after `ATTEMPTS` samples.

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


def _free(scene: Scene, a: Array, b: Array, step: float) -> bool:
    m = max(2, int(np.ceil(np.abs(b - a).max() / step)) + 1)
    return scene.clearance(a + (b - a) * np.linspace(0, 1, m)[:, None], in_contact=False).value >= 0


def _extend(scene: Scene, tree: list[Array], parents: list[int], target: Array, step: float) -> int | None:
    """Grow the tree one edge toward target; the new node's index, or None where something is in the way."""
    nodes = np.array(tree)
    nearest = int(np.argmin(np.linalg.norm(nodes - target, axis=1)))
    direction = target - nodes[nearest]
    length = np.abs(direction).max()
    new = target if length <= GROW else nodes[nearest] + direction * (GROW / length)
    if length < 1e-12 or not _free(scene, nodes[nearest], new, step):
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


def _shortened(scene: Scene, points: Array, step: float, rng: np.random.Generator) -> Array:
    """Cut corners where the straight move is free."""
    for _ in range(SHORTCUTS):
        if len(points) <= 2:
            break
        i, j = sorted(rng.choice(len(points), 2, replace=False))
        if j > i + 1 and _free(scene, points[i], points[j], step):
            points = np.vstack([points[: i + 1], points[j:]])
    return points
