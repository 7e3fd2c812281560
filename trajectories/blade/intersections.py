"""Facets of one surface that cut through each other: a tree of boxes against itself, then exact pair tests."""

import numpy as np

from trajectories.blade.mesh import Array, IntArray

_TOUCH = 1e-9  # share of an edge or a facet within which a crossing counts as touching only


def self_intersections(vertices: Array, faces: IntArray) -> IntArray:
    """Pairs (n, 2) of facets that cut each other, or that share an edge and lie folded onto each other."""
    pairs = overlapping_boxes(vertices[faces].min(axis=1), vertices[faces].max(axis=1))
    shared = (faces[pairs[:, 0], :, None] == faces[pairs[:, 1], None, :]).any(axis=2).sum(axis=1)
    cut = np.zeros(len(pairs), bool)
    for few in (0, 1):
        rows = np.flatnonzero(shared == few)
        for a, b in ((0, 1), (1, 0)):
            cut[rows] |= _edges_pierce(vertices, faces, pairs[rows, a], pairs[rows, b])
    rows = np.flatnonzero(shared == 2)
    cut[rows] = _folded(vertices, faces, pairs[rows])
    return pairs[cut]


def overlapping_boxes(low: Array, high: Array) -> IntArray:
    """Index pairs (n, 2), first < second, of overlapping axis-parallel boxes (m, 3), (m, 3).

    A balanced tree, split at the median along the widest axis, is compared with itself level by level.
    """
    depth = max(int(np.ceil(np.log2(max(len(low), 2)))), 1)
    order = _median_order(0.5 * (low + high), depth)
    real = order >= 0
    box_low = np.where(real[:, None], low[order], np.inf)
    box_high = np.where(real[:, None], high[order], -np.inf)
    levels = [(box_low, box_high)]
    for _ in range(depth):
        a, b = levels[-1]
        levels.append((np.minimum(a[::2], a[1::2]), np.maximum(b[::2], b[1::2])))
    i = j = np.zeros(1, np.int64)
    for level in range(depth - 1, -1, -1):
        a, b = levels[level]
        i, j = (np.concatenate(x) for x in ((2 * i, 2 * i, 2 * i + 1, 2 * i + 1), (2 * j, 2 * j + 1, 2 * j, 2 * j + 1)))
        upper = i <= j
        i, j = i[upper], j[upper]
        meet = np.logical_and(a[i] <= b[j], a[j] <= b[i]).all(axis=1)
        i, j = i[meet], j[meet]
    pairs = order[np.stack([i, j], axis=1)]
    return np.sort(pairs[i != j], axis=1)


def _median_order(centres: Array, depth: int) -> IntArray:
    """Box numbers in the order of the tree's leaves, (2^depth,); -1 fills up."""
    order = np.full(2**depth, -1, np.int64)
    order[: len(centres)] = np.arange(len(centres))
    padded = np.concatenate([centres, np.full((1, 3), np.inf)]).T.copy()  # the last stands for the filling, numbered -1
    for level in range(depth):
        blocks = order.reshape(2**level, -1)
        x = padded[:, blocks]
        largest = np.where(np.isfinite(x), x, -np.inf).max(axis=2)
        with np.errstate(invalid="ignore"):  # blocks of nothing but filling
            spread = np.nan_to_num(largest - x.min(axis=2), nan=0.0, neginf=0.0)
        key = np.take_along_axis(x, np.argmax(spread, axis=0)[None, :, None], axis=0)[0]
        half = np.argpartition(key, blocks.shape[1] // 2 - 1, axis=1)  # infinity, the filling, comes last
        order = np.take_along_axis(blocks, half, axis=1).ravel()
    return order


def _edges_pierce(vertices: Array, faces: IntArray, one: IntArray, other: IntArray) -> np.ndarray:
    """Whether an edge of facet `one` that has no corner in common with facet `other` passes through its inside."""
    result = np.zeros(len(one), bool)
    a, b, c = (vertices[faces[:, k]] for k in range(3))
    off = np.einsum("nkc,nc->nk", vertices[faces[one]] - a[other, None], np.cross(b - a, c - a)[other])
    for k in range(3):
        # Only an edge whose ends lie to either side of the other's plane passes through it.
        rows = np.flatnonzero(off[:, k] * off[:, (k + 1) % 3] < 0.0)
        result[rows] |= _edge_pierces(vertices, faces[one[rows], k], faces[one[rows], (k + 1) % 3], faces[other[rows]])
    return result


def _edge_pierces(vertices: Array, i: IntArray, j: IntArray, facets: IntArray) -> np.ndarray:
    """Whether an edge from corner i (n,) to j passes through the inside of a facet (n, 3) with other corners."""
    a, b, c = (vertices[facets[:, k]] for k in range(3))
    e1, e2 = b - a, c - a
    free = ~((facets == i[:, None]) | (facets == j[:, None])).any(axis=1)
    p, d = vertices[i], vertices[j] - vertices[i]
    # Moeller and Trumbore 1997, eq. 6: p + s d = a + x e1 + y e2
    h = np.cross(d, e2)
    det = np.einsum("ni,ni->n", e1, h)
    scale = np.linalg.norm(d, axis=1) * np.linalg.norm(np.cross(e1, e2), axis=1)
    free &= np.abs(det) > 1e-12 * scale
    inverse = 1.0 / np.where(free, det, 1.0)
    r = p - a
    q = np.cross(r, e1)
    x = np.einsum("ni,ni->n", r, h) * inverse
    y = np.einsum("ni,ni->n", d, q) * inverse
    s = np.einsum("ni,ni->n", e2, q) * inverse
    return np.asarray(free & (x > _TOUCH) & (y > _TOUCH) & (x + y < 1.0 - _TOUCH) & (s > _TOUCH) & (s < 1.0 - _TOUCH))


def _folded(vertices: Array, faces: IntArray, pairs: IntArray) -> np.ndarray:
    """Whether two facets with a common edge lie on each other, their free corners on the same side of the edge."""
    f, g = faces[pairs[:, 0]], faces[pairs[:, 1]]
    mine = (f[:, :, None] == g[:, None, :]).any(axis=2)
    yours = (g[:, :, None] == f[:, None, :]).any(axis=2)
    rows = np.arange(len(pairs))
    k = np.argmin(mine, axis=1)
    tip, base, end = f[rows, k], f[rows, (k + 1) % 3], f[rows, (k + 2) % 3]
    other = g[rows, np.argmin(yours, axis=1)]
    e = vertices[end] - vertices[base]
    e = e / np.linalg.norm(e, axis=1, keepdims=True)
    heights = []
    for corner in (tip, other):
        r = vertices[corner] - vertices[base]
        r = r - np.einsum("ni,ni->n", r, e)[:, None] * e
        heights.append(r / np.maximum(np.linalg.norm(r, axis=1, keepdims=True), 1e-30))
    return np.asarray(np.einsum("ni,ni->n", *heights) > 1.0 - 1e-9)
