"""Leading edge, trailing edge and the two sides of plane sections of an aerofoil."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from trajectories.blade.slicing import Loop

Array = NDArray[np.float64]

_WINDOW = 0.06  # half window, share of the chord, over which the turn around an edge is balanced
FLANK_TURN = np.deg2rad(60.0)  # turn from the nose of an edge at which the flank begins


@dataclass(frozen=True)
class Section:
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


def make_section(loop: Loop, normal: Array, guess: Array | None = None) -> Section:
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
    nose, flank = zip(*(_balance_turn(turn, s, float(s[k]), _WINDOW * chord) for k in (i, j)), strict=True)
    return Section(points, s, normal, np.array(nose), np.array(flank))


def _in_plane(points: Array, normal: Array) -> Array:
    """Coordinates (n, 2) in the plane, right-handed about its normal."""
    e1 = np.cross(normal, np.eye(3)[np.argmin(np.abs(normal))])
    e1 /= np.linalg.norm(e1)
    return np.stack([(points - points[0]) @ e1, (points - points[0]) @ np.cross(normal, e1)], axis=1)


def _turning(d: Array, s: Array) -> tuple[Array, Array]:
    """Tangent angle as a function of arc length over three rounds: knots and unwrapped angles."""
    angle = np.unwrap(np.arctan2(d[:, 1], d[:, 0]))
    middle = 0.5 * (s[1:] + s[:-1])
    rounds = 2.0 * np.pi
    return (
        np.concatenate([middle - s[-1], middle, middle + s[-1]]),
        np.concatenate([angle - rounds, angle, angle + rounds]),
    )


def _farthest_pair(x: Array) -> tuple[int, int]:
    """Indices of the two points of a polygon that are farthest apart."""
    from scipy.spatial import ConvexHull

    hull = ConvexHull(x).vertices
    gaps = np.linalg.norm(x[hull][:, None] - x[hull][None], axis=2)
    i, j = np.unravel_index(np.argmax(gaps), gaps.shape)
    return int(hull[i]), int(hull[j])


def _balance_turn(turn: tuple[Array, Array], s: Array, start: float, window: float) -> tuple[float, tuple[float, float]]:
    """Arc length of the nose near `start`, and where the wall has turned by FLANK_TURN before and behind it.

    The nose is where the tangent stands half-way between the tangents `window` before and behind: the end of the
    camber line of a round, elliptic or square edge alike, and insensitive to a coarse mesh.
    """
    knots, angle = turn
    nose = start
    for _ in range(4):
        grid = np.linspace(nose - window, nose + window, 401)
        theta = np.interp(grid, knots, angle)
        half = 0.5 * (theta[0] + theta[-1])
        inside = np.flatnonzero((theta[:-1] <= half) & (theta[1:] > half))
        if not len(inside):
            break
        k = inside[np.argmin(np.abs(grid[inside] - nose))]
        previous, nose = nose, float(np.interp(half, theta[k : k + 2], grid[k : k + 2]))
        if abs(nose - previous) < 1e-3 * window:
            break
    grid = np.linspace(nose - 3.0 * window, nose + 3.0 * window, 1201)
    theta = np.interp(grid, knots, angle)
    at_nose = float(np.interp(nose, knots, angle))
    before = grid[(grid < nose) & (theta < at_nose - FLANK_TURN)]
    behind = grid[(grid > nose) & (theta > at_nose + FLANK_TURN)]
    return nose, (
        float(before[-1]) if len(before) else nose - window,
        float(behind[0]) if len(behind) else nose + window,
    )
