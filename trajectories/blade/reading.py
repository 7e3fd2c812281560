"""read_blade: from a file name to a Blade that every later step may trust."""

import hashlib
from pathlib import Path

import numpy as np

from robots.errors import BadInput
from trajectories.blade.intersections import self_intersections
from trajectories.blade.mending import (
    close_holes,
    drop_useless,
    face_outward,
    keep_main_body,
    merge_close,
    merge_corners,
    unify_winding,
)
from trajectories.blade.mesh import Array, Blade, IntArray, directed_edges, place_mm
from trajectories.blade.other_files import MESHES, SOLIDS, read_other
from trajectories.blade.stl import read_facets

UNITS = {"mm": 1e-3, "m": 1.0, "in": 25.4e-3}  # metres per unit
SIZE_LIMITS = (0.015, 2.0)  # m: longest side of blades that a robot of this kind holds against a wheel
_MOST_RELAXED = 0.01  # share of the blade's size over which the mending of a self-intersection may move a vertex


def read_blade(path: str | Path, unit: str = "mm") -> Blade:
    """Read, check and mend a blade's STL, PLY, OBJ or STEP file; the result is closed, outward and free of self-intersections.

    unit: of the file, "mm", "m" or "in"; a STEP file has its own. What was mended stands in Blade.notices.
    Raises: BadInput, one sentence with place and remedy, for anything that cannot be mended safely.
    """
    path = Path(path)
    if unit not in UNITS:
        raise BadInput(f"stl_unit = {unit!r} is not known; use one of {', '.join(UNITS)}.")
    kind = path.suffix.lower()
    if kind in SOLIDS and unit != "mm":
        raise BadInput(f"{path}: stl_unit = {unit!r}, but a STEP file carries its own unit; leave stl_unit out.")
    corners, notices = read_other(path) if kind in (*MESHES, *SOLIDS) else read_facets(path)
    _refuse_size(path, corners, unit)
    vertices, faces = merge_corners(corners * UNITS[unit])
    name = str(path)
    faces = drop_useless(vertices, faces, notices)
    vertices, faces = merge_close(vertices, faces, notices)
    if len(faces) < 4:
        why = f" ({' '.join(notices)[:-1]})" if notices else ""
        raise BadInput(f"{name}: {len(corners)} facets leave {len(faces)}{why}, which is no solid body; export it again.")
    faces = keep_main_body(name, vertices, faces, notices)
    faces = unify_winding(name, vertices, faces, notices)
    faces = close_holes(name, vertices, faces, notices, scanned=kind in MESHES)
    faces = face_outward(vertices, faces, notices)
    used, index = np.unique(faces, return_inverse=True)
    vertices, faces = vertices[used], np.asarray(index, np.int64).reshape(-1, 3)
    vertices = _without_crossings(name, vertices, faces, notices)
    return Blade(path.name, hashlib.sha256(path.read_bytes()).hexdigest(), vertices, faces, tuple(notices))


def _refuse_size(path: Path, corners: Array, unit: str) -> None:
    """The unit is not in an STL file: compare the size with what a blade measures."""
    size = float(np.ptp(corners.reshape(-1, 3), axis=0).max())
    low, high = SIZE_LIMITS
    if low <= size * UNITS[unit] <= high:
        return
    fitting = [other for other, metres in UNITS.items() if low <= size * metres <= high]
    words = {"mm": "millimetres", "m": "metres", "in": "inches"}
    if fitting:
        guess = " or ".join(words[other] for other in fitting)
        options = " or ".join(f'"{other}"' for other in fitting)
        advice = f"is the file in {guess}? set stl_unit = {options}"
    else:
        advice = "check what was exported"
    raise BadInput(
        f"{path}: the span is {1e3 * size * UNITS[unit]:.3g} mm when read in {words[unit]}, a blade has "
        f"{1e3 * low:g} to {1e3 * high:g} mm: {advice}."
    )


def _without_crossings(name: str, vertices: Array, faces: IntArray, notices: list[str]) -> Array:
    """Vertices moved, where a few facets cut each other, until none do.

    The corners of the cutting facets are relaxed towards the mean of their neighbours: at a trailing edge that was
    meshed finer than it was rounded this opens the fold. Raises: BadInput where it takes more than a small move.
    """
    pairs = self_intersections(vertices, faces)
    if not len(pairs):
        return vertices
    centres = vertices[faces[pairs].reshape(len(pairs), -1)].mean(axis=1)
    place = place_mm(centres.mean(axis=0)) if np.ptp(centres, axis=0).max() < 0.02 else place_mm(centres[0])
    complaint = f"{name}: the surface cuts through itself in {len(pairs)} pairs of facets round {place}"
    bad = np.unique(faces[pairs])
    limit = _MOST_RELAXED * float(np.linalg.norm(np.ptp(vertices, axis=0)))
    if len(bad) > 0.02 * len(vertices):
        raise BadInput(f"{complaint}; repair it in the CAD program and export it again.")
    moved = vertices.copy()
    for _ in range(12):
        moved = _relax(moved, faces, bad, 3)
        pairs = self_intersections(moved, faces)
        shift = float(np.linalg.norm(moved - vertices, axis=1).max())
        if shift > limit:
            break
        if not len(pairs):
            notices.append(
                f"The surface cut through itself round {place}; {len(bad)} vertices there were moved by up to "
                f"{1e3 * shift:.2f} mm, check that place."
            )
            return moved
        bad = np.union1d(bad, np.unique(faces[pairs]))
    raise BadInput(
        f"{complaint}, and moving vertices by up to {1e3 * limit:.1f} mm does not open it; repair it in the "
        f"CAD program and export it again."
    )


def _relax(vertices: Array, faces: IntArray, which: IntArray, times: int) -> Array:
    """Vertices with those numbered `which` moved to the mean of their neighbours, `times` times."""
    edges = directed_edges(faces)
    edges = edges[np.isin(edges[:, 0], which)]
    index = np.searchsorted(which, edges[:, 0])
    count = np.bincount(index, minlength=len(which))[:, None]
    out = vertices.copy()
    for _ in range(times):
        total = np.zeros((len(which), 3))
        np.add.at(total, index, out[edges[:, 1]])
        out[which] = 0.5 * out[which] + 0.5 * total / count
    return out
