"""read_blade: from a file name to a Blade that every later step may trust."""

import hashlib
from pathlib import Path

import numpy as np

from robots.errors import BadInput
from trajectories.blade.mesh import Blade
from trajectories.blade.stl import read_facets

UNITS = {"mm": 1e-3, "m": 1.0, "in": 25.4e-3}  # metres per unit


def read_blade(path: str | Path, unit: str = "mm") -> Blade:
    """Read, check and mend the STL file of a blade.  (first version: merges vertices only)."""
    path = Path(path)
    if unit not in UNITS:
        raise BadInput(f"stl_unit = {unit!r} is not known; use one of {', '.join(UNITS)}.")
    corners, notices = read_facets(path)
    vertices, index = np.unique(corners.reshape(-1, 3), axis=0, return_inverse=True)
    faces = index.reshape(-1, 3)
    return Blade(path.stem, hashlib.sha256(path.read_bytes()).hexdigest(), vertices * UNITS[unit], faces, tuple(notices))
