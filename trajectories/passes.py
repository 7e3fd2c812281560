"""Grinding passes on the aerofoil: contact frames at even steps, with what the contact needs to know of the blade."""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from scipy.interpolate import CubicSpline, make_interp_spline

from robots.errors import BadInput
from robots.pose import Array
from trajectories.blade.fit import SideSurface
from trajectories.blade.mesh import Blade
from trajectories.blade.shape import AerofoilShape
from trajectories.blade.spline import curvature_in_frame
from trajectories.blade.surroundings import extents
from trajectories.blade.window import Margins, Window, free_stretch, ground_window, obstacles

MIN_WAYPOINTS = 20
FELT = 2.5e-3  # m to either side; a usual contact bears two thirds of its force there
MOST_LINES = 2000  # of a side: a blade of 2 m ground every millimetre
MOST_WAYPOINTS = 500_000  # of all passes: at half a millimetre 250 m; every one is a stage of a nonlinear program


@dataclass(frozen=True)
class BladePath:
    """One grinding pass in the blade frame.

    line: 1-based number of the line on the blade; side: "convex" | "concave" | "edge"; p, n, t (n, 3): contact points
    in m, outward unit normals, unit feed directions; s (n,) m arc length from the start; curvature (n, 3): k_tt, k_bb,
    k_tb in 1/m with b = n x t, positive convex, on flanks of `felt_along`; extent (n, 4): distance in m along +t, -t,
    +b, -b over which the surface goes on before it turns by more than 60 deg or ends; feed (n,) m/s and force (n,) N as
    programmed; start, rest m: how much of the line lies before this piece of it
    in its direction, and behind it, 0 of a whole line; before, after m: how much of the asked line lies before its start
    and behind its end, where the wheel has no room; room_before, room_after m: how far beyond either end the wheel may bear
    while it engages and lifts off; turn rad about the normal, signed, by which the wheel is to stand askew, 0: as it comes.
    """

    line: int
    side: str
    p: Array
    n: Array
    t: Array
    s: Array
    curvature: Array
    extent: Array
    feed: Array
    force: Array
    start: float = 0.0
    rest: float = 0.0
    before: float = 0.0
    after: float = 0.0
    room_before: float = 0.0
    room_after: float = 0.0
    turn: float = 0.0


@dataclass(frozen=True)
class ContactFrames:
    """What is given of one pass before the blade around it is looked at; fields as in `BladePath`."""

    line: int
    p: Array
    n: Array
    t: Array
    s: Array
    feed: Array
    force: Array

    def path(self, side: str, curvature: Array, extent: Array) -> BladePath:
        """The pass with what was found of the blade at its points."""
        return BladePath(side=side, curvature=curvature, extent=extent, **vars(self))


def felt_along(s: Array, curvature: Array) -> Array:
    """Curvatures (n, 3) at arc lengths s (n,) m of a flank as a wheel feels them: their mean over FELT to either side, less near
    the ends.

    On facets they jump within less than a contact's width; the indentation does not.
    """
    reach = np.minimum(FELT, np.minimum(s - s[0], s[-1] - s))[1:-1]
    integral = make_interp_spline(s, curvature, k=1).antiderivative()
    means = (integral(s[1:-1] + reach) - integral(s[1:-1] - reach)) / (2.0 * reach)[:, None]
    return np.vstack([curvature[:1], means, curvature[-1:]])


@dataclass(frozen=True)
class PassOptions:
    """What to lay where, in m, m/s and N.

    direction: "spanwise" (root to tip) or "chordwise" (leading to trailing edge); side: "convex", "concave", "both".
    spacing: largest distance of neighbouring lines, where they are farthest apart; spread: for a side by its name a smaller one
    where there is reason for it, (k,) m at shares (k,) of the way from the first line to the last. The clamp holds everything
    with clamp_normal . x below (clamp_side = "below") or above clamp_offset. step: distance of waypoints; pad_radius: waypoints
    closer than this to an end of the surface are counted in a notice.
    wheel_radius, wheel_width: when given, passes stop where that wheel, untilted, would touch block or platform.
    """

    clamp_normal: tuple[float, float, float] = (0.0, 0.0, 1.0)
    clamp_offset: float = 0.010
    clamp_side: str = "below"
    direction: str = "spanwise"
    side: str = "both"
    spacing: float = 6e-3
    root_margin: float = 5e-3
    tip_margin: float = 5e-3
    edge_margin: float = 3e-3
    spread: Mapping[str, tuple[Array, Array]] = field(default_factory=dict)
    step: float = 1e-3
    pad_radius: float = 0.0
    wheel_radius: float = 0.0
    wheel_width: float = 0.0
    feed: float = 40e-3
    force: float = 20.0


def passes(blade: Blade, shape: AerofoilShape, options: PassOptions) -> tuple[list[BladePath], list[str]]:
    """Evenly spread lines over the ground part of the chosen sides, at most `spacing` apart, and notices.

    Raises: BadInput when the clamp holds nothing or everything, or the margins leave nothing.
    """
    lay = {"spanwise": _spanwise, "chordwise": _chordwise}.get(options.direction)
    if lay is None or options.side not in ("both", *shape.sides):
        raise BadInput(
            f"passes = {options.direction!r}, side = {options.side!r}: use 'spanwise' or 'chordwise' and "
            f"'convex', 'concave' or 'both'."
        )
    if not options.spacing > 0.0 or not options.step > 0.0:
        raise BadInput(f"pass_spacing_mm = {1e3 * options.spacing:g} and step {1e3 * options.step:g} mm must be above 0.")
    paths: list[BladePath] = []
    notices: list[str] = []
    margin = min(options.root_margin, options.tip_margin) if options.direction == "spanwise" else options.edge_margin
    waypoints = 0
    around = obstacles(blade, shape) if options.wheel_radius > 0.0 else np.zeros((0, 3))
    for name, window in ground_windows(blade, shape, options).items():
        side = shape.sides[name]
        for edge, cut in zip(("leading", "trailing"), window.cut, strict=True):
            if cut:
                notices.append(
                    f"The {name} side is ground up to where it turns into the {edge} edge, which is more "
                    f"than edge_margin_mm = {1e3 * options.edge_margin:g} away from it."
                )
        lines, cuts = _with_room(side, lay(side, window, options), around, options, notices)
        waypoints += _count_waypoints(side, lines, options.step)
        if waypoints > MOST_WAYPOINTS:
            raise BadInput(
                f"pass_spacing_mm = {1e3 * options.spacing:g} and step {1e3 * options.step:g} mm make {waypoints} waypoints on "
                f"{len(paths) + len(lines)} lines, the limit is {MOST_WAYPOINTS}; lay fewer lines or take a longer step"
            )
        for (u, v), (before, after) in zip(lines, cuts, strict=True):
            path = _waypoints(shape, side, u, v, len(paths) + 1, options)
            room = [margin * (cut == 0.0) for cut in (before, after)]
            paths.append(replace(path, before=before, after=after, room_before=room[0], room_after=room[1]))
    if not paths:
        raise BadInput(
            f"{blade.name}: a wheel of {1e3 * options.wheel_radius:g} mm radius touches block or platform on "
            f"every line; take a smaller wheel or another direction of the passes."
        )
    near = sum(int((path.extent.min(axis=1) < options.pad_radius).sum()) for path in paths)
    if near:
        total = sum(len(path.p) for path in paths)
        notices.append(
            f"{near} of {total} waypoints lie closer than {1e3 * options.pad_radius:.1f} mm to an edge or end "
            f"of the surface, so part of the contact hangs over."
        )
    return paths, notices


def ground_windows(blade: Blade, shape: AerofoilShape, options: PassOptions) -> dict[str, Window]:
    """What is asked to be ground of each chosen side, by its name. Raises BadInput as `passes`."""
    margins = _margins(blade, options)
    names = ["convex", "concave"] if options.side == "both" else [options.side]
    return {name: ground_window(blade.name, shape, shape.sides[name], margins) for name in names}


def _with_room(
    side: SideSurface, lines: list[tuple[Array, Array]], around: Array, options: PassOptions, notices: list[str]
) -> tuple[list[tuple[Array, Array]], list[tuple[float, float]]]:
    """The lines, cut back to where the wheel has room beside the points `around` it must not touch, and by how much at start and
    end, m."""
    kept: list[tuple[Array, Array]] = []
    cuts: list[tuple[float, float]] = []
    for u, v in lines:
        room = free_stretch(side, around, u, v, options.wheel_radius, options.wheel_width)
        if room is None:
            continue
        ends = [side.surface([u[end], room[0][end]], [v[end], room[1][end]]) for end in (0, -1)]
        before, after = (float(np.linalg.norm(cut[1] - cut[0])) for cut in ends)
        kept.append(room)
        cuts.append((before, after))
    shorter = sum(max(cut) >= 5e-5 for cut in cuts)  # m: half of the last digit that is told
    gone = len(lines) - len(kept)
    done = [f"{shorter} were cut back, by up to {1e3 * max(max(cut) for cut in cuts):.1f} mm"] if shorter else []
    done += [f"{gone} were left out"] if gone else []
    if done:
        told = f"Of {len(lines)} passes on the {side.name} side {', and '.join(done)}"
        notices.append(f"{told}, because the wheel would touch block or platform.")
    return kept, cuts


def reversed_path(path: BladePath) -> BladePath:
    """The same pass ground from its end to its start: t and b turn round, k_tb keeps its sign."""
    ends: dict[str, Any] = {"start": path.rest, "rest": path.start, "before": path.after, "after": path.before}
    ends |= {"room_before": path.room_after, "room_after": path.room_before}
    back: dict[str, Any] = {name: getattr(path, name)[::-1] for name in ("p", "n", "curvature", "feed", "force")}
    extent = path.extent[::-1, [1, 0, 3, 2]]
    return replace(path, t=-path.t[::-1], s=path.s[-1] - path.s[::-1], extent=extent, **ends, **back)


def stretch_of(path: BladePath, first: int, last: int) -> BladePath:
    """The piece of a path from waypoint `first` to `last`, both included, as a path of its own whose s begins at 0."""
    names = ("p", "n", "t", "curvature", "extent", "feed", "force")
    cut: dict[str, Any] = {name: getattr(path, name)[first : last + 1] for name in names} | {"before": 0.0, "after": 0.0}
    cut |= {"room_before": path.room_before * (first == 0), "room_after": path.room_after * (last == len(path.s) - 1)}
    start, rest = path.start + float(path.s[first]), path.rest + float(path.s[-1] - path.s[last])
    return replace(path, s=path.s[first : last + 1] - path.s[first], start=start, rest=rest, **cut)


def _margins(blade: Blade, options: PassOptions) -> Margins:
    normal = np.asarray(options.clamp_normal, float)
    size = float(np.linalg.norm(normal))
    if not np.isfinite(size) or size < 1e-9 or options.clamp_side not in ("below", "above"):
        raise BadInput(
            f"clamp_normal = {list(options.clamp_normal)}, clamp_side = {options.clamp_side!r}: give a vector "
            f"that is not zero and 'below' or 'above'."
        )
    sign = 1.0 if options.clamp_side == "below" else -1.0
    normal, offset = sign * normal / size, sign * options.clamp_offset / size
    height = blade.vertices @ normal - offset
    if height.min() > 0.0 or height.max() <= 0.0:
        low, high = sorted(sign * 1e3 * (np.array([height.min(), height.max()]) + offset))
        what = "nothing" if height.min() > 0.0 else "everything"
        raise BadInput(
            f"{blade.name}: the clamp ({options.clamp_side} {1e3 * options.clamp_offset:g} mm along "
            f"{list(options.clamp_normal)}) holds {what}: the blade reaches from {low:.1f} to {high:.1f} mm there; "
            f"correct clamp_offset_mm (clamp_to_mm), or turn clamp_normal (clamp_side)."
        )
    return Margins(normal, offset, options.root_margin, options.tip_margin, options.edge_margin)


def _line_shares(side: str, width: float, options: PassOptions) -> Array:
    """Shares (lines,) of a width, 0 the first line and 1 the last, at which lines are laid. Raises BadInput before they are."""
    fine = np.linspace(0.0, 1.0, 1001)
    asked = options.spread.get(side, (fine, np.full(len(fine), options.spacing)))
    density = width / np.minimum(np.interp(fine, *asked), options.spacing)
    counted = np.concatenate([[0.0], np.cumsum(0.5 * (density[1:] + density[:-1]) * np.diff(fine))])
    lines = np.ceil(counted[-1] - 1e-9) + 1 if width > 0.1 * options.spacing else 1
    if lines > MOST_LINES:
        raise BadInput(
            f"pass_spacing_mm = {1e3 * options.spacing:g} makes {lines:.4g} lines on a width of {1e3 * width:.4g} mm, the limit "
            f"is {MOST_LINES}; write a larger spacing"
        )
    return np.interp(np.linspace(0.0, counted[-1], int(lines)), counted, fine) if lines > 1 else np.array([0.5])


def _count_waypoints(side: SideSurface, lines: list[tuple[Array, Array]], step: float) -> int:
    """Waypoints that lines (u, v) will have at a step, before they are laid."""
    lengths = (float(np.linalg.norm(np.diff(side.surface(u[::40], v[::40]), axis=0), axis=1).sum()) for u, v in lines)
    return int(sum(max(np.ceil(length / step) + 1, MIN_WAYPOINTS) for length in lengths))


def _spanwise(side: SideSurface, window: Window, options: PassOptions) -> list[tuple[Array, Array]]:
    """Fine polylines (u, v) from root to tip; lines follow the taper and are `spacing` apart where it is widest."""
    lowest, highest = float(np.nanmin(window.v_lo)), float(np.nanmax(window.v_hi))
    used = (window.v >= lowest) & (window.v <= highest)
    width = float((np.interp(window.v, side.levels, side.width) * (window.u_hi - window.u_lo))[used].max())
    lines = []
    for share in _line_shares(side.name, width, options):
        u = window.u_lo + share * (window.u_hi - window.u_lo)
        low, high = np.interp(u, window.u, window.v_lo), np.interp(u, window.u, window.v_hi)
        start = _first_root(window.v, window.v - low)
        stop = _first_root(window.v, window.v - high)
        v = np.linspace(start, stop, 801)
        lines.append((np.interp(v, window.v, u), v))
    return [(u[::-1], v[::-1]) for u, v in lines] if window.flip else lines


def _first_root(x: Array, y: Array) -> float:
    """Where y rises through zero, linear between grid points; an end of x where it does not."""
    k = int(np.argmax(y >= 0.0)) if (y >= 0.0).any() else len(x) - 1
    if k == 0 or y[k] < 0.0:
        return float(x[k])
    return float(x[k - 1] + (x[k] - x[k - 1]) * (-y[k - 1]) / (y[k] - y[k - 1]))


def _chordwise(side: SideSurface, window: Window, options: PassOptions) -> list[tuple[Array, Array]]:
    """Fine polylines (u, v) from leading to trailing edge, evenly spread between the limits at root and tip."""
    inside = (window.u >= window.u_lo.min()) & (window.u <= window.u_hi.max())
    u, low, high = window.u[inside], window.v_lo[inside], window.v_hi[inside]
    stretch = np.linalg.norm(side.surface(u, 0.5 * (low + high), 0, 1), axis=1)
    lines = []
    shares = _line_shares(side.name, float(((high - low) * stretch).max()), options)
    for share in 1.0 - shares if window.flip else shares:
        v = low + share * (high - low)
        start = _first_root(u, u - np.interp(v, window.v, window.u_lo))
        stop = _first_root(u, u - np.interp(v, window.v, window.u_hi))
        fine = np.linspace(start, stop, 801)
        lines.append((fine, np.interp(fine, u, v)))
    return lines


def _waypoints(shape: AerofoilShape, side: SideSurface, u: Array, v: Array, line: int, options: PassOptions) -> BladePath:
    """A pass at even steps of arc length along the fine polyline (u, v)."""
    fine = side.surface(u, v)
    s_fine = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(fine, axis=0), axis=1))])
    count = max(int(np.ceil(s_fine[-1] / options.step)) + 1, MIN_WAYPOINTS)
    s = np.linspace(0.0, s_fine[-1], count)
    u, v = np.interp(s, s_fine, u), np.interp(s, s_fine, v)
    p, n = side.surface(u, v), side.normal(u, v)
    feed, force = np.full(count, options.feed), np.full(count, options.force)
    return describe(shape, side, u, v, ContactFrames(line, p, n, feed_directions(p, n, s), s, feed, force))


def feed_directions(p: Array, n: Array, s: Array) -> Array:
    """Unit tangents (m, 3) of the curve p(s), freed of their part along n."""
    t = CubicSpline(s, p)(s, 1)
    t = t - np.einsum("ni,ni->n", t, n)[:, None] * n
    return np.asarray(t / np.linalg.norm(t, axis=1, keepdims=True))


def describe(shape: AerofoilShape, side: SideSurface, u: Array, v: Array, at: ContactFrames) -> BladePath:
    """A pass from frames at surface parameters (u, v): adds curvature and extent."""
    curvature = felt_along(at.s, curvature_in_frame(side.surface, u, v, at.n, at.t))
    extent = extents(shape, side, u, v, at.p, at.n, at.t)
    return at.path(side.name, curvature, extent)
