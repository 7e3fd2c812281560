"""Give of the blade at logged contact points: finite elements at a few stations, interpolated between them."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import RBFInterpolator
from scipy.spatial import cKDTree

from ocp.contact.blade.compliance import clamped_blade, contact_components, default_element_size
from ocp.contact.blade.elasticity import Material
from ocp.contact.blade.volume_mesh import VERSION as MESH_VERSION
from ocp.contact.blade.volume_mesh import surface_area
from ocp.model.cell import Cell
from ocp.shell.cache import Entry, content_key, recall, remember
from robots.pose import Array
from trajectories.blade import Blade

VERSION = "force stations 1"  # part of the cache key: raise it when results change
SPACING = 4e-3  # m between stations; what interpolation between them misses: docs/force_registration.md
NORMAL_LENGTH = 10e-3  # m a unit vector counts for in distances: keeps the two sides of a thin blade apart
NEIGHBOURS = 16
SAME = 0.5e-3  # m; points this close are one when stations are chosen


@dataclass(frozen=True)
class Stations:
    """Contacts (k, 3) at which finite elements are solved: p m, n, t unit, blade frame; compliance tensors (k, 3, 3) m/N."""

    p: Array
    n: Array
    t: Array
    tensor: Array

    def at(self, p: Array, n: Array, t: Array) -> Array:
        """c_nn, c_nt, c_nb (m, 3) m/N, as `ocp.contact.blade.compliance.Compliance`, at contacts (m, 3) between them."""
        return contact_components(between_stations(self.p, self.n, self.tensor, p, n), n, t)


def solve_stations(cell: Cell, blade: Blade, p: Array, n: Array, t: Array, semi_axes: tuple[float, float]) -> Stations:
    """The blade's compliance at stations spread over contacts (m, 3); kept on disk.

    Raises BadInput: no mesh, a clamp that holds nothing or everything.
    """
    at = spread_stations(p, n)
    key, size = _key(cell, blade, p[at], n[at], t[at], semi_axes)

    def compute() -> Entry:
        clamp, material = _clamp_and_material(cell)
        solid = clamped_blade(blade.vertices, blade.faces, *clamp, material, size)
        return {"tensor": solid.tensor(p[at], n[at], t[at], semi_axes)}

    tensor = np.asarray(remember("force-blade", key, compute)["tensor"], float)
    return Stations(p[at], n[at], t[at], tensor)


def stations_known(cell: Cell, blade: Blade, p: Array, n: Array, t: Array, semi_axes: tuple[float, float]) -> bool:
    """Whether `solve_stations` finds its answer on disk."""
    at = spread_stations(p, n)
    return recall("force-blade", _key(cell, blade, p[at], n[at], t[at], semi_axes)[0]) is not None


def _clamp_and_material(cell: Cell) -> tuple[tuple[Array, float], Material]:
    piece = cell.workpiece
    return (piece.clamp_normal, float(piece.clamp_offset)), Material(piece.youngs_modulus, piece.poisson, piece.density)


def _key(cell: Cell, blade: Blade, p: Array, n: Array, t: Array, semi_axes: tuple[float, float]) -> tuple[str, float]:
    """Name in the cache, and element size m."""
    clamp, material = _clamp_and_material(cell)
    size = default_element_size(surface_area(blade.vertices, blade.faces), semi_axes)
    made_of = (blade.vertices, blade.faces, *clamp, material.youngs_modulus, material.poisson_ratio)
    return content_key(VERSION, MESH_VERSION, *made_of, *semi_axes, size, p, n, t), size


def spread_stations(p: Array, n: Array, spacing: float = SPACING) -> NDArray[np.int64]:
    """Indices of points at most `spacing` from every other, chosen farthest first."""
    place = np.hstack([p, NORMAL_LENGTH * n])
    _, first = np.unique(np.round(place / SAME), axis=0, return_index=True)
    first = np.sort(first)
    place = place[first]
    chosen = [0]
    distance = np.linalg.norm(place - place[0], axis=1)
    while distance.max() > 0.5 * spacing:
        chosen.append(int(np.argmax(distance)))
        distance = np.minimum(distance, np.linalg.norm(place - place[chosen[-1]], axis=1))
    return np.asarray(np.sort(first[chosen]), np.int64)


def between_stations(p: Array, n: Array, tensor: Array, p_wanted: Array, n_wanted: Array) -> Array:
    """Compliance tensors (m, 3, 3) at wanted contacts from those (k, 3, 3) at stations."""
    stations, wanted = np.hstack([p, NORMAL_LENGTH * n]), np.hstack([p_wanted, NORMAL_LENGTH * n_wanted])
    if len(p) < 3:
        return np.asarray(tensor[cKDTree(stations).query(wanted)[1]])
    near = min(NEIGHBOURS, len(p))
    # Stations along a few lines do not span space: a kernel that needs no polynomial beside it.
    smooth = RBFInterpolator(1e3 * stations, tensor.reshape(-1, 9), near, kernel="linear", degree=0)
    return np.asarray(smooth(1e3 * wanted).reshape(-1, 3, 3))
