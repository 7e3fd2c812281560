"""The gap between the wheel and the blade's real surface, where a quadratic is not enough: near edges, over a wide wheel.

The surface comes as a fine cloud of points with normals; triangles between them are laid once (`ocp.model.blade_pieces`). About a
contact they are seen in the wheel's unrolled frame (x = R times the angle, y along the axis, height over the wheel's surface);
what departs from the local quadratic is linear in each of them. Where there is no surface there is no blade.
"""

from collections.abc import Callable
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
from scipy.interpolate import PchipInterpolator
from scipy.spatial import cKDTree

from ocp.contact.wheel.signorini import LocalShape
from ocp.model.blade_pieces import Numbers, SurfacePieces, laid_pieces
from ocp.model.cell import Wheel
from robots.pose import Array, skew

REACH = 0.026  # m about the planned point; what lies farther off is left to `ocp.plan.clearance`
FACING = 0.2  # smallest cosine between a triangle's normal and the wheel for it to be touched from this side
END_ZONE = 4e-3  # m at both ends of a pass where contacts are solved more densely
FIRST = 4  # stations from one that is solved at once to the next; between them only where that is not smooth enough


@dataclass(frozen=True)
class SurfaceCloud:
    """Points (m, 3) m on the ground surface with outward normals (m, 3), blade frame."""

    points: Array
    normals: Array

    @cached_property
    def tree(self) -> cKDTree:
        """Search tree of the points."""
        return cKDTree(self.points)

    @cached_property
    def surface(self) -> SurfacePieces:
        """The triangles between the points."""
        return laid_pieces(self.tree, self.normals)

    def laid(self) -> "SurfaceCloud":
        """Itself, the triangles at hand for every process that it is given to."""
        _ = self.surface
        return self


@dataclass(frozen=True)
class Chords:
    """Where lines along x cross triangles: the number of each one's line (k,), x (k,) m of its left and of its right end, height
    (k,) m of the left end, slope (k,) of the height along x."""

    line: Numbers
    left: Array
    right: Array
    height: Array
    slope: Array


@dataclass(frozen=True)
class Departure:
    """How far the blade's surface lies over the quadratic `base` about a contact (3,) in the blade frame, at the pose (4, 4) of
    the blade; inf where no surface within REACH faces the wheel. The lines asked for last are at hand."""

    wheel: Wheel
    surface: SurfacePieces
    base: LocalShape
    T_base_blade: Array
    contact: Array
    _latest: dict[bytes, Chords] = field(default_factory=dict)

    def at(self, x: Array, y: Array) -> Array:
        """Height (n,) m over points x, y (n,) m."""
        order = np.argsort(y)
        chords = self._chords(y[order])
        place = order[chords.line]
        hit = (chords.left <= x[place]) & (x[place] < chords.right)
        return self._least(len(x), chords, np.flatnonzero(hit), place[hit], x[place[hit]])

    def on_grid(self, x: Array, y: Array) -> Array:
        """Height (m, n) m over a grid of x (n,) m, rising evenly, and y (m,) m, rising."""
        chords, step = self._chords(y), (x[-1] - x[0]) / (len(x) - 1)
        first, end = (np.clip(np.ceil((v - x[0]) / step), 0, len(x)).astype(np.int64) for v in (chords.left, chords.right))
        chord, column = ranges_joined(first, end)
        return self._least(len(y) * len(x), chords, chord, chords.line[chord] * len(x) + column, x[column]).reshape(len(y), -1)

    @staticmethod
    def _least(count: int, chords: Chords, chord: Numbers, place: Numbers, x: Array) -> Array:
        """Least heights (count,) m of chords at `place` by place, where the chords are at x; inf where there are none."""
        out = np.full(count, np.inf)
        np.minimum.at(out, place, chords.height[chord] + (x - chords.left[chord]) * chords.slope[chord])
        return out

    def _chords(self, y: Array) -> Chords:
        key = y.tobytes()
        if key not in self._latest:
            self._latest.clear()
            self._latest[key] = self._crossed(y)
        return self._latest[key]

    def _crossed(self, y: Array) -> Chords:
        """Chords of the lines at y (n,) m, rising."""
        wheel, R = self.wheel, self.T_base_blade[:3, :3]
        v = R @ self.contact + self.T_base_blade[:3, 3] - wheel.centre
        radial = v - (v @ wheel.axis) * wheel.axis
        rho = float(np.sqrt(radial @ radial))
        axis, e = wheel.axis @ R, radial @ R / rho  # in the blade's coordinates, as all from here on
        belt = skew(axis) @ e
        which = self._near(axis, e, y)
        if not len(which):
            return Chords(np.empty(0, np.int64), *np.empty((4, 0)))
        part = self.surface.joined(which)
        away = part.points - self.contact
        across = away @ axis
        above = np.searchsorted(y, across)  # lines from here on have the point below them
        rows = [above.take(c) for c in part.corners]
        first, end = np.minimum(np.minimum(*rows[:2]), rows[2]), np.maximum(np.maximum(*rows[:2]), rows[2])
        crossed = np.flatnonzero(end > first)

        along, out = away @ belt, away @ e + rho
        x, height = wheel.radius * np.arctan2(along, out), np.sqrt(along * along + out * out) - rho
        x[out < 0] = np.nan  # behind the wheel's axis
        height -= self.base.gap(x, across)
        corners = part.corners.take(crossed, axis=1)
        (ax, bx, cx), (ay, by, cy) = ([values.take(c) for c in corners] for values in (x, across))
        facing = (cx - ax) * (by - ay) - (bx - ax) * (cy - ay)
        crossed = crossed[facing > FACING * part.double_area.take(crossed)]
        triangle, line = ranges_joined(first.take(crossed), end.take(crossed))
        triangle = crossed.take(triangle)
        # One corner lies on one side of the line, two on the other.
        below = [r.take(triangle) <= line for r in rows]
        alone = np.where(below[0] == below[1], 2, np.where(below[0] == below[2], 1, 0))
        flat, at = part.corners.ravel(), y.take(line)
        one, *others = (flat.take((alone + k) % 3 * len(first) + triangle) for k in range(3))
        x1, y1, h1 = x.take(one), across.take(one), height.take(one)
        low, ends = at - y1, []
        for other in others:
            # The same bits from either end of a side: the triangles on both sides of it join without a gap.
            y2 = across.take(other)
            high, span = y2 - at, y2 - y1
            ends.append(((x1 * high + x.take(other) * low) / span, (h1 * high + height.take(other) * low) / span))
        (left, h), (right, other_h) = ends
        slope = (other_h - h) / np.where(left == right, 1.0, right - left)
        return Chords(line, np.minimum(left, right), np.maximum(left, right), np.where(right < left, other_h, h), slope)

    def _near(self, axis: Array, e: Array, y: Array) -> Numbers:
        """Pieces of the surface that may face the wheel between the outermost of the lines y."""
        surface, away = self.surface, self.surface.middle - self.contact
        across = away @ axis
        near = np.einsum("ij,ij->i", away, away) < (REACH + surface.radius) ** 2
        near &= (across + surface.radius > y[0]) & (across - surface.radius < y[-1])
        near &= -(surface.facing @ e) > np.cos(np.minimum(surface.spread + np.arccos(FACING), np.pi))
        return np.flatnonzero(near)


def ranges_joined(first: Numbers, end: Numbers) -> tuple[Numbers, Numbers]:
    """Of ranges first (k,) to end (k,) all numbers one after another, each with its range's."""
    count = end - first
    which = np.repeat(np.arange(len(count)), count)
    return which, np.arange(len(which)) + (first - np.cumsum(count) + count).take(which)


@dataclass(frozen=True)
class SurfaceShape(LocalShape):
    """A local quadratic plus the real surface's departure from it; inf where there is no surface."""

    departure: Departure | None = None

    def gap(self, x: Array, y: Array) -> Array:
        """Height of the undeformed blade over the undeformed wheel at x, y (m)."""
        quadratic = LocalShape.gap(self, x, y)
        if self.departure is None:
            return quadratic
        if x.size > 1 and x.shape == (1, x.size) and y.shape == (y.size, 1):
            return np.asarray(quadratic + self.departure.on_grid(x[0], y[:, 0]))
        x, y = np.broadcast_arrays(x, y)
        return np.asarray(quadratic + self.departure.at(x.ravel(), y.ravel()).reshape(x.shape))


def surface_shape(wheel: Wheel, cloud: SurfaceCloud, base: LocalShape, T_base_blade: Array, contact: Array) -> SurfaceShape:
    """`base` with the departure of the blade's surface from it about `contact` (3,) in the blade frame.

    T_base_blade (4, 4) is the pose at which `base` was taken; docs/architecture.md has the frame.
    """
    departure = Departure(wheel, cloud.surface, base, T_base_blade, contact)
    return SurfaceShape(
        base.kxx, base.kyy, base.kxy, base.lateral, base.tilt_x, base.tilt_y, None, base.heading, departure=departure
    )


def contact_stations(s: Array, spacing: float) -> Array:
    """Indices of those waypoints, at arc lengths s (n,) m, where the contact is to be solved directly.

    About `spacing` m apart, a third of it near the ends, where the blade's edges come under the wheel.
    """
    length = s[-1] - s[0]
    near = np.arange(0.0, END_ZONE, spacing / 3)
    wanted = np.concatenate([near, np.arange(END_ZONE, length - END_ZONE, spacing), length - near])
    return np.unique(np.abs(s[:, None] - s[0] - np.clip(wanted, 0.0, length)).argmin(axis=0))


def solved_where_needed(
    s: Array, solve: Callable[[Numbers], Array], off: Callable[[Numbers, Array, Array], Array], tolerance: float
) -> tuple[Numbers, Array]:
    """Those of the stations at s (n,) m, rising, between which cubics give what others have, and the values (k, m) there.

    solve: values (j, m) at stations (j,); off: how far (j,) those lie from values that were expected, in the unit of `tolerance`.
    A stretch between two that were solved is left alone when its middle is as expected, and those of the stretches beside it.
    """
    index = np.unique(np.append(np.arange(0, len(s), FIRST), len(s) - 1))
    values, open_ = solve(index), np.ones(len(index) - 1, bool)
    while True:
        open_ &= np.diff(index) > 1
        if not open_.any():
            return index, values
        middle = (index[:-1] + index[1:])[open_] // 2
        expected, found = PchipInterpolator(s[index], values)(s[middle]), solve(middle)
        smooth = off(middle, expected, found) <= tolerance
        halves = np.ones(len(open_), np.int64)
        halves[open_] = 2
        rough = np.zeros(len(open_) + 2, bool)
        rough[1:-1][open_] = ~smooth
        again = open_ & (rough[:-2] | rough[1:-1] | rough[2:])
        order = np.argsort(np.concatenate([index, middle]))
        index, values = np.concatenate([index, middle])[order], np.concatenate([values, found])[order]
        open_ = np.repeat(again, halves)
