"""The nearest point of a blade's facets."""

import numpy as np
import trimesh
from numpy.typing import NDArray

from robots.pose import Array
from trajectories.blade.mesh import Blade

UNIT = 1e3  # mm: trimesh takes facets for equally near whose squared distances differ by 1e-8, in metres a tenth of a millimetre


def nearest_on_facets(blade: Blade, points: Array) -> tuple[Array, Array, NDArray[np.int64]]:
    """Nearest points (n, 3) m of the facets to points (n, 3) m, distances (n,) m, and the facets' numbers (n,)."""
    mesh = trimesh.Trimesh(UNIT * blade.vertices, blade.faces, process=False)
    closest, distance, facet = trimesh.proximity.closest_point(mesh, UNIT * points)
    return closest / UNIT, distance / UNIT, facet
