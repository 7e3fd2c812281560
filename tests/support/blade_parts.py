"""Thirty odd blades with a known aerofoil: lofts on roots of many kinds, under shrouds and pins, with slots and holes.

The aerofoil is a grid of points on a formula, as fine as wanted, its span along z from 0 to `length` mm. What follows at
its ends is modelled with netgen's OpenCASCADE round a stub of the same outline and triangulated there, as a CAD program
writes it; the stub's walls are taken away and grid and rest meet in the outline's points. Holes, slots and windows are cells of
the grid joined through the blade. Last the part is turned and moved, and written in mm or m; chance comes from the seed.
"""

import re
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from netgen.occ import Axis, Box, Cylinder, Face, Pnt, Prism, Segment, Vec, Wire, X, Z
from numpy.typing import NDArray
from scipy.spatial import cKDTree
from scipy.spatial.transform import Rotation

from robots.errors import BadInput
from tests.support.blade_samples import write_stl
from trajectories.blade import find_shape, read_blade
from trajectories.passes import PassOptions, passes

Array = NDArray[np.float64]
IntArray = NDArray[np.int64]
GRIDS = ((48, 14), (96, 48), (200, 120), (320, 260))  # points round a section (even), sections, by fineness
CONE = 0.25  # slope of a conical platform and shroud along x


@dataclass(frozen=True)
class Recipe:
    """One part, mm and deg. `refused`: what a refusal must say, None where the aerofoil must be found.

    edge: thickness of both edges; lean: shift of the tip across the span; stagger: angle of the root; wave: height of three
    waves in the stacking line; fillet: radius at root and shroud; fine: which of GRIDS.
    """

    seed: int
    length: float
    chord: float
    thick: float
    twist: float
    edge: float
    root: str = "none"
    depth: float = 0.0
    tip: str = "cap"
    cuts: str = "none"
    camber: float = 0.06
    taper: float = 0.2
    lean: float = 0.0
    wave: float = 0.0
    fillet: float = 0.0
    stagger: float = 0.0
    fine: int = 1
    unit: str = "mm"
    refused: str | None = None


# fmt: off
RECIPES = (
    Recipe(1, 110, 50, 0.10, 25, 0.6, "block", 30),
    Recipe(2, 45, 32, 0.14, 20, 0.8, "slotted disk", 46, "pin", unit="m", fillet=1.0, stagger=35),
    Recipe(3, 80, 40, 0.12, 30, 0.5, "dovetail", 20),
    Recipe(4, 120, 45, 0.12, 35, 0.6, "fir tree", 45, "shroud", fillet=2.0),
    Recipe(5, 20, 16, 0.12, 10, 0.3, "block", 12),
    Recipe(6, 400, 110, 0.08, 60, 1.0, "fir tree", 90),
    Recipe(7, 60, 40, 0.16, 0, 1.5, "wide block", 70),
    Recipe(8, 150, 60, 0.08, 45, 0.3, "dovetail", 40, "pin", unit="m", fine=2),
    Recipe(9, 70, 35, 0.18, 15, 2.0, "fir tree", 60, "shroud", camber=0.15, fillet=2.0),
    Recipe(10, 90, 40, 0.10, 40, 0.4, "slotted disk", 60, "shroud", unit="m", stagger=50),
    Recipe(11, 35, 30, 0.10, 20, 0.2, "platform", 25, fine=2),
    Recipe(12, 200, 60, 0.09, 50, 0.7, "fir tree", 60, lean=15, stagger=15),
    Recipe(13, 100, 45, 0.12, 30, 0.5, "none", 0, wave=1.0, fine=2),
    Recipe(14, 100, 45, 0.12, 30, 0.5, "block", 40, wave=1.5, fillet=3.0),
    Recipe(15, 65, 40, 0.15, 20, 1.6, "fir tree", 45, "shroud", "trailing slots", camber=0.12),
    Recipe(16, 75, 45, 0.16, 15, 1.2, "fir tree", 50, "cap", "film holes", camber=0.1),
    Recipe(17, 80, 42, 0.12, 25, 0.6, "block", 25, "cap", "wire hole"),
    Recipe(18, 60, 40, 0.20, 10, 1.5, "dovetail", 30, "cap", "cavity", camber=0.08),
    Recipe(19, 130, 50, 0.10, 35, 0.5, "skewed block", 60, "fins", fillet=2.0),
    Recipe(20, 50, 45, 0.10, 40, 0.5, "slotted disk", 50, "cap", unit="m"),
    Recipe(21, 90, 40, 0.10, 60, 0.4, "dovetail", 25, "shroud", fine=0),
    Recipe(22, 90, 40, 0.12, 20, 0.8, "fir tree", 40, "pin", fine=0, unit="m"),
    Recipe(23, 60, 30, 0.12, 20, 0.5, "platform", 60, "shroud", fine=3),
    Recipe(24, 250, 70, 0.09, 55, 1.0, "wide block", 30, "shroud", lean=10),
    Recipe(25, 180, 50, 0.10, 40, 0.6, "none", 0, "pin", "clapper"),
    Recipe(26, 25, 20, 0.14, 15, 0.4, "slotted disk", 30, "pin", unit="m", stagger=-30),
    Recipe(27, 40, 36, 0.12, 20, 0.6, "conical platform", 20, "conical shroud"),
    Recipe(28, 60, 34, 0.12, 20, 0.6, "block", 20, "cap", "window", refused="several outlines"),
    Recipe(29, 60, 34, 0.12, 20, 0.6, "wide block", 25, "shroud", "doublet", refused="several outlines"),
    Recipe(30, 60, 34, 0.12, 20, 0.6, "fir tree", 60, "cap", "no aerofoil", refused="steps, necks or hooks"),
)
# fmt: on


@dataclass(frozen=True)
class BladePart:
    """vertices (nv, 3) in the file's unit, faces (nf, 3); turn (3, 3), shift (3,) mm: where it was put in its file.

    low, high: heights above the aerofoil's foot, mm, between which it is free of fillets and lumps.
    """

    recipe: Recipe
    vertices: Array
    faces: IntArray
    turn: Array
    shift: Array
    low: float
    high: float

    @property
    def axis(self) -> Array:
        """Direction of the span (3,) in the file, root to tip."""
        return self.turn[:, 2]

    def back(self, points: Array) -> Array:
        """Points (m, 3) m of the file in the frame it was built in, mm."""
        return np.asarray((1e3 * points - self.shift) @ self.turn)

    def write(self, folder: Path) -> Path:
        """The part as a binary STL."""
        return write_stl(folder / f"part_{self.recipe.seed:02d}.stl", self.vertices, self.faces, 1.0)


def build(recipe: Recipe) -> BladePart:
    """The part of a recipe, meshed, turned and moved."""
    vertices, faces = _mesh(recipe)
    rng = np.random.default_rng(recipe.seed)
    turn, shift = Rotation.random(rng=rng).as_matrix(), rng.uniform(-200.0, 200.0, 3)
    low = recipe.fillet if recipe.root != "none" else 0.0
    high = recipe.length - (recipe.fillet if "shroud" in recipe.tip else 0.0)
    if recipe.cuts == "clapper":
        high = 0.7 * recipe.length - 6.0
    size = 1e-3 if recipe.unit == "m" else 1.0
    return BladePart(recipe, size * (vertices @ turn.T + shift), faces, turn, shift, low, high)


@dataclass(frozen=True)
class Outcome:
    """What became of a part: `refusal` says why there are no passes; else, in deg and mm, what was found against what was built.

    angle: of the span; low, high: ends of the range, positive where it reaches too far; off (2,): 95 % and worst distance of
    the passes' points from the formula; outside: points of passes off the free aerofoil; lines, notices: of the passes.
    """

    refusal: str = ""
    angle: float = 0.0
    low: float = 0.0
    high: float = 0.0
    off: tuple[float, float] = (0.0, 0.0)
    outside: int = 0
    lines: int = 0
    notices: tuple[str, ...] = ()

    def wrong(self, recipe: Recipe) -> str:
        """What is not as it was built, or ""."""
        if recipe.refused is not None:
            return "" if re.search(recipe.refused, self.refusal) else f"refused for {recipe.refused} expected"
        if self.refusal:
            return "refused"
        cone = "conical" in recipe.root + recipe.tip  # end planes lean by 14 deg, and the span with them
        reach = max(1.0, 0.03 * recipe.length) + (0.3 * recipe.chord * CONE if cone else 0.0)
        checks = {
            "span": self.angle < (16.0 if cone else 3.0),
            "from": -reach < self.low < 0.3 + 0.1 * recipe.fillet + (reach if cone else 0.0),
            "to": -reach < self.high < 0.3 + 0.1 * recipe.fillet + (reach if cone else 0.0),
            "surface": self.off[0] < (0.1 if recipe.fine == 0 else 0.02),
            "region": not self.outside,
        }
        return ", ".join(name for name, right in checks.items() if not right)


def outcome(part: BladePart, stl: Path) -> Outcome:
    """Read the part's file, find its aerofoil, lay passes and compare them with what was built."""
    recipe = part.recipe
    floor = -0.3 * recipe.depth if recipe.root != "none" else 0.05 * recipe.length
    try:
        blade = read_blade(stl, recipe.unit)
        shape = find_shape(blade)
        options = PassOptions(
            clamp_normal=tuple(part.axis),
            clamp_offset=1e-3 * float(part.axis @ part.shift + floor),
            spacing=1e-3 * recipe.chord / 5.0,
            root_margin=1e-3 * 0.04 * recipe.length,
            tip_margin=1e-3 * 0.04 * recipe.length,
            edge_margin=1e-3 * 0.08 * recipe.chord,
            step=1e-3 * recipe.length / 60.0,
        )
        paths, notices = passes(blade, shape, options)
    except BadInput as error:
        return Outcome(refusal=str(error))
    angle = float(np.rad2deg(np.arccos(min(1.0, abs(float(shape.frame.axis @ part.axis))))))
    ends = [
        np.mean([part.back(side.surface([0.3, 0.5, 0.7], 3 * [v]))[:, 2].mean() for side in shape.sides.values()])
        for v in shape.v
    ]
    points = part.back(np.concatenate([path.p for path in paths]))
    off = np.array([np.abs(_off_outline(section(recipe, float(p[2]), 1600)[:, :2], p[:2])) for p in points])
    beyond = np.maximum(part.low - points[:, 2], points[:, 2] - part.high)
    beyond -= CONE * np.abs(points[:, 0]) if "conical" in recipe.root + recipe.tip else 0.0
    outside = int((beyond > 0.5).sum())
    return Outcome(
        "",
        angle,
        part.low - float(min(ends)),
        float(max(ends)) - part.high,
        (float(np.quantile(off, 0.95)), float(off.max())),
        outside,
        len(paths),
        (*blade.notices, *shape.notices, *notices),
    )


def _off_outline(outline: Array, p: Array) -> float:
    """Distance of a point (2,) from a closed polygon (n, 2)."""
    k = int(np.argmin(np.linalg.norm(outline - p, axis=1)))
    best = np.inf
    for a, b in ((outline[k - 1], outline[k]), (outline[k], outline[(k + 1) % len(outline)])):
        d = b - a
        best = min(best, float(np.linalg.norm(a + np.clip((p - a) @ d / (d @ d), 0.0, 1.0) * d - p)))
    return best


def section(recipe: Recipe, z: float, n: int = 96, only: int | None = None) -> Array:
    """Outline (n, 3) of the aerofoil at z, counter-clockwise from the trailing edge, fillets included; or one point of it."""
    # A point needs its two neighbours for the way outward.
    phi = 2.0 * np.pi * (np.arange(n) if only is None else (only + np.array([-1, 0, 1])) % n) / n
    x = 0.5 + 0.5 * np.cos(phi)
    w = z / recipe.length
    chord = recipe.chord * (1.0 - recipe.taper * w)
    thick = recipe.thick * (1.0 - 0.4 * recipe.taper * w) * chord
    edge = min(recipe.edge, 0.7 * thick)
    # A NACA 00xx thickness law between two round ends of the edges' thickness.
    law = 5.0 * (0.2969 * np.sqrt(x) - 0.126 * x - 0.3516 * x**2 + 0.2843 * x**3 - 0.1036 * x**4)
    ends = np.sqrt(np.clip(1.0 - (np.clip(np.abs(x - 0.5) - 0.5 + edge / 2 / chord, 0, None) / (edge / 2 / chord)) ** 2, 0, 1))
    half = np.sign(np.sin(phi)) * (law * (thick - edge) + 0.5 * edge * ends)
    half[np.abs(np.sin(phi)) < 1e-12] = 0.0
    y = half + 4.0 * recipe.camber * chord * x * (1.0 - x)
    p = np.column_stack([chord * (x - 0.45), y - 2.0 * recipe.camber * chord / 3.0])
    p = p + _flare(recipe, z) * _outward(p)
    a = np.deg2rad(recipe.twist) * (w - 0.3)
    p = p @ np.array([[np.cos(a), np.sin(a)], [-np.sin(a), np.cos(a)]])
    p = p + [0.3 * recipe.lean * w, recipe.lean * w + recipe.wave * np.sin(6.0 * np.pi * w)]
    if recipe.cuts == "clapper":
        p[:, 1] += 3.0 * np.sign(np.sin(phi)) * np.exp(-(((z - 0.7 * recipe.length) / 4.0) ** 2) - ((x - 0.5) / 0.15) ** 2)
    out = np.column_stack([p, np.full(len(p), z)])
    return out if only is None else out[1]


def _flare(recipe: Recipe, z: float) -> float:
    """How far a fillet stands out of the wall at z, mm."""
    r, out = recipe.fillet, 0.0
    if r > 0.0 and recipe.root != "none" and z < r:
        out += r - np.sqrt(max(r**2 - (r - z) ** 2, 0.0))
    if r > 0.0 and "shroud" in recipe.tip and z > recipe.length - r:
        out += r - np.sqrt(max(r**2 - (r - (recipe.length - z)) ** 2, 0.0))
    return out


def _outward(p: Array) -> Array:
    d = np.roll(p, -1, axis=0) - np.roll(p, 1, axis=0)
    n = np.column_stack([d[:, 1], -d[:, 0]])
    return n / np.linalg.norm(n, axis=1, keepdims=True)


def _mesh(recipe: Recipe) -> tuple[Array, IntArray]:
    """Vertices (nv, 3) mm and faces (nf, 3) of the part, closed and outward, before it is turned."""
    if recipe.cuts == "no aerofoil":
        return _joined([_facets(_root(recipe))])
    n, rows = GRIDS[recipe.fine]
    rings = _rings(recipe, n, rows)
    parts = [_wall(recipe, rings)]
    inner = _cavity(recipe, rings) if recipe.cuts == "cavity" else None
    if inner is not None:
        parts += [_quads(inner)[:, ::-1], _fan(inner[-1])[:, ::-1]]
    twin = np.array([0.0, 0.75 * recipe.chord, 0.0])
    both = [rings, rings + twin] if recipe.cuts == "doublet" else [rings]
    if len(both) > 1:
        parts.append(_quads(both[1]))
    parts.append(_beyond(recipe, [ring[0] for ring in both], -1.0, _root, None if inner is None else inner[0]))
    parts.append(_beyond(recipe, [ring[-1] for ring in both], 1.0, _tip, None))
    return _joined(parts)


def _joined(parts: list[Array]) -> tuple[Array, IntArray]:
    """Shared vertices and faces of facets' corners (n, 3, 3); corners within 1e-4 mm are one."""
    corners = np.concatenate(parts).reshape(-1, 3)
    first = np.array([min(near) for near in cKDTree(corners).query_ball_point(corners, 1e-4)])
    vertices, faces = np.unique(first, return_inverse=True)
    faces = faces.reshape(-1, 3)
    sound = (faces[:, 0] != faces[:, 1]) & (faces[:, 1] != faces[:, 2]) & (faces[:, 2] != faces[:, 0])
    return corners[vertices], np.asarray(faces[sound], np.int64)


def _rings(recipe: Recipe, n: int, rows: int) -> Array:
    """The aerofoil's grid (rows, n, 3), its first and last ring in the planes of platform and shroud."""
    r = recipe.fillet
    bends = r * np.array([0.0, 0.02, 0.06, 0.12, 0.2, 0.3, 0.45, 0.6, 0.8])
    heights = np.linspace(0.0, recipe.length, rows)
    if r > 0.0:
        inner = heights[(heights > r) & (heights < recipe.length - r)]
        ends = [recipe.length - bends[::-1]] if "shroud" in recipe.tip else [heights[heights >= recipe.length - r]]
        heights = np.concatenate([bends, [r], inner, [recipe.length - r], *ends])
        heights = np.unique(np.round(heights, 6))
    rings = np.array([section(recipe, z, n) for z in heights])
    slope = (CONE if "conical" in recipe.root else 0.0, CONE if "conical" in recipe.tip else 0.0)
    if any(slope):
        for k, z in enumerate(heights):
            w = z / recipe.length
            for _ in range(6):
                levels = z + ((1.0 - w) * slope[0] + w * slope[1]) * rings[k, :, 0]
                rings[k] = [section(recipe, float(level), n, only=i) for i, level in enumerate(levels)]
        for k, s, z in ((0, slope[0], 0.0), (-1, slope[1], recipe.length)):
            rings[k, :, 2] = z + s * rings[k, :, 0]
    return rings


def _quads(rings: Array, keep: NDArray[np.bool_] | None = None) -> Array:
    """Facets of the wall between rings (m, n, 3); keep (m - 1, n): which cells."""
    a, b = rings[:-1], np.roll(rings, -1, axis=1)[:-1]
    c, d = np.roll(rings, -1, axis=1)[1:], rings[1:]
    cells = np.stack([np.stack([a, b, c], axis=2), np.stack([a, c, d], axis=2)], axis=2)
    return cells[np.ones(a.shape[:2], bool) if keep is None else keep].reshape(-1, 3, 3)


def _fan(ring: Array) -> Array:
    """A cap on a ring, looking along +z, by strips between its two walls: point j lies opposite n - j."""
    n = len(ring)
    quads = [(j % n, (j + 1) % n, (n - j - 1) % n, (n - j) % n) for j in range(n // 2)]
    return ring[np.array([f for a, b, c, d in quads for f in ((a, b, c), (a, c, d)) if len(set(f)) == 3])]


def _wall(recipe: Recipe, rings: Array) -> Array:
    """The aerofoil's own facets, with the openings of `cuts`."""
    rows, n = rings.shape[:2]
    keep = np.ones((rows - 1, n), bool)
    more: list[Array] = []
    for k0, k1, i0, i1 in _openings(recipe, rows, n):
        across = [(-i) % n for i in range(i0, i1 + 1)]  # the points opposite i0 .. i1
        keep[k0:k1, i0:i1] = False
        keep[k0:k1, [(-i - 1) % n for i in range(i0, i1)]] = False
        here, there = rings[k0 : k1 + 1, i0 : i1 + 1], rings[k0 : k1 + 1, across]
        if i0 == 0:
            keep[k0:k1, n - 1] = False
        border = [(0, i) for i in range(i1 - i0)] + [(k, i1 - i0) for k in range(k1 - k0)]
        if i0 > 0:
            border += [(k1 - k0, i) for i in range(i1 - i0, 0, -1)] + [(k, 0) for k in range(k1 - k0, 0, -1)]
            ends = border[1:] + border[:1]
        else:  # a slot through the trailing edge: open there
            up = [(k1 - k0, i) for i in range(i1 - i0, 0, -1)]
            ends = [*border[1:], (k1 - k0, i1 - i0), *[(k1 - k0, i - 1) for i in range(i1 - i0, 0, -1)]]
            border += up
        for (k, i), (m, j) in zip(border, ends, strict=True):
            a, b, c, d = here[k, i], here[m, j], there[m, j], there[k, i]
            more += [np.array([a, b, c]), np.array([a, c, d])]
    return np.concatenate([_quads(rings, keep), *([np.array(more)] if more else [])])


def _openings(recipe: Recipe, rows: int, n: int) -> list[tuple[int, int, int, int]]:
    """First and last row, first and last point of every opening through the blade."""
    middle = n // 4
    if recipe.cuts == "trailing slots":
        return [(k, k + 2, 0, n // 10) for k in range(rows // 6, rows * 5 // 6, max(rows // 8, 4))]
    if recipe.cuts == "film holes":
        return [(k, k + 1, n // 3, n // 3 + 2) for k in range(rows // 8, rows * 9 // 10, 3)]
    if recipe.cuts == "wire hole":
        return [(rows * 6 // 10, rows * 6 // 10 + 3, middle - 2, middle + 3)]
    if recipe.cuts == "window":
        return [(rows // 16, rows - rows // 16, middle - 3, middle + 4)]
    return []


def _cavity(recipe: Recipe, rings: Array) -> Array:
    """A core inside the aerofoil (m, n, 3), up to 85 % of its length, as its walls half as thick."""
    keep = rings[: int(0.85 * len(rings))]
    n = keep.shape[1]
    opposite = keep[:, (-np.arange(n)) % n]
    half = 0.5 * (keep - opposite)
    camber = 0.5 * (keep + opposite)
    middle = camber[:, n // 4][:, None]
    core = middle + 0.45 * (camber - middle) + 0.35 * half
    return core[:, :: max(n // 48, 1)]


def _beyond(recipe: Recipe, outlines: list[Array], side: float, add: Callable[[Recipe], Any], hole: Array | None) -> Array:
    """Facets of all that follows an end of the aerofoil; side: -1 below the outline, +1 above; hole: a cavity's outline."""
    what = add(recipe)
    if what is None:
        cap = np.concatenate([_fan(outline) for outline in outlines])
        return cap if side > 0 else cap[:, ::-1]
    stub: Any = None
    for outline in outlines:
        piece = _prism(outline, -side * 0.8)
        stub = piece if stub is None else stub + piece
    solid = what + stub
    if hole is not None:
        solid = solid - _prism(hole, -2.0 * (recipe.depth + 4.0))
    facets = _facets(solid)
    x, y, z = np.concatenate(outlines).T
    plane = np.linalg.lstsq(np.column_stack([x, y, np.ones_like(x)]), z, rcond=None)[0]
    height = facets @ [-plane[0], -plane[1], 1.0] - plane[2]
    normal = np.cross(facets[:, 1] - facets[:, 0], facets[:, 2] - facets[:, 0])
    floor = (hole is not None) & (np.abs(height) < 1e-3).all(axis=1) & (normal[:, 2] < 0.0)  # over the cavity's way out
    return facets[(side * height > -1e-3).all(axis=1) & ~floor]


def _prism(outline: Array, height: float) -> Any:
    """A prism on a polygon, from the polygon to `height` mm above, and the same below when the polygon lies in a solid."""
    points = [Pnt(*map(float, p)) for p in outline]
    face = Face(Wire([Segment(points[k], points[(k + 1) % len(points)]) for k in range(len(points))]))
    return Prism(face, Vec(0.0, 0.0, height))


def _facets(solid: Any) -> Array:
    """Corners (nf, 3, 3) of OpenCASCADE's own triangulation of a solid."""
    data = solid._webgui_data()["Bezier_trig_points"]
    return np.stack([np.array(data[k], float).reshape(-1, 4)[:, :3] for k in range(3)], axis=1)


def _extruded(profile: list[tuple[float, float]], half: float) -> Any:
    """A profile (y, z) extruded along x over +- half."""
    corners = [Pnt(-half, y, z) for y, z in profile]
    return Prism(Face(Wire([Segment(a, b) for a, b in _around(corners)])), Vec(2.0 * half, 0.0, 0.0))


def _around(points: list[Any]) -> list[tuple[Any, Any]]:
    return [(points[k], points[(k + 1) % len(points)]) for k in range(len(points))]


def _mirrored(right: list[tuple[float, float]]) -> list[tuple[float, float]]:
    return right + [(-y, z) for y, z in right[::-1]]


def _root(recipe: Recipe) -> Any:
    """What stands under z = 0, turned by `stagger` against the aerofoil; None where there is nothing."""
    a = np.deg2rad(recipe.stagger)
    foot = section(recipe, 0.0)[:, :2] @ np.array([[np.cos(a), -np.sin(a)], [np.sin(a), np.cos(a)]])
    if recipe.cuts == "doublet":
        foot = np.concatenate([foot, foot + [0.0, 0.75 * recipe.chord]])
    reach, half = (float(x) + 2.0 for x in np.abs(foot).max(axis=0))
    solid = _standing_root(recipe, reach, half)
    return solid if solid is None or not a else solid.Rotate(Axis((0, 0, 0), Z), recipe.stagger)


def _standing_root(recipe: Recipe, reach: float, half: float) -> Any:
    c, D, kind = recipe.chord, recipe.depth, recipe.root
    if kind == "block":
        return Box((-reach, -half, -D), (reach, half, 0))
    if kind == "wide block":
        return Box((-1.3 * reach, -1.5 * c, -D), (1.3 * reach, 1.5 * c, 0))
    if kind == "skewed block":
        corners = [(-reach - 8, -half - 4), (reach - 4, -half - 4), (reach + 8, half + 4), (-reach + 4, half + 4)]
        return Prism(Face(Wire([Segment(Pnt(*a, -D), Pnt(*b, -D)) for a, b in _around(corners)])), Vec(0, 0, D))
    if kind == "dovetail":
        right = [(half + 1, 0.0), (half + 1, -0.15 * D), (0.7 * half, -0.3 * D), (1.6 * half, -0.8 * D), (1.6 * half, -D)]
        return _extruded(_mirrored(right), reach)
    if kind == "fir tree":
        right = [(1.4 * half, 0.0), (1.4 * half, -0.1 * D)]
        for k in range(3):
            w, top = half * (1.0 - 0.22 * k), 0.1 * D + 0.3 * D * k
            right += [(0.6 * w, -top - 0.06 * D), (0.6 * w, -top - 0.12 * D), (w, -top - 0.2 * D), (w, -top - 0.26 * D)]
        return _extruded(_mirrored([*right, (0.3 * half, -D)]), reach)
    if kind == "platform":
        block = Box((-0.6 * reach, -0.7 * half, -D), (0.6 * reach, 0.7 * half, 0))
        return Box((-1.2 * reach, -1.6 * half, -0.1 * D), (1.2 * reach, 1.6 * half, 0)) + block
    if kind == "conical platform":
        out = 1.3 * reach
        plane = [(-out, -D - CONE * out), (out, -D + CONE * out), (out, CONE * out), (-out, -CONE * out)]
        wire = Wire([Segment(Pnt(a[0], -1.5 * half, a[1]), Pnt(b[0], -1.5 * half, b[1])) for a, b in _around(plane)])
        return Prism(Face(wire), Vec(0, 3.0 * half, 0))
    if kind == "slotted disk":
        wide = max(1.4 * c, 1.2 * half)
        solid = Box((-1.1 * reach, -wide, -D), (1.1 * reach, wide, 0))
        for y in np.linspace(-0.75, 0.75, 4) * wide:
            solid = solid - Box((-2 * reach, y - 0.07 * wide, -D - 1), (2 * reach, y + 0.07 * wide, -0.25 * D))
        return solid - Cylinder(Pnt(-2.0 * reach, 0.0, -0.6 * D), X, r=0.12 * D, h=4 * reach)
    return None


def _tip(recipe: Recipe) -> Any:
    L, c = recipe.length, recipe.chord
    end = section(recipe, L)
    low, high, middle = end.min(axis=0), end.max(axis=0), end[24::48].mean(axis=0)
    if recipe.cuts == "doublet":
        high = high + [0.0, 0.75 * c, 0.0]
    if recipe.tip == "pin":
        r = 0.2 * recipe.thick * c
        return Cylinder(Pnt(float(middle[0]), float(middle[1]), L - 0.4), Z, r=r, h=4.4 + 3.0 * r)
    if recipe.tip == "shroud":
        return Box((low[0] - 3, low[1] - 5, L), (high[0] + 3, high[1] + 5, L + 0.08 * c + 1))
    if recipe.tip == "fins":
        plate = Box((low[0] - 3, low[1] - 5, L), (high[0] + 3, high[1] + 5, L + 2))
        for x in np.linspace(low[0], high[0], 3):
            plate = plate + Box((x - 0.7, low[1] - 5, L + 2), (x + 0.7, high[1] + 5, L + 7))
        return plate
    if recipe.tip == "conical shroud":
        left, right = float(low[0]) - 6, float(high[0]) + 6
        plane = [(left, L + CONE * left), (right, L + CONE * right), (right, L + 0.7 * c), (left, L + 0.4 * c)]
        wire = Wire([Segment(Pnt(a[0], low[1] - 4, a[1]), Pnt(b[0], low[1] - 4, b[1])) for a, b in _around(plane)])
        return Prism(Face(wire), Vec(0, float(high[1] - low[1]) + 8, 0))
    return None
