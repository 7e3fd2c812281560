"""Tetrahedra cut along the clamp plane, so that what is held ends exactly there.

A mesh that ignores the plane holds a ragged edge up to half an element off; on a 100 mm blade of 2 mm elements
that alone changes the tip's compliance by 3 %.
"""

import numpy as np
from numpy.typing import NDArray

from ocp.contact.blade.elasticity import EDGES
from robots.errors import BadInput

Array = NDArray[np.float64]
Index = NDArray[np.int64]

ON_PLANE = 1e-3  # of the mean edge length: nearer vertices are moved onto the plane


def clamp_cut(points: Array, tetrahedra: Index, normal: Array, offset: float) -> tuple[Array, Index]:
    """Split tetrahedra so that none reaches across the plane `normal . x = offset`.

    Args:
        points: (np, 3) m.
        tetrahedra: (nt, 4).
        normal: (3,) unit; everything with normal . x < offset is held.
        offset: m.

    Returns:
        Points and tetrahedra.

    Raises:
        BadInput: the clamp holds nothing or everything.
    """
    height = points @ normal - offset
    lowest, highest = height.min(), height.max()
    edge = points[tetrahedra[:, 0]] - points[tetrahedra[:, 1]]
    near = np.abs(height) < ON_PLANE * np.mean(np.linalg.norm(edge, axis=1))
    points = points - np.where(near, height, 0.0)[:, None] * normal
    height[near] = 0.0
    if height.min() >= 0.0 or height.max() <= 0.0:
        raise BadInput(
            f"the clamp plane at {offset * 1e3:.4g} mm holds {'nothing' if height.min() >= 0.0 else 'all'} of the blade, "
            f"which reaches from {(lowest + offset) * 1e3:.4g} to {(highest + offset) * 1e3:.4g} mm along the clamp normal; "
            "move clamp_to_mm between them"
        )
    while True:
        low, high = _edges(tetrahedra)
        crossing = height[low] * height[high] < 0.0
        if not crossing.any():
            return points, tetrahedra
        low, high = low[crossing], high[crossing]
        share = height[low] / (height[low] - height[high])
        count = len(points)
        points, tetrahedra = _split(points, tetrahedra, low, high, share)
        height = np.concatenate([height, np.zeros(len(points) - count)])


def _edges(tetrahedra: Index) -> tuple[Index, Index]:
    """Return the two ends of every edge once, the smaller number first."""
    ends = np.sort(tetrahedra[:, EDGES].reshape(-1, 2), axis=1)
    key = np.unique(ends[:, 0] * (tetrahedra.max() + 1) + ends[:, 1])
    low, high = np.divmod(key, tetrahedra.max() + 1)
    return low, high


def _split(points: Array, tetrahedra: Index, low: Index, high: Index, share: Array) -> tuple[Array, Index]:
    """Split those of the listed edges that come first in every tetrahedron around them.

    The new vertex lies at `share` of the way from `low` to `high`; both halves of each tetrahedron stay in the list,
    so the mesh stays conforming.
    """
    count = len(points)
    ends = np.sort(tetrahedra[:, EDGES], axis=2)
    wanted = low * count + high
    key = ends[..., 0] * count + ends[..., 1]
    found = np.minimum(np.searchsorted(wanted, key), len(wanted) - 1)
    owner, which = np.nonzero(wanted[found] == key)
    edge = found[owner, which]
    first = np.full(len(tetrahedra), len(low))
    np.minimum.at(first, owner, edge)
    ready = np.ones(len(low), bool)
    ready[edge[first[owner] != edge]] = False
    middle = np.cumsum(ready) - 1 + count
    new = points[low] + share[:, None] * (points[high] - points[low])
    points = np.vstack([points, new[ready]])
    taken = ready[edge]
    owner, edge = owner[taken], edge[taken]
    tetra = tetrahedra[owner]
    halves = [np.where(tetra == end[edge, None], middle[edge, None], tetra) for end in (low, high)]
    return points, np.vstack([np.delete(tetrahedra, owner, axis=0), *halves])
