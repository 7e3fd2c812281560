"""Tetrahedra cut along the clamp plane, so that what is held ends exactly there.

A mesh that ignores the plane holds a ragged edge up to half an element off; on a 100 mm blade of 2 mm elements
that alone changes the tip's compliance by 3 %.
"""

import numpy as np
from numpy.typing import NDArray

from ocp.contact.elasticity import EDGES
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
    edge = points[tetrahedra[:, 0]] - points[tetrahedra[:, 1]]
    near = np.abs(height) < ON_PLANE * np.mean(np.linalg.norm(edge, axis=1))
    points = points - np.where(near, height, 0.0)[:, None] * normal
    height[near] = 0.0
    lowest, highest = height.min(), height.max()
    if lowest >= 0.0 or highest <= 0.0:
        span = points @ normal
        raise BadInput(f"the clamp plane at {offset * 1e3:.4g} mm holds {'nothing' if lowest >= 0.0 else 'all'} of the blade, "
                       f"which reaches from {span.min() * 1e3:.4g} to {span.max() * 1e3:.4g} mm along the clamp normal; "
                       "move clamp_to_mm between them")
    while True:
        ends = np.sort(tetrahedra[:, EDGES], axis=2)
        crossing = height[ends[..., 0]] * height[ends[..., 1]] < 0.0
        owner, which = np.nonzero(crossing)
        if not len(owner):
            return points, tetrahedra
        pair = ends[owner, which]
        key, edge_of = np.unique(pair[:, 0] * len(points) + pair[:, 1], return_inverse=True)
        # An edge is split in this round when it is the first of all crossing edges in each of its tetrahedra.
        first = np.full(len(tetrahedra), len(key))
        np.minimum.at(first, owner, edge_of)
        ready = np.ones(len(key), bool)
        ready[edge_of[first[owner] != edge_of]] = False
        number = np.cumsum(ready) - 1 + len(points)
        low, high = np.divmod(key[ready], len(points))
        share = height[low] / (height[low] - height[high])
        points = np.vstack([points, points[low] + share[:, None] * (points[high] - points[low])])
        height = np.concatenate([height, np.zeros(len(low))])
        taken = ready[edge_of]
        tetra, middle, pair = tetrahedra[owner[taken]], number[edge_of[taken]], pair[taken]
        halves = [np.where(tetra == pair[:, [i]], middle[:, None], tetra) for i in (0, 1)]
        tetrahedra = np.vstack([np.delete(tetrahedra, owner[taken], axis=0), *halves])
