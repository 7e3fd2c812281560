"""The blade and its passes: laid on the shape found in the STL, or taken from a path or an old program."""

from dataclasses import dataclass
from pathlib import Path
from typing import Protocol

import numpy as np
import trimesh
from scipy.spatial import cKDTree

from ocp.model.blade_gap import SurfaceCloud
from ocp.model.cell import Cell
from ocp.plan.old_path import paths_from_program
from ocp.plan.rules import WHEEL_ROOM
from robots.pose import Array
from trajectories.blade import AerofoilShape, Blade, find_shape, read_blade
from trajectories.passes import BladePath, PassOptions, passes
from trajectories.path_file import read_path_file

CLOUD_SPACING = 8e-4  # m between points of the surface cloud


class PathChoice(Protocol):
    """Where the passes come from and how far apart waypoints stand, m."""

    @property
    def path(self) -> Path | None:
        """A path.csv, or None."""

    @property
    def program(self) -> Path | None:
        """An old .src, or None."""

    @property
    def step(self) -> float:
        """Distance of waypoints, m."""


@dataclass(frozen=True)
class LaidPaths:
    """Blade, passes in the order of the lines, the ground surface as a cloud, and notices in sentences."""

    blade: Blade
    paths: list[BladePath]
    cloud: SurfaceCloud
    notices: tuple[str, ...]


def lay_paths(cell: Cell, stl: Path, choice: PathChoice) -> LaidPaths:
    """Read the blade, find its aerofoil and lay the passes the cell asks for.

    Raises BadInput: the STL, the clamp, the margins or the path handed in cannot be used.
    """
    blade = read_blade(stl, cell.workpiece.stl_unit)
    shape = find_shape(blade)
    cloud = surface_cloud(shape, blade)
    if choice.path is not None:
        paths, notices = read_path_file(choice.path, blade, shape, cell.process.feed, cell.process.force)
    elif choice.program is not None:
        paths, notices = paths_from_program(cell, blade, shape, cloud, choice.program, choice.step)
    else:
        paths, notices = passes(blade, shape, _options(cell, choice.step))
    return LaidPaths(blade, paths, cloud, (*blade.notices, *shape.notices, *notices))


def surface_cloud(shape: AerofoilShape, blade: Blade) -> SurfaceCloud:
    """The blade's whole surface: smooth on both flanks, the STL's own facets elsewhere (edges, tip, fillets, platform).

    Points stand about CLOUD_SPACING apart.
    """
    points, normals = [], []
    for side in shape.sides.values():
        n_u = int(np.ceil(side.width.max() / CLOUD_SPACING)) + 1
        n_v = int(np.ceil(shape.frame.length / CLOUD_SPACING)) + 1
        # Denser toward the edges, where the surface turns.
        u = 0.5 - 0.5 * np.cos(np.linspace(0.0, np.pi, n_u + n_u // 2))
        grid = np.meshgrid(u, np.linspace(float(shape.v[0]), float(shape.v[1]), n_v), indexing="ij")
        u_all, v_all = (g.ravel() for g in grid)
        points.append(side.surface(u_all, v_all))
        normals.append(side.normal(u_all, v_all))
    smooth = np.vstack(points)
    other, other_normals = _facet_points(blade)
    apart = cKDTree(smooth).query(other)[0] > CLOUD_SPACING
    return SurfaceCloud(np.vstack([smooth, other[apart]]), np.vstack([*normals, other_normals[apart]]))


def _facet_points(blade: Blade) -> tuple[Array, Array]:
    """Points on the facets about CLOUD_SPACING apart, (m, 3) m, and the facets' normals (m, 3)."""
    vertices, faces = trimesh.remesh.subdivide_to_size(blade.vertices, blade.faces, 1.5 * CLOUD_SPACING, max_iter=12)
    corner = vertices[faces]
    normal = np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0])
    length = np.linalg.norm(normal, axis=1)
    sound = length > 0
    used, first = np.unique(faces[sound].ravel(), return_index=True)
    return vertices[used], np.repeat(normal[sound] / length[sound, None], 3, axis=0)[first]


def _options(cell: Cell, step: float) -> PassOptions:
    process, piece = cell.process, cell.workpiece
    return PassOptions(
        clamp_normal=(float(piece.clamp_normal[0]), float(piece.clamp_normal[1]), float(piece.clamp_normal[2])),
        clamp_offset=piece.clamp_offset,
        clamp_side="below",
        direction=process.passes,
        side=process.side,
        spacing=process.pass_spacing,
        root_margin=process.root_margin,
        tip_margin=process.tip_margin,
        edge_margin=process.edge_margin,
        step=step,
        feed=process.feed,
        force=process.force,
        wheel_radius=cell.wheel.radius + WHEEL_ROOM,
        wheel_width=cell.wheel.width + 2 * WHEEL_ROOM,
    )
