"""Where the blade points, and which part of its length is aerofoil: found from the facets alone."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from robots.errors import BadInput
from robots.pose import Array
from trajectories.blade.mesh import Blade, facet_normals
from trajectories.blade.sections import Loop, Slicer, level_loops, slicer

FLARE_LIMIT = 0.10  # mean slope of the wall against the span, off its middle value, that marks a fillet or a cap
THICKNESS_LIMIT = 0.5  # thickness / chord above which a section is no aerofoil
MIN_SHARE = 0.25  # aerofoil length / whole length below which the part is no blade
_COARSE = 40  # slices to judge a candidate direction


@dataclass(frozen=True)
class SpanRange:
    """Direction of the span (3,), unit, root to tip undecided; the aerofoil's range of x . axis in m; end centroids."""

    axis: Array
    low: float
    high: float
    centre_low: Array
    centre_high: Array


def find_span(blade: Blade) -> SpanRange:
    """The direction along which the walls run, and the longest stretch over which sections are aerofoils.

    Raises: BadInput when no direction gives a stretch of closed, slender, slowly changing sections.
    """
    normals, areas = facet_normals(blade.vertices, blade.faces)
    mesh = slicer(blade.vertices, blade.faces)
    best: tuple[float, SpanRange] | None = None
    reasons: list[str] = []
    for axis, slope in _candidate_axes(blade, normals, areas):
        height = blade.vertices @ axis
        found = aerofoil_range(mesh, normals, height, lambda _level, a=axis: a, _COARSE)  # type: ignore[misc]
        if isinstance(found, str):
            reasons.append(found)
            continue
        levels, loops = found
        lateral = sum(float(loop.lengths.sum()) for loop in loops) * float(levels[1] - levels[0])
        score = lateral * float(np.exp(-slope / 0.15))
        if best is None or score > best[0]:
            ends = [np.average(loop.points, axis=0, weights=loop.lengths) for loop in (loops[0], loops[-1])]
            best = (score, SpanRange(axis, float(levels[0]), float(levels[-1]), ends[0], ends[1]))
    if best is None:
        raise BadInput(f"{blade.name}: this is no blade: {reasons[0]}; hand in one aerofoil with or without root block.")
    return best[1]


def _candidate_axes(blade: Blade, normals: Array, areas: Array) -> list[tuple[Array, float]]:
    """Distinct directions to which the walls are nearly parallel, best first, each with the rms of n . axis.

    A minimum of sum A_i (n_i . a)^2 over the facets that are walls for `a` (|n . a| < 1/2: caps, platform and block
    faces drop out), found by repeated eigenvectors from several starts.
    """
    centred = blade.vertices - blade.vertices.mean(axis=0)
    starts = [*np.linalg.eigh(centred.T @ centred)[1].T, *np.linalg.eigh((normals.T * areas) @ normals)[1].T]
    found: list[tuple[Array, float]] = []
    for axis in starts:
        for _ in range(30):
            wall = np.abs(normals @ axis) < 0.5
            if areas[wall].sum() < 0.2 * areas.sum():
                break
            previous = axis
            axis = np.linalg.eigh((normals[wall].T * areas[wall]) @ normals[wall])[1][:, 0]
            if abs(axis @ previous) > 1.0 - 1e-14:
                break
        wall = np.abs(normals @ axis) < 0.5
        slope = float(np.sqrt(np.average((normals[wall] @ axis) ** 2, weights=areas[wall]))) if wall.any() else 1.0
        if all(abs(axis @ other) < 0.99 for other, _ in found):
            found.append((axis, slope))
    return sorted(found, key=lambda item: item[1])


def aerofoil_range(
    mesh: Slicer, normals: Array, field: Array, direction: Callable[[float], Array], n_slices: int
) -> tuple[Array, list[Loop]] | str:
    """Levels of `field` (nv,) m, and their sections, over the longest stretch that is aerofoil; or why there is none.

    direction(level) is the unit normal (3,) of the section plane there. A stretch consists of single slender loops
    whose walls stand, on average round the loop, parallel to the span: a fillet, a platform, a shroud, a cut or a
    rounded cap all lean to one side round the whole loop, which lean, sweep, twist and camber do not.
    """
    bottom, top = float(field.min()), float(field.max())
    step = (top - bottom) / n_slices
    levels = np.asarray(bottom + (np.arange(n_slices) + 0.5) * step, np.float64)
    sections = [level_loops(mesh, field, float(level)) for level in levels]
    measures = [_measure(loops, normals, direction(float(z))) for loops, z in zip(sections, levels, strict=True)]
    slope, thickness, single = np.array(measures).T
    good = (single > 0) & (thickness < THICKNESS_LIMIT)
    if not good.any():
        ratio = float(np.min(np.where(single > 0, thickness, np.inf)))
        return (
            f"its sections are nowhere slender (thickness/chord at least {ratio:.2f}, "
            f"an aerofoil has less than {THICKNESS_LIMIT})"
        )
    middle = float(np.median(slope[good]))
    first, last = longest_run(good & (np.abs(slope - middle) < FLARE_LIMIT))
    if (last - first) < max(MIN_SHARE * n_slices, 4):
        return f"aerofoil sections reach over {1e3 * (last - first) * step:.1f} mm of its {1e3 * (top - bottom):.1f} mm"
    return levels[first:last], [sections[k][0] for k in range(first, last)]


def _measure(loops: list[Loop], normals: Array, axis: Array) -> tuple[float, float, float]:
    """Mean outward slope of the wall, thickness / chord, and 1 where there is a single loop."""
    if not loops:
        return 0.0, 1.0, 0.0
    loop = loops[0]
    lengths = loop.lengths
    rise = normals[loop.facets] @ axis
    slope = -rise / np.sqrt(np.maximum(1.0 - rise**2, 1e-4))
    total = float(lengths.sum())
    centred = loop.points - np.average(loop.points, axis=0, weights=lengths)
    extents = np.ptp(centred @ np.linalg.eigh(centred.T @ (centred * lengths[:, None]))[1], axis=0)
    single = float(len(loops) == 1 or sum(float(other.lengths.sum()) for other in loops[1:]) < 1e-3 * total)
    return float(slope @ lengths / total), float(extents[1] / extents[2]), single


def longest_run(good: NDArray[np.bool_]) -> tuple[int, int]:
    """First and one past the last index of the longest stretch of True."""
    edges = np.flatnonzero(np.diff(np.concatenate([[0], good.astype(int), [0]])))
    if not len(edges):
        return 0, 0
    starts, ends = edges[::2], edges[1::2]
    k = int(np.argmax(ends - starts))
    return int(starts[k]), int(ends[k])
