"""Where the blade points, and which part of its length is aerofoil: found from its plane sections.

An aerofoil is told by its sections, not by its place or share in the part: each is one slender outline, met once by every
line across it, that thins out to both of its ends and to one of them already over the last quarter of its chord. Sections
of blocks, dovetails, fir trees and plates keep their thickness up to an end, slotted roots fall into several outlines, and
sections across a wrong direction end at a cap, a platform or a shroud with its full thickness. A direction is judged by the
longest stretch of such sections that follow each other smoothly (walls parallel to the span on average: fillets, platforms
and rounded caps lean to one side all round; area on one smooth course). Holes and slots take material away over a short
way: sections through them are left out and the stretch goes on behind them. What adds material (a shroud, a platform, a
clapper) ends it.

Directions to judge are those along which much of the surface runs, whatever part of the blade it belongs to; a direction
that roots have pulled aside is found anew from the walls of its own stretch. A cell may name direction and range instead.
"""

from collections.abc import Callable
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from robots.errors import BadInput
from robots.pose import Array
from trajectories.blade.mesh import Blade, facet_normals
from trajectories.blade.sections import Loop, Slicer, level_loops, slicer

FLARE_LIMIT = 0.10  # mean slope of the wall against the span, off its middle value, that marks a fillet or a cap
SLENDER_LIMIT = 0.2  # 4 area / perimeter^2: a circle has 0.32, a square 0.25, an aerofoil half as thick as long 0.2
_ENDS, _END_LIMIT = 0.02, 0.85  # share of the chord from an end, and thickness there against the largest
_QUARTER, _QUARTER_LIMIT = 0.2, 0.93  # the same for the thinner end alone: a plate with rounded edges has 1
_ACROSS = np.array([_ENDS, 0.06, 0.12, _QUARTER, 0.26, 0.32, 0.38, 0.44])  # lines across a section, as many on the far side
_ACROSS = np.concatenate([_ACROSS, [0.5], 1.0 - _ACROSS[::-1]])
_NECK = 0.05  # share of the largest thickness by which a section may be thinner between two thicker places
_STEEPEST = 3.5  # change of thickness, as a share of the largest, over a share of the chord, off the ends: beyond is a step
_SPLIT = 1e-3  # share of the perimeter that a second outline may have
_OPENING, _LUMP = 0.02, 0.03  # area off its smooth course, as a share, that marks an opening and a lump
_JUMP = 0.4  # change of ln(area) from one section to the next that parts two stretches
_LONGEST_GAP = 0.12  # share of all slices that openings may take in one piece
_COARSE = 40  # slices to judge a candidate direction
_FEWEST = 4  # slices that make a stretch
_SHORTEST = 0.25  # length of a stretch against its chord
_PULLED = np.deg2rad(5.0)  # a stretch whose own walls point this far from its direction is looked at along theirs

THICK, BLUNT, EVEN, SPLIT, CUT, FLARE = "thick", "blunt", "even", "split", "cut", "flaring"
_WORDS = {
    THICK: "sections too thick for an aerofoil",
    BLUNT: "sections as thick at an end as in the middle",
    EVEN: "sections that thin out to neither end",
    SPLIT: "several outlines side by side",
    CUT: "outlines with steps, necks or hooks",
    FLARE: "a fillet, platform or lump",
    "": "sections like an aerofoil's",
}


@dataclass(frozen=True)
class NamedAerofoil:
    """What the cell says of the aerofoil: its span's direction (3,) and the range of axis . x in m, blade frame."""

    axis: Array
    low: float = -np.inf
    high: float = np.inf


@dataclass(frozen=True)
class SpanRange:
    """Direction of the span (3,), unit, root to tip undecided; the aerofoil's range of x . axis in m; end centroids."""

    axis: Array
    low: float
    high: float
    centre_low: Array
    centre_high: Array


@dataclass(frozen=True)
class AerofoilStretch:
    """Levels (m,) of a field in m and the outlines there, ascending; openings (k, 2): ranges left out between them."""

    levels: Array
    loops: list[Loop]
    openings: Array


@dataclass(frozen=True)
class NoAerofoil:
    """Why there is no aerofoil, as a part of a sentence."""

    why: str


@dataclass(frozen=True)
class SectionJudgement:
    """One section: mean outward slope of its wall, area m^2 of all its outlines, perimeter m, and its fault or ""."""

    slope: float
    area: float
    perimeter: float
    fault: str


def find_span(blade: Blade, named: NamedAerofoil | None = None) -> SpanRange:
    """The direction whose sections are aerofoils over the largest wall, and the stretch over which they are.

    Raises: BadInput when no direction gives such a stretch; it tells what stands where along the best one.
    """
    normals, areas = facet_normals(blade.vertices, blade.faces)
    mesh = slicer(blade.vertices, blade.faces)
    axes = _candidate_axes(blade, normals, areas) if named is None else [named.axis]
    best: tuple[float, SpanRange] | None = None
    refused: list[str] = []
    tried: list[Array] = []
    while axes:
        axis = axes.pop(0)
        tried.append(axis)
        found = aerofoil_range(mesh, normals, blade.vertices @ axis, lambda _level, a=axis: a, _COARSE, named)  # type: ignore[misc]
        if isinstance(found, NoAerofoil):
            refused.append(f"{found.why} along {_words(axis)}")
            continue
        own, slope = _own_direction(blade, normals, areas, axis, found)
        lateral = float(np.trapezoid([float(loop.lengths.sum()) for loop in found.loops], found.levels))
        score = lateral * float(np.exp(-slope / 0.15))
        if best is None or score > best[0]:
            ends = [np.average(loop.points, axis=0, weights=loop.lengths) for loop in (found.loops[0], found.loops[-1])]
            best = (score, SpanRange(axis, float(found.levels[0]), float(found.levels[-1]), ends[0], ends[1]))
        if named is None and all(abs(own @ other) < np.cos(_PULLED) for other in tried):
            axes.append(own)
    if best is None:
        raise BadInput(
            f"{blade.name}: this is no blade: {refused[0]}; hand in one aerofoil with or without root, or name it in the cell "
            f"([workpiece] aerofoil_axis, aerofoil_from_mm, aerofoil_to_mm)."
        )
    return best[1]


def _words(axis: Array) -> str:
    return "[" + ", ".join(f"{value:.2f}" for value in axis) + "]"


def _candidate_axes(blade: Blade, normals: Array, areas: Array) -> list[Array]:
    """Distinct directions to which the walls are nearly parallel, best first.

    A minimum of sum A_i (n_i . a)^2 over the facets that are walls for `a` (|n . a| < 1/2: caps, platform and block
    faces drop out), found by repeated eigenvectors from several starts.
    """
    centred = blade.vertices - blade.vertices.mean(axis=0)
    starts = [*np.linalg.eigh(centred.T @ centred)[1].T, *np.linalg.eigh((normals.T * areas) @ normals)[1].T]
    # Starts all round find the walls of an aerofoil that is a small part of the whole; facets of a kind count together.
    kinds, which = np.unique(np.round(20.0 * normals), axis=0, return_inverse=True)
    weights = np.asarray(np.bincount(which.ravel(), areas), np.float64)
    kinds = np.asarray(kinds / np.maximum(np.linalg.norm(kinds, axis=1, keepdims=True), 1e-9), np.float64)
    starts += [axis for axis in (_along_walls(start, kinds, weights) for start in _HALF_SPHERE) if axis is not None]
    found: list[tuple[Array, float]] = []
    for start in starts:
        if any(abs(start @ other) > 0.9999 for other, _ in found):
            continue
        axis = _along_walls(start, normals, areas)
        if axis is None or any(abs(axis @ other) >= 0.99 for other, _ in found):
            continue
        wall = np.abs(normals @ axis) < 0.5
        found.append((axis, float(np.sqrt(np.average((normals[wall] @ axis) ** 2, weights=areas[wall])))))
    return [axis for axis, _ in sorted(found, key=lambda item: item[1])]


def _along_walls(axis: Array, normals: Array, areas: Array) -> Array | None:
    """The direction near `axis` that the facets standing along it are most parallel to; None where hardly any do."""
    for _ in range(30):
        wall = np.abs(normals @ axis) < 0.5
        if areas[wall].sum() < 0.2 * areas.sum():
            return None
        previous = axis
        axis = np.linalg.eigh((normals[wall].T * areas[wall]) @ normals[wall])[1][:, 0]
        if abs(axis @ previous) > 1.0 - 1e-14:
            break
    return axis


def _spiral(n: int) -> Array:
    """Directions (n, 3) spread evenly over half a sphere."""
    z = (np.arange(n) + 0.5) / n
    angle = np.pi * (1.0 + np.sqrt(5.0)) * np.arange(n)
    r = np.sqrt(1.0 - z**2)
    return np.column_stack([r * np.cos(angle), r * np.sin(angle), z])


_HALF_SPHERE = _spiral(40)


def _own_direction(blade: Blade, normals: Array, areas: Array, axis: Array, found: AerofoilStretch) -> tuple[Array, float]:
    """The direction that the walls of a stretch itself run along, and their rms slope against `axis`."""
    height = blade.vertices[blade.faces].mean(axis=1) @ axis
    mine = (height > found.levels[0]) & (height < found.levels[-1]) & (np.abs(normals @ axis) < 0.7)
    if mine.sum() < 8:
        return axis, 1.0
    own = np.linalg.eigh((normals[mine].T * areas[mine]) @ normals[mine])[1][:, 0]
    return own, float(np.sqrt(np.average((normals[mine] @ axis) ** 2, weights=areas[mine])))


def aerofoil_range(
    mesh: Slicer,
    normals: Array,
    field: Array,
    direction: Callable[[float], Array],
    n_slices: int,
    named: NamedAerofoil | None = None,
    near: tuple[float, float] | None = None,
) -> AerofoilStretch | NoAerofoil:
    """The longest stretch of `field` (nv,) m that is aerofoil, from `n_slices` sections over the whole of it.

    direction(level) is the unit normal (3,) of the section plane there. named: only what lies in its range counts, and a
    section with round ends need not thin out to them. near: of several stretches the one that shares most with this range.
    """
    bottom, top = float(field.min()), float(field.max())
    step = (top - bottom) / n_slices
    levels = np.asarray(bottom + (np.arange(n_slices) + 0.5) * step, np.float64)
    sections = [level_loops(mesh, field, float(level)) for level in levels]
    judged = [judge_section(loops, normals, direction(float(z))) for loops, z in zip(sections, levels, strict=True)]
    fault = np.array([one.fault for one in judged], dtype=object)
    if named is not None:
        fault[fault == EVEN] = ""
    slope = np.array([one.slope for one in judged])
    area = np.array([one.area for one in judged])
    asked = np.ones(n_slices, bool)
    if named is not None:
        middles = [float(np.mean(loops[0].points, axis=0) @ named.axis) if loops else np.nan for loops in sections]
        asked = (np.array(middles) > named.low) & (np.array(middles) < named.high)
    good = (fault == "") & asked
    if good.any():
        flares = good & (np.abs(slope - float(np.median(slope[good]))) >= FLARE_LIMIT)
        fault[flares] = FLARE
        good &= ~flares
    best: tuple[float, NDArray[np.int64]] | None = None
    for first, last in _joined_runs(good, area):
        rows = first + np.flatnonzero(good[first:last])
        rows = _on_course(rows, area)
        low, high = near if near is not None else (-np.inf, np.inf)
        shared = float(min(levels[rows[-1]], high) - max(levels[rows[0]], low))
        if best is None or shared > best[0]:
            best = shared, rows
    length = 0.0 if best is None else float(levels[best[1][-1]] - levels[best[1][0]]) + step
    chord = 0.0 if best is None else 0.45 * float(np.median([judged[k].perimeter for k in best[1]]))
    if best is None or len(best[1]) <= _FEWEST or length < _SHORTEST * chord:
        return NoAerofoil(_what_stands_where(levels, fault, asked, length))
    rows = best[1]
    jumps = np.flatnonzero(np.diff(rows) > 1)
    openings = np.array([[levels[rows[k]], levels[rows[k + 1]]] for k in jumps]).reshape(-1, 2)
    return AerofoilStretch(levels[rows], [sections[k][0] for k in rows], openings)


def _what_stands_where(levels: Array, fault: NDArray[np.object_], asked: NDArray[np.bool_], length: float) -> str:
    """The stretches of one kind along the part, in words."""
    whole = float(levels[-1] - levels[0]) + float(levels[1] - levels[0])
    if not asked.any():
        reach = f"{1e3 * levels[0]:.1f} to {1e3 * levels[-1]:.1f} mm"
        return f"nothing lies between aerofoil_from_mm and aerofoil_to_mm, it reaches from {reach}"
    kinds = set(fault[asked])
    if kinds == {THICK}:
        return "its sections are nowhere slender"
    if kinds <= {BLUNT, EVEN, FLARE}:
        return "its sections are as thick near their ends as in the middle, a block or a flat plate,"
    edges = [0, *(np.flatnonzero(fault[1:] != fault[:-1]) + 1), len(fault)]
    told = [
        f"{1e3 * levels[a]:.1f} to {1e3 * levels[b - 1]:.1f} mm {_WORDS[fault[a]]}"
        for a, b in pairwise(edges)
        if b - a > max(1, len(levels) // 40) and asked[a:b].any()
    ]
    more = "" if len(told) <= 6 else " .."
    return f"aerofoil sections reach over {1e3 * length:.1f} mm of its {1e3 * whole:.1f} mm ({', '.join(told[:6])}{more})"


def judge_section(loops: list[Loop], normals: Array, axis: Array) -> SectionJudgement:
    """Whether one section is an aerofoil's, and what its stretch is judged by; its outline is the longest loop."""
    if not loops:
        return SectionJudgement(0.0, 0.0, 0.0, SPLIT)
    loop = loops[0]
    lengths = loop.lengths
    rise = normals[loop.facets] @ axis
    slope = -rise / np.sqrt(np.maximum(1.0 - rise**2, 1e-4))
    perimeter = float(lengths.sum())
    signed = [_signed_area(one.points, axis) for one in loops]
    area = sum(abs(a) for a in signed if a * signed[0] > 0.0)
    # A cavity's outline runs the other way round, and what it leaves out still counts as the aerofoil's area.
    beside = sum(float(one.lengths.sum()) for one, a in zip(loops[1:], signed[1:], strict=True) if a * signed[0] > 0.0)
    fault = _shape_fault(loop, abs(signed[0]), perimeter)
    if beside >= _SPLIT * perimeter:
        fault = SPLIT
    return SectionJudgement(float(slope @ lengths / perimeter), area, perimeter, fault)


def _signed_area(points: Array, axis: Array) -> float:
    p = points - points[0]
    return float(0.5 * np.sum(np.cross(p, np.roll(p, -1, axis=0)) @ axis))


def _shape_fault(loop: Loop, area: float, perimeter: float) -> str:
    """What keeps an outline from being an aerofoil's, or ""."""
    if 4.0 * area > SLENDER_LIMIT * perimeter**2:
        return THICK
    lengths = loop.lengths[:, None]
    side = np.roll(loop.points, -1, axis=0) - loop.points
    centred = loop.points - (lengths * (loop.points + 0.5 * side)).sum(axis=0) / perimeter
    middle = centred + 0.5 * side
    main = np.linalg.eigh(middle.T @ (middle * lengths) + side.T @ (side * lengths) / 12.0)[1]
    x, y = centred @ main[:, 2], centred @ main[:, 1]
    line = x.min() + _ACROSS * np.ptp(x)
    x_next, y_next = np.roll(x, -1), np.roll(y, -1)
    crossed = (x[:, None] < line) != (x_next[:, None] < line)
    weight = (line - x[:, None]) / np.where(x_next == x, 1.0, x_next - x)[:, None]
    height = y[:, None] + weight * (y_next - y)[:, None]
    thick = np.where(crossed, height, -np.inf).max(axis=0) - np.where(crossed, height, np.inf).min(axis=0)
    thick = thick / thick.max()
    filled = np.minimum(np.maximum.accumulate(thick), np.maximum.accumulate(thick[::-1])[::-1])
    steps = np.abs(np.diff(thick) / np.diff(_ACROSS))[2:-2]
    if (crossed.sum(axis=0) > 2).sum() > 1 or (filled - thick).max() > _NECK or steps.max() > _STEEPEST:
        return CUT
    if max(thick[0], thick[-1]) > _END_LIMIT:
        return BLUNT
    return EVEN if min(thick[3], thick[-4]) > _QUARTER_LIMIT else ""


def _joined_runs(good: NDArray[np.bool_], area: Array) -> list[tuple[int, int]]:
    """First and one past the last index of stretches of True, parted where the area jumps, joined over missing material."""
    runs: list[tuple[int, int]] = []
    jump = np.abs(np.diff(np.log(np.maximum(area, 1e-12)))) > _JUMP
    pieces = [
        (first + a, first + b)
        for first, last in all_runs(good)
        for a, b in pairwise([0, *(np.flatnonzero(jump[first : last - 1]) + 1), last - first])
    ]
    for first, last in pieces:
        if runs and first > runs[-1][1]:
            gap = slice(runs[-1][1], first)
            before, behind = area[runs[-1][1] - 1], area[first]
            alike = abs(np.log(behind / before)) < 0.15
            if alike and first - runs[-1][1] <= _LONGEST_GAP * len(good) and area[gap].max() < 1.03 * max(before, behind):
                runs[-1] = runs[-1][0], last
                continue
        runs.append((first, last))
    return runs


def _on_course(rows: NDArray[np.int64], area: Array) -> NDArray[np.int64]:
    """The rows of a stretch whose area lies on one smooth course, between lumps, without openings."""
    if len(rows) < 12:
        return rows
    x = (rows - rows[0]) / (rows[-1] - rows[0]) * 2.0 - 1.0
    y = np.log(area[rows])
    weights = np.ones(len(rows))
    for _ in range(20):  # least absolute deviations: a third of the rows may lie off the course
        course = np.polynomial.Polynomial.fit(x, y, 4, w=weights)(x)
        weights = 1.0 / np.sqrt(np.maximum(np.abs(y - course), 1e-4))
    off = y - course
    typical = float(np.median(np.abs(off)))
    lump = off > max(_LUMP, 8.0 * typical)
    opening = _sharp(off, off < -max(_OPENING, 8.0 * typical))
    pieces = all_runs(~lump)
    first, last = max(pieces, key=lambda piece: piece[1] - piece[0])
    within = np.flatnonzero(~opening[first:last])
    if not len(within):
        return rows
    opening[: first + within[0]] = opening[first + within[-1] :] = False  # what tapers off at the ends is no opening
    return rows[first:last][~opening[first:last]]


def _sharp(off: Array, low: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Which of the low rows lie between steps down and up; where coarse facets sag the area goes down and up slowly."""
    sharp = np.zeros(len(low), bool)
    for first, last in all_runs(low):
        depth = float(-off[first:last].min())
        before = off[first - 1] - off[first] if first > 0 else depth
        behind = off[last] - off[last - 1] if last < len(off) else depth
        sharp[first:last] = min(before, behind) > 0.4 * depth
    return sharp


def all_runs(good: NDArray[np.bool_]) -> list[tuple[int, int]]:
    """First and one past the last index of every stretch of True."""
    edges = np.flatnonzero(np.diff(np.concatenate([[0], good.astype(int), [0]])))
    return [(int(a), int(b)) for a, b in zip(edges[::2], edges[1::2], strict=True)]


def longest_run(good: NDArray[np.bool_]) -> tuple[int, int]:
    """First and one past the last index of the longest stretch of True."""
    return max(all_runs(good), key=lambda run: run[1] - run[0], default=(0, 0))
