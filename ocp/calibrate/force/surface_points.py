"""Where logged contact points stand on the blade: point, frame and local curvature of every row."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ocp.calibrate.force.log import Flags, ForceLog
from robots.errors import BadInput
from robots.pose import Array
from trajectories.blade import AerofoilShape, Blade
from trajectories.blade.spline import curvature_in_frame
from trajectories.path_points import NORMAL_LIMIT, OFF_SURFACE, facet_curvature, locate, place_on_mesh

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

    Raises BadInput for points farther than OFF_SURFACE from the blade and for normals that are not its outward ones.
    """
    touching = np.flatnonzero(log.contact).astype(np.int64)
    name, u, v, foot, normal = locate(shape, log.p[touching])
    place_on_mesh(blade, name, foot, normal, log.p[touching])
    gap = np.linalg.norm(foot - log.p[touching], axis=1)
    angle = np.arccos(np.clip(np.sum(normal * log.n[touching], axis=1), -1.0, 1.0))
    _refuse(log, blade, touching, gap, angle)
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


def _refuse(log: ForceLog, blade: Blade, touching: NDArray[np.int64], gap: Array, angle: Array) -> None:
    if (gap > OFF_SURFACE).any():
        k = int(np.argmax(gap > OFF_SURFACE))
        raise BadInput(
            f"{log.path}, line {log.row[touching[k]]}, columns px_mm, py_mm, pz_mm: the point is {1e3 * gap[k]:.3f} mm off the "
            f"surface of {blade.name}, the limit is {1e3 * OFF_SURFACE:g} mm ({int((gap > OFF_SURFACE).sum())} such rows); "
            "give points of this blade in its own frame"
        )
    if (angle > NORMAL_LIMIT).any():
        k = int(np.argmax(angle > NORMAL_LIMIT))
        how = "into the blade" if angle[k] > np.pi / 2 else f"{np.degrees(angle[k]):.1f} deg off the surface's normal"
        raise BadInput(
            f"{log.path}, line {log.row[touching[k]]}, columns nx, ny, nz: the normal points {how}, the limit is "
            f"{np.degrees(NORMAL_LIMIT):g} deg; give outward unit normals of this blade"
        )


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
