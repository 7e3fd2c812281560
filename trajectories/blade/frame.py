"""The pencil of section planes that leads from the root end of the aerofoil to its tip."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from robots.pose import Array
from trajectories.blade.axis import SpanRange
from trajectories.blade.mesh import Blade, facet_normals

_CAP = 0.7  # |n . axis| above which a facet belongs to a cap or a platform
_NEAR = 0.25  # share of the aerofoil's length beyond its ends in which cap and platform are looked for
_MAX_TILT = np.deg2rad(35.0)  # an end plane tilted more against the span is not used as a section plane


@dataclass(frozen=True)
class SpanFrame:
    """Section planes (1 - w) n0 . (x - c0) + w n1 . (x - c1) = 0, w from 0 at the root end to 1 at the tip.

    Hub and casing of a turbomachine are cones, so the two ends of a real blade are not parallel; planes that turn
    from one end to the other give whole sections up to both. c0, c1 (3,) m; n0, n1 (3,) unit; v = w |c1 - c0|.
    """

    c0: Array
    c1: Array
    n0: Array
    n1: Array
    block: tuple[bool, bool]  # whether a block, platform or shroud follows at the root end, at the tip end

    @property
    def length(self) -> float:
        """Distance of the two end planes along the middle of the blade, m."""
        return float(np.linalg.norm(self.c1 - self.c0))

    @property
    def axis(self) -> Array:
        """Span axis (3,): mean of the end planes' normals, unit, towards the tip."""
        n = self.n0 + self.n1
        return np.asarray(n / np.linalg.norm(n))

    def coordinate(self, points: ArrayLike) -> Array:
        """Span coordinate v of points (..., 3), m: 0 in the root plane, `length` in the tip plane."""
        p = np.asarray(points, float)
        d0 = (p - self.c0) @ self.n0
        d1 = (p - self.c1) @ self.n1
        gap = d0 - d1
        # Far outside, beyond the line where the planes meet, v loses its meaning; it only has to stay monotone.
        return np.asarray(self.length * d0 / np.maximum(gap, 0.2 * self.length))

    def normal(self, v: ArrayLike) -> Array:
        """Unit normals (..., 3), towards the tip, of the section planes at v (...) m."""
        w = np.asarray(v, float)[..., None] / self.length
        n = (1.0 - w) * self.n0 + w * self.n1
        return np.asarray(n / np.linalg.norm(n, axis=-1, keepdims=True))


def find_frame(blade: Blade, span: SpanRange, centre_low: Array, centre_high: Array) -> SpanFrame:
    """End planes of the aerofoil, root first: the end with a block, else the one with the larger cap.

    centre_low, centre_high (3,) m: centroids of the sections at both ends of `span`.
    """
    normals, areas = facet_normals(blade.vertices, blade.faces)
    centroids = blade.vertices[blade.faces].mean(axis=1)
    low = _end_plane(normals, areas, centroids, span.axis, span.low, span.high, centre_low)
    high = _end_plane(normals, areas, centroids, -span.axis, -span.high, -span.low, centre_high)
    # Block beats free end; between two of a kind the larger face is the root.
    if (low[2], low[3]) < (high[2], high[3]):
        low, high = high, low
    towards = high[1] - low[1]
    n0, n1 = (n if n @ towards > 0 else -n for n in (low[0], high[0]))
    return SpanFrame(low[1], high[1], n0, n1, (low[2], high[2]))


def _end_plane(
    normals: Array, areas: Array, centroids: Array, inward: Array, start: float, stop: float, centre: Array
) -> tuple[Array, Array, bool, float]:
    """Normal, a point under `centre`, whether a block follows, and the face's area; `inward` points into the blade."""
    height = centroids @ inward
    beyond = (height < start + 0.02 * (stop - start)) & (height > start - _NEAR * (stop - start))
    along = normals @ inward
    platform = beyond & (along > _CAP)
    cap = beyond & (along < -_CAP)
    # A free end has a cap looking out; a block or a shroud shows a platform looking back along the aerofoil.
    block = bool(areas[platform].sum() > 0.3 * max(areas[cap].sum(), 1e-12))
    face = platform if block else cap
    area = float(areas[face].sum())
    if area <= 0.0:
        return inward, centre, False, 0.0
    normal = areas[face] @ normals[face]
    normal = np.asarray(normal / np.linalg.norm(normal)) * (1.0 if block else -1.0)
    if np.arccos(np.clip(normal @ inward, -1.0, 1.0)) > _MAX_TILT:
        normal = inward
    if block:
        return normal, centre, True, area
    middle = np.average(centroids[face], axis=0, weights=areas[face])
    return normal, centre - ((centre - middle) @ normal) / (normal @ inward) * inward, False, area
