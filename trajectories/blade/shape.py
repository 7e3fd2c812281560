"""The aerofoil in a blade: span, the pencil of section planes from its root end to its tip, edges, and one smooth surface for
each side."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike
from scipy.interpolate import make_lsq_spline

from robots.errors import BadInput
from robots.pose import Array
from trajectories.blade.axis import NamedAerofoil, NoAerofoil, SpanRange, aerofoil_range, find_span
from trajectories.blade.fit import SideSurface, fit_side
from trajectories.blade.mesh import Blade, facet_normals
from trajectories.blade.sections import BladeSection, make_section, slicer
from trajectories.blade.spline import clamped_knots

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


N_SECTIONS = 96  # over the whole part, and as often again until half of them lie on the aerofoil
ROUGH = 20e-6  # m: a larger worst distance between smooth surface and mesh is told to the user
_PLATE = 0.97  # thickness near both edges against that at mid-chord, above which the part is a plate


@dataclass(frozen=True)
class AerofoilShape:
    """What was found in a blade's surface; blade frame, metres.

    frame: section planes from root to tip; v (2,): range of the span coordinate that is aerofoil; sides: "convex"
    and "concave"; leading, trailing (m, 3): points along the edges at `v_edges` (m,); notices: doubts in sentences.
    """

    frame: SpanFrame
    v: Array
    sides: dict[str, SideSurface]
    v_edges: Array
    leading: Array
    trailing: Array
    notices: tuple[str, ...]


KEPT = 4  # shapes of as many blades: a plan, its rehearsal and its fit in one process ask for the same
_latest: dict[tuple[object, ...], AerofoilShape] = {}


def find_shape(blade: Blade, named: NamedAerofoil | None = None) -> AerofoilShape:
    """Span axis, aerofoil range, edges, sides and smooth surfaces of a blade in any position in its file.

    named: where the cell says that the aerofoil lies. What was found in the blades asked for last is at hand.
    Raises: BadInput where the part shows no aerofoil.
    """
    key = blade.content, () if named is None else (*map(float, named.axis), named.low, named.high)
    if key not in _latest:
        found = _found_shape(blade, named)
        while len(_latest) >= KEPT:
            del _latest[next(iter(_latest))]
        _latest[key] = found
    return _latest[key]


def _found_shape(blade: Blade, named: NamedAerofoil | None) -> AerofoilShape:
    span = find_span(blade, named)
    frame = find_frame(blade, span, span.centre_low, span.centre_high)
    v_vertices = frame.coordinate(blade.vertices)
    ends = sorted(float(frame.coordinate(centre)) for centre in (span.centre_low, span.centre_high))
    dense = int(np.ceil(0.5 * float(np.ptp(v_vertices)) / (ends[1] - ends[0])))
    found = aerofoil_range(
        slicer(blade.vertices, blade.faces),
        facet_normals(blade.vertices, blade.faces)[0],
        v_vertices,
        lambda v: frame.normal(np.array(v)),
        N_SECTIONS * dense,
        named,
        (ends[0], ends[1]),
    )
    if isinstance(found, NoAerofoil):
        raise BadInput(
            f"{blade.name}: this is no blade: {found.why}, in section planes between those of the ends of what looks like an "
            f"aerofoil; hand in one aerofoil with or without root block."
        )
    levels, loops = found.levels, found.loops
    sections: list[BladeSection] = []
    guess: Array | None = None
    for level, loop in zip(levels, loops, strict=True):
        section = make_section(loop, frame.normal(np.array(level)), guess)
        guess = section.at(section.nose)
        sections.append(section)
    notices = _told_openings(found.openings, frame)
    noses = _smooth_noses(levels, sections)
    lead = _leading_edge(sections, noses, notices)
    order = [lead, 1 - lead]
    if named is None:
        _refuse_plate(blade, sections, noses)
    sides = _sides(blade, levels, sections, noses, lead, notices)
    for side in sides.values():
        if side.deviation[1] > ROUGH:
            notices.append(
                f"The smooth {side.name} surface passes mesh vertices at up to {1e6 * side.deviation[1]:.0f} um "
                f"({1e6 * side.deviation[0]:.1f} um typically): the mesh is rough or has steps there."
            )
    edges = np.array([section.at(nose) for section, nose in zip(sections, noses, strict=True)])
    return AerofoilShape(frame, levels[[0, -1]], sides, levels, edges[:, order[0]], edges[:, order[1]], tuple(notices))


def _told_openings(openings: Array, frame: SpanFrame) -> list[str]:
    """A notice where sections were left out."""
    if not len(openings):
        return []
    widest = 1e3 * float(np.diff(openings, axis=1).max())
    return [
        f"Sections at {len(openings)} places along the aerofoil, the longest {widest:.1f} mm, are broken by holes or slots, or "
        f"uneven from coarse facets: they were left out, and passes cross them as if the wall went on."
    ]


def smooth_along(levels: Array, values: Array, pieces: int = 5) -> Array:
    """Least-squares cubic spline of values (m, ...) over levels (m,), evaluated there."""
    pieces = max(1, min(pieces, len(levels) // 4))
    knots = clamped_knots(np.linspace(levels[0], levels[-1], pieces + 1))
    return np.asarray(make_lsq_spline(levels, values, knots)(levels))


def _smooth_noses(levels: Array, sections: list[BladeSection]) -> Array:
    """Arc lengths (m, 2) of both edges in every section, freed of the mesh's jitter by smoothing along the span."""
    points = np.array([section.at(section.nose) for section in sections])
    smooth = smooth_along(levels, points.reshape(len(levels), -1)).reshape(points.shape)
    noses = np.empty((len(levels), 2))
    for k, section in enumerate(sections):
        for edge in range(2):
            reach = 0.02 * section.perimeter
            s = section.nose[edge] + np.linspace(-reach, reach, 201)
            noses[k, edge] = s[np.argmin(np.linalg.norm(section.at(s) - smooth[k, edge], axis=1))]
    return noses


def _thickness_near(section: BladeSection, nose: Array, edge: int, share: float) -> float:
    """Distance of the two walls at `share` of the half perimeter behind an edge, m."""
    reach = share * 0.5 * section.perimeter
    return float(np.linalg.norm(section.at(nose[edge] + reach) - section.at(nose[edge] - reach)))


def _refuse_plate(blade: Blade, sections: list[BladeSection], noses: Array) -> None:
    """Refuse a bar of rectangular section, which slices cannot tell from an aerofoil."""
    k = len(sections) // 2
    middle = _thickness_near(sections[k], noses[k], 0, 0.5)
    ends = [_thickness_near(sections[k], noses[k], edge, 0.08) for edge in (0, 1)]
    if min(ends) > _PLATE * middle:
        raise BadInput(
            f"{blade.name}: this is no blade: its sections are as thick near both edges ({1e3 * min(ends):.2f} mm) "
            f"as in the middle ({1e3 * middle:.2f} mm), a flat plate; hand in an aerofoil."
        )


def _leading_edge(sections: list[BladeSection], noses: Array, notices: list[str]) -> int:
    """Which of the two edges is the thicker one."""
    shares, pairs = (0.03, 0.06, 0.1), list(zip(sections[::4], noses[::4], strict=True))
    near = [[np.mean([_thickness_near(*pair, edge, share) for share in shares]) for edge in (0, 1)] for pair in pairs]
    thickness = np.array(near).mean(axis=0)
    if abs(thickness[0] - thickness[1]) < 0.05 * thickness.max():
        notices.append(
            "The two edges are equally thick, so which one leads was not found out; chordwise passes may run from "
            "the trailing to the leading edge."
        )
    return int(np.argmax(thickness))


def _sides(
    blade: Blade, levels: Array, sections: list[BladeSection], noses: Array, lead: int, notices: list[str]
) -> dict[str, SideSurface]:
    """The surfaces between the edges, named by the way the section's middle bulges off its chord."""
    pairs = zip(sections, noses, strict=True)
    areas = np.array([[_bulge(section, nose, edge) for edge in (0, 1)] for section, nose in pairs]).mean(axis=0)
    names = {0: "convex", 1: "concave"} if areas[0] > areas[1] else {0: "concave", 1: "convex"}
    if abs(areas[0] - areas[1]) < 0.05 * np.abs(areas).max():
        notices.append("The sections are symmetric, so which side is called convex and which concave is arbitrary.")
    flanks = np.array([section.flank - section.nose[:, None] for section in sections])
    flanks = smooth_along(levels, flanks.reshape(len(levels), -1), 2).reshape(flanks.shape)
    return {names[edge]: fit_side(blade, names[edge], levels, sections, noses, flanks, edge, lead) for edge in (0, 1)}


def _bulge(section: BladeSection, nose: Array, edge: int) -> float:
    """Area between the chord and the wall that runs counter-clockwise from `edge` to the other edge, m^2."""
    start, stop = nose[edge], nose[1 - edge]
    s = np.linspace(start, stop + (section.perimeter if stop < start else 0.0), 201)
    p = section.at(s)
    p = p - p[0]
    return float(0.5 * np.sum(np.cross(p[:-1], p[1:]) @ section.normal))
