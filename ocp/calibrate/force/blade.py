"""The blade under logged contact points: their place and curvature on its surface, its give there, and its real surface.

Place, frame and local curvature of every row come from the fitted surface. The compliance is solved by finite elements at a few
stations and interpolated between them, and so is the correction by which the blade's real surface differs from the quadratic of
the wheel law (direct contact solutions).
"""

from dataclasses import asdict, dataclass, replace
from functools import cached_property
from typing import Any

import casadi as ca
import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import RBFInterpolator
from scipy.spatial import cKDTree
from scipy.spatial.transform import Rotation

from ocp.calibrate.force.log import Flags, ForceLog, Index
from ocp.calibrate.force.model import CORRECTION, STATE, ForceModel, ForceRows, PlacedRows
from ocp.contact.blade.compliance import HeldBlade, clamped_blade, contact_components
from ocp.contact.blade.elasticity import Material
from ocp.contact.blade.volume_mesh import VERSION as MESH_VERSION
from ocp.contact.wheel.cover import Cover
from ocp.contact.wheel.law import WheelLaw
from ocp.contact.wheel.signorini import LocalShape, solve_force
from ocp.model.blade_gap import SurfaceCloud, surface_shape
from ocp.model.cell import Cell, Wheel
from ocp.model.theta import NAMES, wheel_at
from ocp.shell.cache import Entry, content_key, flattened, recall, remember
from robots.errors import Infeasible
from robots.pose import Array, apply, invert, make_transform
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


CORRECTION_VERSION = "indentation correction 3"  # part of the cache key: raise it when results change
COARSE, FINE = 16e-3, 4e-3  # m between stations, with a flange and without: there 10 um are half a newton
SWAY = (2e-4, 2e-3, 2e-3)  # m, rad, rad over which: what registration is open by
FORCE_LENGTH = 1e-3  # m that one newton counts for in distances between stations
LATERAL_WEIGHT = 2.0  # a shift across the wheel counts this much more than one along the blade: its edges matter
CORRECTION_NEIGHBOURS = 12


def with_indentation_correction(
    model: ForceModel, cover: Cover, cloud: SurfaceCloud, rows: ForceRows, force: Array, theta: Array
) -> ForceRows:
    """`rows` with the correction (m) of each in its waypoint: indentation under `force` (n,) N on the real surface, solved on
    `cover`, less that by the model's law, about the postures that parameters `theta` (M,) make. In a rigid cell also what it
    changes by with them: near an edge a blade that sits 0.2 mm aside is pressed 20 um deeper. The cover's cells are to be fine:
    where the blade ends under the wheel, coarse ones put the edge in the wrong place (docs/force_registration.md).

    Where the real surface cannot be solved (the wheel bears far from the point) the law is left alone.
    """
    touching = np.flatnonzero(rows.contact)
    if not len(touching):
        return rows
    plain = rows.waypoint[touching].copy()
    plain[:, CORRECTION] = 0.0
    part = replace(rows.take(touching), waypoint=plain, sway=np.zeros((len(touching), 3)))
    state = model.evaluate("state", PlacedRows.of(model.cell, part, theta), force[touching])
    posture = np.column_stack([state[:, STATE["lateral"]], state[:, STATE["tilt"]]])
    p, n = part.waypoint[:, :3], part.waypoint[:, 3:6]
    place = np.hstack([p, NORMAL_LENGTH * n, FORCE_LENGTH * force[touching, None], LATERAL_WEIGHT * posture[:, :1]])
    far = spread_stations(p, place[:, 3:] / NORMAL_LENGTH, COARSE)
    rigid = model.cell.flange is None
    near = spread_stations(p, place[:, 3:] / NORMAL_LENGTH, FINE) if rigid else far
    newton = force[touching] / (1.0 + theta[NAMES.index("cover_stiffness_scale")])  # on a cover as soft as the law's
    wheel, law = wheel_at(model.cell.wheel, theta), (value for _, value in sorted(flattened(model.law).items()))
    seen = np.concatenate([np.r_[STATE[name]] for name in ("lateral", "tilt", "curvature", "T")])
    given = (near, far, float(rigid), state[:, seen], part.waypoint[:, :9], newton, wheel.centre, wheel.axis, wheel.radius, *law)
    key = content_key(CORRECTION_VERSION, repr(asdict(cover.geometry)), cover.dx, cloud.points, *given)

    def compute() -> Entry:
        solve = _Departures(model.law, wheel, cover, cloud, part, state, newton)
        sway = np.array([solve.sway(k) for k in far]) if rigid else np.zeros((len(far), 3))
        return {"correction": np.array([solve.at(k) for k in near]), "sway": sway}

    known = remember("force-correction", key, compute)
    correction = _spread_out(place, near, np.asarray(known["correction"], float)[:, None])[:, 0]
    sway = _spread_out(place, far, np.asarray(known["sway"], float))
    waypoint, whole = rows.waypoint.copy(), np.zeros((len(rows), 3))
    waypoint[touching, CORRECTION], whole[touching] = correction - np.sum(sway * posture, axis=1), sway
    return replace(rows, waypoint=waypoint, sway=whole)


def _spread_out(place: Array, at: Index, values: Array) -> Array:
    """Values (m, k) at all places (m, d) from those (j, k) at the stations `at` (j,), nan where there is no solution."""
    sound = np.isfinite(values).all(axis=1)
    if sound.sum() < 3:
        return np.broadcast_to(values[sound].mean(axis=0) if sound.any() else 0.0, (len(place), values.shape[1]))
    return _smooth(place[at][sound], values[sound], CORRECTION_NEIGHBOURS, place)


def feed_heading(wheel: Wheel, T: Array, waypoint: Array) -> tuple[float, float]:
    """The feed's direction in the wheel's contact frame at a waypoint (16,) of a blade at T (4, 4)."""
    t, v = T[:3, :3] @ waypoint[6:9], T[:3, :3] @ waypoint[:3] + T[:3, 3] - wheel.centre
    e = v - wheel.axis * (v @ wheel.axis)
    return float(t @ np.cross(wheel.axis, e / np.linalg.norm(e))), float(t @ wheel.axis)


@dataclass(frozen=True)
class _Departures:
    """Corrections of rows in contact: the wheel where it is, their states (n, k) without one, force (n,) N on a cover as
    soft as the law's."""

    law: WheelLaw
    wheel: Wheel
    cover: Cover
    cloud: SurfaceCloud
    rows: ForceRows
    state: Array
    force: Array

    def at(self, k: int, lateral: float = 0.0, tilt_x: float = 0.0, tilt_y: float = 0.0) -> float:
        """Of row k, m, moved along the wheel's axis and turned about the contact; nan where there is no solution."""
        own = self.state[k]
        kxx, kyy, kxy = (float(v) for v in own[STATE["curvature"]])
        y, (a, b) = float(own[STATE["lateral"]][0]) + lateral, (float(v) for v in own[STATE["tilt"]])
        T, point, wheel = own[STATE["T"]].reshape(4, 4), self.rows.waypoint[k, :3], self.wheel
        radial = wheel.cylindrical(apply(T, point[None]))[1][0]
        belt = np.cross(wheel.axis, radial / np.linalg.norm(radial))
        turn = make_transform(Rotation.from_rotvec(tilt_y * belt - tilt_x * wheel.axis).as_matrix(), lateral * wheel.axis)
        middle = make_transform(np.eye(3), apply(T, point[None])[0])
        T = middle @ turn @ invert(middle) @ T
        heading = feed_heading(wheel, T, self.rows.waypoint[k])
        flat = LocalShape(kxx, kyy, kxy, y, a + tilt_x, b + tilt_y, heading=heading)
        try:
            contact = solve_force(self.cover, float(self.force[k]), surface_shape(wheel, self.cloud, flat, T, point))
        except Infeasible:
            return float("nan")
        return contact.indentation - float(self._indentation(self.force[k], kxx, kyy, kxy, y, flat.tilt_x, flat.tilt_y))

    def sway(self, k: int) -> list[float]:
        """What the correction of row k changes by with lateral m and the two tilts."""
        moved = [self.at(k, *step) - self.at(k, *-step) for step in np.diag(SWAY)]
        return [change / (2.0 * step) for change, step in zip(moved, SWAY, strict=True)]

    @cached_property
    def _indentation(self) -> Any:
        inputs = [ca.SX.sym(name) for name in ("F", "kxx", "kyy", "kxy", "lateral", "tilt_x", "tilt_y")]
        return ca.Function("indentation", inputs, [self.law.indentation(*inputs)])
