"""From sections and mesh vertices to the smooth surface of one side."""

from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree

from robots.pose import Array
from trajectories.blade.mesh import Blade, area_weighted_normals
from trajectories.blade.sections import BladeSection
from trajectories.blade.spline import SplineSurface, clamped_knots, fit_surface, nearest_parameters

_SMOOTHING = 0.15  # smoothing length per length of a spline piece, see fit_surface
_FINEST, _GRADING, _COARSEST = 0.15e-3, 0.3, 2e-3  # m, 1, m: length of the pieces along the chord at and off an edge
_POINTS_PER_PIECE = 2.2  # section points that a piece must hold: a section crosses about two facets per mesh row
_SECTION_WEIGHT = 0.03  # of a point on a facet against a mesh vertex: facets cut the corner of a curved surface
_FARTHEST = 0.5e-3  # m: a vertex farther from the sections' surface is no part of the side
_MAX_PIECES = (28, 24)  # spline pieces along the chord and along the span


@dataclass(frozen=True)
class SideSurface:
    """One flank of the aerofoil, x(u, v): u from 0 (leading edge) to 1 (trailing edge), v span coordinate in m.

    sign: +1 where x_u x x_v looks outward, else -1. levels (m,): span coordinates at which lead, trail (m,) give the
    distance in m, along the wall, from the edge's nose to the flank's start (u = 0) and end (u = 1), and width (m,)
    the flank's length from u = 0 to u = 1. deviation (2,): typical and worst distance of mesh vertices in m.
    """

    name: str
    surface: SplineSurface
    sign: float
    levels: Array
    lead: Array
    trail: Array
    width: Array
    deviation: Array

    def normal(self, u: Array, v: Array) -> Array:
        """Outward unit normals (n, 3)."""
        n = self.sign * np.cross(self.surface(u, v, 1, 0), self.surface(u, v, 0, 1))
        return np.asarray(n / np.linalg.norm(n, axis=-1, keepdims=True))


def fit_side(
    blade: Blade, name: str, levels: Array, sections: list[BladeSection], noses: Array, flanks: Array, edge: int, lead: int
) -> SideSurface:
    """Smooth surface of the wall that runs counter-clockwise from `edge` to the other edge.

    flanks (m, 2, 2): signed distances from nose to flank [edge, (before, behind)], smooth along the span.
    """
    other = 1 - edge
    forward = edge == lead
    start = noses[:, edge] + flanks[:, edge, 1]
    stop = noses[:, other] + flanks[:, other, 0]
    stop = np.where(stop < start, stop + np.array([section.perimeter for section in sections]), stop)
    width = stop - start
    data_u, data_v, data_p = [], [], []
    for level, section, a, b in zip(levels, sections, start, stop, strict=True):
        s = np.concatenate([section.s[:-1], section.s[:-1] + section.perimeter])
        s = s[(s > a) & (s < b)]
        s = np.concatenate([[a], s, [b]])
        u = (s - a) / (b - a)
        data_u.append(u if forward else 1.0 - u)
        data_v.append(np.full(len(s), level))
        data_p.append(section.at(s))
    u, v, p = np.concatenate(data_u), np.concatenate(data_v), np.concatenate(data_p)
    lengths = (float(width.mean()), 1.0)
    knots = _knots(u, levels, lengths[0])
    weights = np.ones(len(u))
    sign = 1.0 if forward else -1.0  # counter-clockwise tangent x section normal looks out, and v grows along the latter
    surface = fit_surface(u, v, p, weights, knots, lengths, _SMOOTHING)
    vu, vv, vp = _own_vertices(blade, surface, sign, u, v, p)
    if len(vu) > 20:
        u, v, p = np.concatenate([u, vu]), np.concatenate([v, vv]), np.concatenate([p, vp])
        weights = np.concatenate([_SECTION_WEIGHT * weights, np.ones(len(vu))])
        surface = fit_surface(u, v, p, weights, knots, lengths, _SMOOTHING)
        vu, vv = nearest_parameters(surface, vp, vu, vv, 3)
        gaps = np.linalg.norm(surface(vu, vv) - vp, axis=1)
    else:
        gaps = np.linalg.norm(surface(u, v) - p, axis=1)
    before, behind = flanks[:, edge, 1], -flanks[:, other, 0]
    lead_gap, trail_gap = (before, behind) if forward else (behind, before)
    return SideSurface(name, surface, sign, levels, lead_gap, trail_gap, width, np.array([np.median(gaps), gaps.max()]))


def _knots(u: Array, levels: Array, width: float) -> tuple[Array, Array]:
    """Breaks along the chord graded towards the edges, where curvature grows, but never finer than the mesh is.

    Along the span they are even.
    """
    x = np.linspace(0.0, 1.0, 2001)
    to_edge = np.minimum(x, 1.0 - x) * width
    wanted = np.clip(_FINEST + _GRADING * to_edge, _FINEST, max(_COARSEST, width / _MAX_PIECES[0]))
    density = np.histogram(u, bins=100, range=(0.0, 1.0))[0] * 100.0 / (len(levels) * width)  # points per m
    density = np.interp(x, (np.arange(100) + 0.5) / 100.0, np.convolve(np.pad(density, 1, "edge"), np.ones(3) / 3, "valid"))
    spacing = np.maximum(wanted, _POINTS_PER_PIECE / np.maximum(density, 4.0 / width))
    count = np.concatenate([[0.0], np.cumsum(0.5 * (1.0 / spacing[1:] + 1.0 / spacing[:-1]) * np.diff(x) * width)])
    pieces_u = max(int(np.round(count[-1])), 6)
    breaks_u = np.interp(np.linspace(0.0, count[-1], pieces_u + 1), count, x)
    pieces_v = int(np.clip(len(levels) / 4, 3, _MAX_PIECES[1]))
    return clamped_knots(breaks_u), clamped_knots(np.linspace(levels[0], levels[-1], pieces_v + 1))


def _own_vertices(blade: Blade, surface: SplineSurface, sign: float, u: Array, v: Array, p: Array) -> tuple[Array, Array, Array]:
    """Parameters and positions of the mesh vertices that lie on this side."""
    near = 0.02 * float(np.linalg.norm(np.ptp(p, axis=0)))
    distance, index = cKDTree(p).query(blade.vertices, distance_upper_bound=near)
    candidates = np.flatnonzero(np.isfinite(distance))
    points = blade.vertices[candidates]
    pu, pv = nearest_parameters(surface, points, u[index[candidates]], v[index[candidates]])
    gap = np.linalg.norm(surface(pu, pv) - points, axis=1)
    inside = (pu > 1e-6) & (pu < 1.0 - 1e-6) & (pv > v.min() + 1e-7) & (pv < v.max() - 1e-7)
    # The other wall of a thin edge may be as near, but it looks the other way.
    n = sign * np.cross(surface(pu, pv, 1, 0), surface(pu, pv, 0, 1))
    agree = np.einsum("ni,ni->n", n, area_weighted_normals(blade)[candidates]) > 0.5 * np.linalg.norm(n, axis=1)
    own = inside & agree & (gap < _FARTHEST)
    return pu[own], pv[own], points[own]
