"""How far the blade gives way under the wheel, at every waypoint of every pass.

One factorisation of the clamped solid; Hertz patches at control points along each pass; interpolation between them,
refined where a check in the middle of an interval says so. docs/blade_compliance.md has the theory and the numbers.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import Akima1DInterpolator

from ocp.contact.blade.elasticity import Material, QuadraticMesh, patch_loads, patch_weights, quadratic_mesh
from ocp.contact.blade.nested_dissection import Factorisation, factorise
from ocp.contact.blade.volume_mesh import VERSION as MESH_VERSION
from ocp.contact.blade.volume_mesh import clamp_cut, surface_area, volume_mesh
from ocp.shell.cache import Entry, content_key, recall, remember
from robots.errors import BadInput

if TYPE_CHECKING:
    from trajectories.passes import BladePath

Array = NDArray[np.float64]
Index = NDArray[np.int64]

VERSION = "blade compliance 2"  # part of the cache key: raise it when results change
FACES_WANTED = 14_000  # surface triangles a mesh may have before the default element size grows
SPACING = 8e-3  # m between the first control points of a pass; the first check halves it
FINEST = 1e-3  # m: shorter intervals are not halved
TOLERANCE = 5e-3  # relative to c_nn; an interval whose middle is off by more is halved again
RIGID = 1e-11  # m/N: less than any patch of a metal blade gives; keeps the logarithm finite inside the clamp
NEGLIGIBLE = 1e-7  # m/N: beside the 1e-5 of a rubber wheel; errors are relative to c_nn plus this


@dataclass(frozen=True)
class HeldBlade:
    """A blade in its clamp: surface `vertices` (nv, 3) m and `faces` (nf, 3) outward, blade frame; material.

    Everything with clamp_normal . x < clamp_offset (m) is held rigidly. A fixture's own spring is in series and is the caller's
    to add.
    """

    vertices: Array
    faces: Index
    clamp_normal: Array
    clamp_offset: float
    material: Material

    @property
    def content(self) -> tuple[Array | Index | float, ...]:
        """All that its stiffness depends on, for the name of what is kept."""
        stiffness = self.material.youngs_modulus, self.material.poisson_ratio
        return (self.vertices, self.faces, np.asarray(self.clamp_normal, float), float(self.clamp_offset), *stiffness)

    def element_size(self, semi_axes: tuple[float, float]) -> float:
        """Default element size in m for patches of `semi_axes` m.

        Seven tenths of the shorter semi-axis keeps the mesh error under 2 % (docs/blade_compliance.md); on large blades
        the number of elements sets the size.
        """
        area = surface_area(self.vertices, self.faces)
        return max(0.7 * min(semi_axes), (3.5 * area / FACES_WANTED) ** 0.5)


@dataclass(frozen=True)
class Compliance:
    """Compliance of the blade at the waypoints.

    Attributes:
        per_pass: one (n, 3) array a pass: c_nn, c_nt, c_nb in m/N. Under a unit force along -n (the wheel pressing),
            spread over the patch, the patch moves on the mean by c_nn >= 0 along -n, c_nt along +t and c_nb along +b.
            By reciprocity a unit force along +t moves the patch by c_nt along -n.
        interpolation_error: per pass, relative to c_nn: the largest seen in the middle of the intervals that were kept.
        control_points: patches solved for; unknowns: of the mesh.
    """

    per_pass: tuple[Array, ...]
    interpolation_error: Array
    control_points: int
    unknowns: int


@dataclass(frozen=True)
class ClampedBlade:
    """A meshed and factorised blade: ask it for the compliance at any patch."""

    mesh: QuadraticMesh
    factorisation: Factorisation
    volume_error: float

    def tensor(self, p: Array, n: Array, t: Array, semi_axes: tuple[float, float]) -> Array:
        """Compliance tensors (m, 3, 3) m/N in x, y, z: mean patch displacement under a unit force on the patch."""
        return self.factorisation.compliance(patch_loads(patch_weights(self.mesh, p, n, t, semi_axes)))

    def compliance(self, p: Array, n: Array, t: Array, semi_axes: tuple[float, float]) -> Array:
        """Compliance (m, 3) c_nn, c_nt, c_nb in m/N at contacts (m, 3) as in `Compliance`."""
        return contact_components(self.tensor(p, n, t, semi_axes), n, t)


def contact_components(tensor: Array, n: Array, t: Array) -> Array:
    """Return c_nn, c_nt, c_nb (m, 3) of tensors (m, 3, 3): displacement along -n, t, b under a unit force along -n."""
    moved = -np.einsum("kij,kj->ki", tensor, n)
    return np.stack([np.sum(moved * axis, axis=1) for axis in (-n, t, np.cross(n, t))], axis=1)


_latest: dict[str, ClampedBlade] = {}  # one at most: a factor takes 300 to 600 MB


def clamped_blade(held: HeldBlade, element_size: float) -> ClampedBlade:
    """Mesh the blade, hold it, factorise; the solid asked for last is at hand, for the next places on the same blade.

    Raises:
        BadInput: no mesh, a clamp that holds nothing or everything, or a part of the blade that is not held.
    """
    key = content_key(*held.content, element_size)
    if key not in _latest:
        _latest.clear()
        _latest[key] = _clamped(held, element_size)
    return _latest[key]


def _clamped(held: HeldBlade, element_size: float) -> ClampedBlade:
    normal, offset = np.asarray(held.clamp_normal, float) / np.linalg.norm(held.clamp_normal), float(held.clamp_offset)
    solid = volume_mesh(held.vertices, held.faces, element_size, (normal, offset))
    corners = solid.mesh.elements[:, :4]
    used = int(corners.max()) + 1
    points, tetrahedra = clamp_cut(solid.mesh.nodes[:used], corners, normal, offset)
    mesh = quadratic_mesh(points, tetrahedra)
    fixed = mesh.nodes @ normal - offset < 1e-9  # m: rounding
    try:
        factorisation = factorise(mesh, held.material, fixed)
    except np.linalg.LinAlgError:
        raise BadInput(
            "the blade's stiffness is singular, so a part of it is not joined to what the clamp holds; "
            "remove loose parts from the STL or move the clamp plane"
        ) from None
    return ClampedBlade(mesh, factorisation, solid.volume_error)


def blade_compliance(
    held: HeldBlade, passes: "Sequence[BladePath]", patch_semi_axes: tuple[float, float], element_size: float | None = None
) -> Compliance:
    """Return the blade's compliance at every waypoint of `passes`; results are kept on disk by content.

    Args:
        held: the blade in its clamp.
        passes: waypoints p, n, t and arc length s are used.
        patch_semi_axes: (a, b) m of the contact ellipse along t and b.
        element_size: m; None takes `HeldBlade.element_size`.

    Raises:
        BadInput: see `clamped_blade` and `patch_weights`.
    """
    size = element_size or held.element_size(patch_semi_axes)

    def compute() -> Entry:
        blade = clamped_blade(held, size)
        values, error, count = _along_passes(blade, passes, patch_semi_axes)
        numbers = {"count": np.array(count), "unknowns": np.array(blade.factorisation.unknowns)}
        return {"values": np.concatenate(values), "error": error, **numbers}

    entry: dict[str, Any] = {**remember("blade", _key(held, passes, patch_semi_axes, size), compute)}
    cuts = np.cumsum([len(path.p) for path in passes])[:-1]
    return Compliance(tuple(np.split(entry["values"], cuts)), entry["error"], int(entry["count"]), int(entry["unknowns"]))


def compliance_kept(held: HeldBlade, passes: "Sequence[BladePath]", patch_semi_axes: tuple[float, float]) -> bool:
    """Whether `blade_compliance` of the same arguments finds its result on disk."""
    return recall("blade", _key(held, passes, patch_semi_axes, held.element_size(patch_semi_axes))) is not None


def _key(held: HeldBlade, passes: "Sequence[BladePath]", patch_semi_axes: tuple[float, float], size: float) -> str:
    waypoints = [np.ascontiguousarray(x, float) for path in passes for x in (path.p, path.n, path.t, path.s)]
    return content_key(VERSION, MESH_VERSION, *held.content, *map(float, patch_semi_axes), size, *waypoints)


def _along_passes(
    blade: ClampedBlade, passes: "Sequence[BladePath]", semi_axes: tuple[float, float]
) -> tuple[list[Array], Array, int]:
    """Return c (n, 3) of each pass, its interpolation error, and how many patches were solved."""
    p, n, t = (np.concatenate([getattr(path, name) for path in passes]) for name in ("p", "n", "t"))

    def solve(index: Index) -> Array:
        return blade.compliance(p[index], n[index], t[index], semi_axes)

    return interpolate_passes(solve, [path.s for path in passes])


def interpolate_passes(solve: Callable[[Index], Array], arc_lengths: Sequence[Array]) -> tuple[list[Array], Array, int]:
    """Return c (n, 3) of each pass from few calls of `solve`.

    Args:
        solve: gives (m, 3) c_nn, c_nt, c_nb in m/N at m waypoints, numbered through all passes.
        arc_lengths: s (n,) m of each pass, increasing.

    Returns:
        The values, the largest relative error found at the middle of the intervals kept of each pass, and the number
        of waypoints solved.
    """
    starts = np.cumsum([0] + [len(s) for s in arc_lengths])
    known = np.full((starts[-1], 3), np.nan)
    controls = [_spread(s) for s in arc_lengths]
    fresh = np.concatenate([start + index for start, index in zip(starts, controls, strict=False)])
    known[fresh] = solve(fresh)
    open_intervals = [np.stack([index[:-1], index[1:]], axis=1) for index in controls]
    error = np.zeros(len(arc_lengths))
    while True:
        middles = [_middles(s, pairs) for s, pairs in zip(arc_lengths, open_intervals, strict=True)]
        fresh = np.concatenate([start + np.unique(m) for start, m in zip(starts, middles, strict=False)])
        if not len(fresh):
            break
        values = solve(fresh)
        guesses = known.copy()
        for i, s in enumerate(arc_lengths):
            guesses[starts[i] : starts[i + 1]] = _interpolate(s, known[starts[i] : starts[i + 1]])
        off = np.max(np.abs(guesses[fresh] - values), axis=1) / (values[:, 0] + NEGLIGIBLE)
        known[fresh] = values
        at_waypoint = np.zeros(len(known))
        at_waypoint[fresh] = off
        for i, s in enumerate(arc_lengths):
            pairs, middle = open_intervals[i], middles[i]
            pairs = pairs[np.diff(pairs, axis=1).ravel() > 1] if len(pairs) else pairs
            bad = at_waypoint[starts[i] + middle] > TOLERANCE
            bad &= s[pairs[:, 1]] - s[pairs[:, 0]] > 2.0 * FINEST
            kept = at_waypoint[starts[i] + middle[~bad]]
            error[i] = max(error[i], kept.max(initial=0.0))
            open_intervals[i] = np.concatenate(
                [np.stack([pairs[bad, 0], middle[bad]], 1), np.stack([middle[bad], pairs[bad, 1]], 1)]
            )
    count = int(np.count_nonzero(~np.isnan(known[:, 0])))
    filled = [_interpolate(s, known[starts[i] : starts[i + 1]]) for i, s in enumerate(arc_lengths)]
    return filled, error, count


def _spread(s: Array) -> Index:
    """Return waypoints about SPACING apart, both ends among them and one close to each end."""
    length = s[-1] - s[0]
    wished = np.linspace(0.0, length, int(np.ceil(length / SPACING)) + 1)
    wished = np.concatenate([wished, [0.25 * SPACING, length - 0.25 * SPACING]]) + s[0]
    index = np.clip(np.searchsorted(s, wished - 1e-12), 0, len(s) - 1)
    return np.unique(np.concatenate([index, [0, len(s) - 1]]))


def _middles(s: Array, pairs: Index) -> Index:
    """Return the waypoint nearest to the middle of each interval that has one inside."""
    if not len(pairs):
        return np.empty(0, np.int64)
    pairs = pairs[np.diff(pairs, axis=1).ravel() > 1]
    middle = np.searchsorted(s, 0.5 * (s[pairs[:, 0]] + s[pairs[:, 1]]))
    return np.clip(middle, pairs[:, 0] + 1, pairs[:, 1] - 1)


def _interpolate(s: Array, known: Array) -> Array:
    """Fill the rows of `known` (n, 3) that are nan; rows that are not stay as they are."""
    at = np.flatnonzero(~np.isnan(known[:, 0]))
    if len(at) == len(s):
        return known
    stiffened = known[at, 0] + RIGID
    table = np.column_stack([np.log(stiffened), known[at, 1:] / stiffened[:, None]])
    if len(at) > 2:
        table = Akima1DInterpolator(s[at], table, method="makima")(s)
    else:
        table = np.stack([np.interp(s, s[at], column) for column in table.T], axis=1)
    filled = np.exp(table[:, :1]) * np.column_stack([np.ones(len(s)), table[:, 1:]])
    filled[:, 0] = np.maximum(filled[:, 0] - RIGID, 0.0)
    filled[at] = known[at]
    return filled
