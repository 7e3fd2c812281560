"""Level sets of a scalar field on a closed triangle mesh: planar sections are the level sets of a linear field."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from trajectories.blade.mesh import directed_edges, edge_keys

Array = NDArray[np.float64]
IntArray = NDArray[np.int64]


@dataclass(frozen=True)
class Loop:
    """One closed polygon of a level set, the body on its left seen against the gradient of the field.

    points (n, 3) m; point i + 1 follows point i across facet `facets[i]`; the last joins the first.
    """

    points: Array
    facets: IntArray

    @property
    def lengths(self) -> Array:
        """Length of the segment that starts at each point, (n,) m."""
        return np.asarray(np.linalg.norm(np.roll(self.points, -1, axis=0) - self.points, axis=1))


@dataclass(frozen=True)
class Slicer:
    """A mesh prepared for many slices: the three edges of each facet as keys."""

    vertices: Array
    faces: IntArray
    edge_key: IntArray  # (nf, 3)


def slicer(vertices: Array, faces: IntArray) -> Slicer:
    """Prepare a closed mesh for `level_loops`."""
    keys = edge_keys(directed_edges(faces), len(vertices)).reshape(3, -1).T
    return Slicer(vertices, faces, keys)


def level_loops(mesh: Slicer, field: Array, level: float) -> list[Loop]:
    """Closed polygons where `field` (nv,), linear on every facet, equals `level`; the longest first.

    A vertex exactly on the level counts as above it, so that every crossed facet has one edge in and one edge out
    and the facets of a loop form a cycle (the usual perturbation argument).
    """
    above = field[mesh.faces] >= level
    crossed = np.flatnonzero(above.any(axis=1) & ~above.all(axis=1))
    if not len(crossed):
        return []
    above = above[crossed]
    nxt = np.roll(above, -1, axis=1)
    up = np.argmax(~above & nxt, axis=1)  # edge that goes from below to above
    down = np.argmax(above & ~nxt, axis=1)
    rows = np.arange(len(crossed))
    keys = mesh.edge_key[crossed]
    up_key, down_key = keys[rows, up], keys[rows, down]
    # The neighbour across my up edge walks the same edge downwards: going from down edge to up edge keeps the
    # body on the left.
    order = np.argsort(down_key)
    following = order[np.minimum(np.searchsorted(down_key[order], up_key), len(order) - 1)]
    i = mesh.faces[crossed, down]
    j = mesh.faces[crossed, (down + 1) % 3]
    weight = ((field[i] - level) / (field[i] - field[j]))[:, None]
    points = (1.0 - weight) * mesh.vertices[i] + weight * mesh.vertices[j]
    loops = [Loop(points[cycle], crossed[cycle]) for cycle in _cycles(following.tolist())]
    return sorted(loops, key=lambda loop: -float(loop.lengths.sum()))


def _cycles(following: list[int]) -> list[IntArray]:
    seen = [False] * len(following)
    cycles = []
    for start in range(len(following)):
        cycle = []
        k = start
        while not seen[k]:
            seen[k] = True
            cycle.append(k)
            k = following[k]
        if len(cycle) > 2:
            cycles.append(np.array(cycle))
    return cycles
