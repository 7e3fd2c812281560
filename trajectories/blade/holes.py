"""Holes in the surface: small ones are closed, large ones refused with their place."""

import numpy as np

from robots.errors import BadInput
from trajectories.blade.mesh import Array, IntArray, directed_edges, place_mm

_LARGEST = 0.05  # size of a hole against the blade's size up to which it is closed
_MOST_EDGES = 60


def close_holes(name: str, vertices: Array, faces: IntArray, notices: list[str]) -> IntArray:
    """Faces with small holes closed by the triangulation of least area; (nf + new, 3).

    Raises: BadInput naming place and size of a hole too large to guess what was there.
    """
    edges = directed_edges(faces)
    forward = set(map(tuple, edges.tolist()))
    border = [(j, i) for i, j in forward if (j, i) not in forward]
    if not border:
        return faces
    size = float(np.linalg.norm(np.ptp(vertices[np.unique(faces)], axis=0)))
    added: list[tuple[int, int, int]] = []
    described = []
    for loop in _loops(name, vertices, border):
        points = vertices[loop]
        across = float(np.linalg.norm(np.ptp(points, axis=0)))
        middle = place_mm(points.mean(axis=0))
        if across > _LARGEST * size or len(loop) > _MOST_EDGES:
            raise BadInput(
                f"{name}: the surface is open: a hole {1e3 * across:.1f} mm across with {len(loop)} edges round {middle} "
                f"(holes up to {1e3 * _LARGEST * size:.1f} mm are closed); export a closed solid."
            )
        added += _least_area(points, loop)
        described.append(f"{1e3 * across:.2f} mm at {middle}")
    shown = ", ".join(described[:3]) + (", .." if len(described) > 3 else "")
    notices.append(f"{len(described)} holes were closed with {len(added)} facets: {shown}.")
    return np.concatenate([faces, np.array(added, np.int64)])


def _loops(name: str, vertices: Array, border: list[tuple[int, int]]) -> list[list[int]]:
    """Closed vertex loops along the border, in the direction that new facets need."""
    following: dict[int, list[int]] = {}
    for i, j in border:
        following.setdefault(i, []).append(j)
    loops = []
    while following:
        start = next(iter(following))
        loop = [start]
        while True:
            options = following.get(loop[-1])
            if not options:
                raise BadInput(f"{name}: the border of a hole at {place_mm(vertices[loop[-1]])} does not close; export it again.")
            step = options.pop()
            if not options:
                del following[loop[-1]]
            if step == start:
                break
            if step in loop:  # two holes touch in a vertex: cut the smaller loop off
                k = loop.index(step)
                loops.append(loop[k:])
                loop = loop[: k + 1]
            else:
                loop.append(step)
        loops.append(loop)
    return [loop for loop in loops if len(loop) > 2]


def _least_area(points: Array, loop: list[int]) -> list[tuple[int, int, int]]:
    """Triangulation of a closed polygon in space with least total area (Barequet and Sharir 1995, section 3)."""
    n = len(loop)
    cost = np.zeros((n, n))
    split = np.zeros((n, n), int)
    for gap in range(2, n):
        for i in range(n - gap):
            k = i + gap
            m = np.arange(i + 1, k)
            area = 0.5 * np.linalg.norm(np.cross(points[m] - points[i], points[k] - points[i]), axis=1)
            total = cost[i, m] + cost[m, k] + area
            best = int(np.argmin(total))
            cost[i, k], split[i, k] = total[best], m[best]
    triangles = []
    stack = [(0, n - 1)]
    while stack:
        i, k = stack.pop()
        if k - i < 2:
            continue
        middle = int(split[i, k])
        triangles.append((loop[i], loop[middle], loop[k]))
        stack += [(i, middle), (middle, k)]
    return triangles
