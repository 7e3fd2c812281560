"""Plane sections of a blade: level sets on its mesh, and where a section has its edges and its two sides."""

from dataclasses import dataclass

import numpy as np

from robots.pose import Array
from trajectories.blade.mesh import IntArray, directed_edges, edge_keys

# Half windows, shares of the chord, over which the turn round an edge is balanced: the first holds both corners of a
# square-cut edge, the last keeps the camber of the walls out.
_WINDOWS = (0.15, 0.10, 0.06, 0.06, 0.06)
_FLAT = 1e-6  # rad: tangents that agree to this are one flat
FLANK_TURN = np.deg2rad(60.0)  # turn from the nose of an edge at which the flank begins


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


@dataclass(frozen=True)
class BladeSection:
    """One closed section, counter-clockwise about `normal`, cut at its two edges.

    points (n + 1, 3) m with the first point repeated; s (n + 1,) m arc length along them; normal (3,), unit, root to
    tip; nose (2,) arc length of the two edges; flank (2, 2) turn-off arc lengths [edge, (before, after)] where the
    wall has turned by FLANK_TURN from the nose.
    """

    points: Array
    s: Array
    normal: Array
    nose: Array
    flank: Array

    @property
    def perimeter(self) -> float:
        """Length of the closed polygon, m."""
        return float(self.s[-1])

    def at(self, s: Array) -> Array:
        """Points (..., 3) m at arc lengths s (...), periodic."""
        wrapped = np.mod(s, self.s[-1])
        return np.stack([np.interp(wrapped, self.s, self.points[:, i]) for i in range(3)], axis=-1)


def make_section(loop: Loop, normal: Array, guess: Array | None = None) -> BladeSection:
    """Cut a loop at its edges: the two places where the wall turns round the ends of the camber line.

    guess (2, 3) m: where the edges of the neighbouring section lie, to keep their order.
    """
    points = np.vstack([loop.points, loop.points[:1]])
    keep = np.concatenate([[True], np.linalg.norm(np.diff(points, axis=0), axis=1) > 1e-9])
    points = points[keep]
    points[-1] = points[0]
    x = _in_plane(points, normal)
    if np.sum(x[:-1, 0] * x[1:, 1] - x[1:, 0] * x[:-1, 1]) < 0.0:
        points, x = points[::-1].copy(), x[::-1].copy()
    d = np.diff(x, axis=0)
    s = np.concatenate([[0.0], np.cumsum(np.hypot(d[:, 0], d[:, 1]))])
    turn = _turning(d, s)
    i, j = _farthest_pair(x[:-1])
    if guess is not None:
        to_first = np.linalg.norm(points[[i, j]] - guess[0], axis=1)
        i, j = (i, j) if to_first[0] < to_first[1] else (j, i)
    chord = float(np.linalg.norm(x[i] - x[j]))
    nose, flank = zip(*(_balance_turn(turn, float(s[k]), chord) for k in (i, j)), strict=True)
    return BladeSection(points, s, normal, np.array(nose), np.array(flank))


def _in_plane(points: Array, normal: Array) -> Array:
    """Coordinates (n, 2) in the plane, right-handed about its normal."""
    e1 = np.cross(normal, np.eye(3)[np.argmin(np.abs(normal))])
    e1 /= np.linalg.norm(e1)
    return np.stack([(points - points[0]) @ e1, (points - points[0]) @ np.cross(normal, e1)], axis=1)


def _turning(d: Array, s: Array) -> tuple[Array, Array]:
    """Tangent angle as a function of arc length over three rounds: knots and unwrapped angles."""
    angle = np.repeat(np.unwrap(np.arctan2(d[:, 1], d[:, 0])), 2)
    length = np.diff(s)
    # The turn at a corner is spread evenly to both sides, over half of the shorter segment but not over a whole flat.
    spread = np.minimum(0.5 * np.minimum(length, np.roll(length, 1)), 2.5e-3 * s[-1])
    knots = np.stack([s[:-1] + spread, s[1:] - np.roll(spread, -1)], axis=1).ravel()
    rounds = 2.0 * np.pi
    return (np.concatenate([knots - s[-1], knots, knots + s[-1]]), np.concatenate([angle - rounds, angle, angle + rounds]))


def _farthest_pair(x: Array) -> tuple[int, int]:
    """Indices of the two points of a polygon that are farthest apart."""
    from scipy.spatial import ConvexHull

    hull = ConvexHull(x).vertices
    gaps = np.linalg.norm(x[hull][:, None] - x[hull][None], axis=2)
    i, j = np.unravel_index(np.argmax(gaps), gaps.shape)
    return int(hull[i]), int(hull[j])


def _balance_turn(turn: tuple[Array, Array], start: float, chord: float) -> tuple[float, tuple[float, float]]:
    """Arc length of the nose near `start`, and where the wall has turned by FLANK_TURN before and behind it.

    The nose is where the tangent stands half-way between the tangents a window before and behind: the end of the
    camber line of a round, elliptic or square edge alike, and insensitive to a coarse mesh.
    """
    knots, angle = turn
    nose = start
    for share in _WINDOWS:
        window = share * chord
        grid = np.linspace(nose - window, nose + window, 401)
        theta = np.interp(grid, knots, angle)
        half = 0.5 * (theta[0] + theta[-1])
        # On a flat cut the half-way angle holds over a stretch; its middle is meant.
        first = int(np.argmax(theta >= half - _FLAT))
        last = len(theta) - 1 - int(np.argmax(theta[::-1] <= half + _FLAT))
        if last <= first:
            first, last = max(first - 1, 0), first
            nose = float(np.interp(half, theta[first : last + 1], grid[first : last + 1]))
        else:
            nose = 0.5 * float(grid[first] + grid[last])
    grid = np.linspace(nose - 3.0 * window, nose + 3.0 * window, 1201)
    theta = np.interp(grid, knots, angle)
    at_nose = float(np.interp(nose, knots, angle))
    before = grid[(grid < nose) & (theta < at_nose - FLANK_TURN)]
    behind = grid[(grid > nose) & (theta > at_nose + FLANK_TURN)]
    return nose, (float(before[-1]) if len(before) else nose - window, float(behind[0]) if len(behind) else nose + window)
