"""The blade under logged contact points: their place and curvature on its surface, its give there, and its real surface.

Place, frame and local curvature of every row come from the fitted surface. The compliance is solved by finite elements at a few
stations and interpolated between them, and so is the correction by which the blade's real surface differs from the quadratic of
the wheel law (direct contact solutions).
"""

from dataclasses import asdict, dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import RBFInterpolator
from scipy.spatial import cKDTree

from ocp.calibrate.force.log import Flags, ForceLog
from ocp.calibrate.force.model import STATE, ForceModel, ForceRows, PlacedRows
from ocp.contact.blade.compliance import HeldBlade, clamped_blade, contact_components
from ocp.contact.blade.elasticity import Material
from ocp.contact.blade.volume_mesh import VERSION as MESH_VERSION
from ocp.contact.wheel.cover import Cover
from ocp.contact.wheel.signorini import LocalShape, solve_force
from ocp.model.blade_gap import SurfaceCloud, surface_shape
from ocp.model.cell import Cell, Wheel
from ocp.model.force_balance import N_WAYPOINT
from ocp.model.theta import believed_theta
from ocp.shell.cache import Entry, content_key, recall, remember
from robots.errors import Infeasible
from robots.pose import Array
from trajectories.blade import AerofoilShape, Blade
from trajectories.blade.spline import curvature_in_frame
from trajectories.path_points import angles_to_surface, facet_curvature, feet_on_blade, refuse_metres

# A log's own points and normals are kept where they are as true as a surface fitted to facets is.
TRUSTED_GAP = 20e-6  # m
TRUSTED_ANGLE = np.radians(1.0)


@dataclass(frozen=True)
class SurfacePoints:
    """Contact points p (n, 3) m with n, t (n, 3) unit and square, curvature (n, 3) k_tt, k_bb, k_tb 1/m; blade frame."""

    p: Array
    n: Array
    t: Array
    curvature: Array
    notices: tuple[str, ...]


def points_on_surface(blade: Blade, shape: AerofoilShape, log: ForceLog) -> SurfacePoints:
    """Feet of the rows in contact; rows in the air keep their own frames and have no curvature.

    Raises BadInput as `refuse_metres`, `feet_on_blade` and `angles_to_surface`: points off the blade, normals that are not its
    outward ones.
    """
    touching = np.flatnonzero(log.contact).astype(np.int64)

    def row(k: int) -> str:
        return f"{log.path}, line {log.row[touching[k]]}, columns"

    if len(touching):
        refuse_metres(log.p[touching], f"{row(0)} px_mm, py_mm, pz_mm")
    name, u, v, foot, normal, gap = feet_on_blade(blade, shape, log.p[touching], lambda k: f"{row(k)} px_mm, py_mm, pz_mm")
    angle = angles_to_surface(log.n[touching], normal, lambda k: f"{row(k)} nx, ny, nz")
    p, n, t = log.p.copy(), log.n.copy(), log.t.copy()
    moved, turned = gap > TRUSTED_GAP, angle > TRUSTED_ANGLE
    p[touching[moved]], n[touching[turned]] = foot[moved], normal[turned]
    t = t - np.sum(t * n, axis=1, keepdims=True) * n
    t /= np.linalg.norm(t, axis=1, keepdims=True)
    curvature = np.zeros_like(p)
    for side in shape.sides.values():
        on = name == side.name
        rows = touching[on]
        across = t[rows] - np.sum(t[rows] * normal[on], axis=1, keepdims=True) * normal[on]
        across /= np.linalg.norm(across, axis=1, keepdims=True)
        curvature[rows] = curvature_in_frame(side.surface, u[on], v[on], normal[on], across)
    rest = touching[name == "edge"]
    if len(rest):
        curvature[rest] = facet_curvature(blade, p[rest], n[rest], t[rest], np.cross(n[rest], t[rest]))
    return SurfacePoints(p, n, t, curvature, _notices(log, gap, moved, angle, turned, len(rest)))


def _notices(log: ForceLog, gap: Array, moved: Flags, angle: Array, turned: Flags, edge: int) -> tuple[str, ...]:
    notices = []
    if moved.any() or turned.any():
        notices.append(
            f"{log.path.name}: {int((moved | turned).sum())} points were put onto the blade's surface, moved by up to "
            f"{1e3 * gap.max():.3f} mm and turned by up to {np.degrees(angle.max()):.2f} deg"
        )
    if edge:
        notices.append(
            f"{log.path.name}: {edge} rows lie on an edge, a fillet or the block; their curvature comes from the facets nearby "
            "and is rough"
        )
    return tuple(notices)


STATIONS_VERSION = "force stations 1"  # part of the cache key: raise it when results change
SPACING = 4e-3  # m between stations; what interpolation between them misses: docs/force_registration.md
NORMAL_LENGTH = 10e-3  # m a unit vector counts for in distances: keeps the two sides of a thin blade apart
NEIGHBOURS = 16
SAME = 0.5e-3  # m; points this close are one when stations are chosen


@dataclass(frozen=True)
class Stations:
    """Contacts (k, 3) at which finite elements are solved: p m, n unit, blade frame; compliance tensors (k, 3, 3) m/N."""

    p: Array
    n: Array
    tensor: Array

    def at(self, p: Array, n: Array, t: Array) -> Array:
        """c_nn, c_nt, c_nb (m, 3) m/N, as `ocp.contact.blade.compliance.Compliance`, at contacts (m, 3) between them."""
        stations, wanted = np.hstack([self.p, NORMAL_LENGTH * self.n]), np.hstack([p, NORMAL_LENGTH * n])
        if len(stations) < 3:
            return contact_components(self.tensor[cKDTree(stations).query(wanted)[1]], n, t)
        tensor = _smooth(stations, self.tensor.reshape(-1, 9), NEIGHBOURS, wanted).reshape(-1, 3, 3)
        return contact_components(tensor, n, t)


@dataclass(frozen=True)
class StationsTask:
    """Stations that are asked for: spread over contacts p, n, t (m, 3), each under a patch of `semi_axes` m; element size m."""

    held: HeldBlade
    p: Array
    n: Array
    t: Array
    semi_axes: tuple[float, float]
    size: float

    @staticmethod
    def of(cell: Cell, blade: Blade, p: Array, n: Array, t: Array, semi_axes: tuple[float, float]) -> "StationsTask":
        """For contacts (m, 3) on the cell's blade."""
        piece, at = cell.workpiece, spread_stations(p, n)
        material = Material(piece.youngs_modulus, piece.poisson, piece.density)
        held = HeldBlade(blade.vertices, blade.faces, piece.clamp_normal, piece.clamp_offset, material)
        return StationsTask(held, p[at], n[at], t[at], semi_axes, held.element_size(semi_axes))

    @property
    def key(self) -> str:
        """Name in the cache."""
        asked = *self.semi_axes, self.size, self.p, self.n, self.t
        return content_key(STATIONS_VERSION, MESH_VERSION, *self.held.content, *asked)

    @property
    def known(self) -> bool:
        """Whether the answer is on disk."""
        return recall("force-blade", self.key) is not None

    def solve(self) -> Stations:
        """The blade's compliance at the stations; kept on disk.

        Raises BadInput: no mesh, a clamp that holds nothing or everything.
        """

        def compute() -> Entry:
            return {"tensor": clamped_blade(self.held, self.size).tensor(self.p, self.n, self.t, self.semi_axes)}

        return Stations(self.p, self.n, np.asarray(remember("force-blade", self.key, compute)["tensor"], float))


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


def _smooth(places: Array, values: Array, neighbours: int, wanted: Array) -> Array:
    """Values (k, ..) at places (k, d) m between them, at wanted places (m, d) m.

    Stations along a few lines do not span space: a kernel that needs no polynomial beside it.
    """
    near = min(neighbours, len(places))
    return np.asarray(RBFInterpolator(1e3 * places, values, near, kernel="linear", degree=0)(1e3 * wanted))


CORRECTION_VERSION = "indentation correction 2"  # part of the cache key: raise it when results change
CORRECTION_SPACING = 16e-3  # m between stations; the departure from the quadratic varies slowly along a pass
FORCE_LENGTH = 1e-3  # m that one newton counts for in distances between stations
LATERAL_WEIGHT = 2.0  # a shift across the wheel counts this much more than one along the blade: its edges matter
CORRECTION_NEIGHBOURS = 12
CORRECTION = N_WAYPOINT - 1  # its column of a waypoint


def with_indentation_correction(model: ForceModel, cover: Cover, cloud: SurfaceCloud, rows: ForceRows, force: Array) -> ForceRows:
    """`rows` with the correction (m) of each in its waypoint: indentation under `force` (n,) N on the real surface less that on
    the local quadratic, both solved on `cover`, at the cell's nominal postures. Its cells are to be fine: where the blade
    ends under the wheel, coarse ones put the edge in the wrong place (docs/force_registration.md).

    Where the real surface cannot be solved (the wheel bears far from the point) the quadratic is left alone.
    """
    touching = np.flatnonzero(rows.contact)
    if not len(touching):
        return rows
    part = rows.take(touching)
    theta = believed_theta(replace(model.cell, calibration=None)).values
    state = model.evaluate("state", PlacedRows.of(model.cell, part, theta), force[touching])
    lateral = LATERAL_WEIGHT * state[:, STATE["lateral"]]
    p, n = part.waypoint[:, :3], part.waypoint[:, 3:6]
    place = np.hstack([p, NORMAL_LENGTH * n, FORCE_LENGTH * force[touching, None], lateral])
    at = spread_stations(p, place[:, 3:] / NORMAL_LENGTH, CORRECTION_SPACING)
    rows_key = (part.q[at], part.waypoint[at, :12], force[touching][at])
    cell_key = (model.cell.wheel.centre, model.cell.wheel.axis, model.cell.workpiece.T_flange_blade)
    key = content_key(CORRECTION_VERSION, repr(asdict(cover.geometry)), cover.dx, cloud.points, *rows_key, *cell_key)

    def compute() -> Entry:
        chosen, newton = part.take(at), force[touching][at]
        solved = [_departure(model, cover, cloud, chosen, state[at], float(F), k) for k, F in enumerate(newton)]
        return {"correction": np.array(solved)}

    known = np.asarray(remember("force-correction", key, compute)["correction"], float)
    sound = np.isfinite(known)
    waypoint = rows.waypoint.copy()
    if sound.sum() >= 3:
        waypoint[touching, CORRECTION] = _smooth(place[at][sound], known[sound], CORRECTION_NEIGHBOURS, place)
    elif sound.any():
        waypoint[touching, CORRECTION] = known[sound].mean()
    return replace(rows, waypoint=waypoint)


def feed_heading(wheel: Wheel, T: Array, waypoint: Array) -> tuple[float, float]:
    """The feed's direction in the wheel's contact frame at a waypoint (16,) of a blade at T (4, 4)."""
    t, v = T[:3, :3] @ waypoint[6:9], T[:3, :3] @ waypoint[:3] + T[:3, 3] - wheel.centre
    e = v - wheel.axis * (v @ wheel.axis)
    return float(t @ np.cross(wheel.axis, e / np.linalg.norm(e))), float(t @ wheel.axis)


def _departure(
    model: ForceModel, cover: Cover, cloud: SurfaceCloud, rows: ForceRows, state: Array, force: float, k: int
) -> float:
    """Correction m of row k; nan where there is no solution."""
    lateral, tilt_x, tilt_y, kxx, kyy, kxy = (
        float(v) for name in ("lateral", "tilt", "curvature") for v in state[k, STATE[name]]
    )
    T = state[k, STATE["T"]].reshape(4, 4)
    wheel = model.cell.wheel
    flat = LocalShape(kxx, kyy, kxy, lateral, tilt_x, tilt_y, heading=feed_heading(wheel, T, rows.waypoint[k]))
    real = surface_shape(wheel, cloud, flat, T, rows.waypoint[k, :3])
    try:
        contact = solve_force(cover, force, real)
        return contact.indentation - solve_force(cover, force, flat, contact).indentation
    except Infeasible:
        return float("nan")
