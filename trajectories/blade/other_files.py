"""Blades that are no STL: PLY and OBJ (scans, exports) by trimesh, STEP by netgen's Open CASCADE."""

from io import BytesIO
from pathlib import Path

import numpy as np

from robots.bounds import read_whole
from robots.errors import BadInput, shown, words_kept_back
from robots.pose import Array
from trajectories.blade.stl import MAX_FACETS, MOST_BYTES

MESHES = (".ply", ".obj")
SOLIDS = (".step", ".stp")
BLADE_FILES = (".stl", *MESHES, *SOLIDS)
ACROSS = 60  # facets along the longest side of a STEP's blade
BEND = 4.0  # facets along a radius of curvature
CHECKED = 150  # facets whose middles are compared with the STEP's surface


def read_other(path: Path) -> tuple[Array, list[str]]:
    """Corners (nf, 3, 3) of a PLY, OBJ or STEP file in its own unit (STEP: mm), and notices. Raises BadInput: no such surface."""
    read = _read_step if path.suffix.lower() in SOLIDS else _read_mesh
    corners, notices = read(path)
    if not len(corners):
        raise BadInput(f"{path}: holds no facet; mesh its points first, or export the blade as a surface.")
    if len(corners) > MAX_FACETS:
        raise BadInput(f"{path}: has {len(corners)} facets, the limit is {MAX_FACETS}; export it coarser.")
    if not np.isfinite(corners).all():
        raise BadInput(f"{path}: holds a corner that is no finite number; export it again.")
    return corners, notices


def _read_mesh(path: Path) -> tuple[Array, list[str]]:
    import trimesh  # half a second, for those who bring such a file

    kind = path.suffix.lower()[1:]
    data = read_whole(path, MOST_BYTES, f"a {kind.upper()} file.")
    try:
        mesh = trimesh.load(BytesIO(data), file_type=kind, process=False, force="mesh", skip_materials=True)
        faces = np.asarray(mesh.faces, np.int64)
        vertices = np.asarray(mesh.vertices, float)
        if len(faces) and (vertices.shape[1:] != (3,) or faces.shape[1:] != (3,)):
            raise ValueError("corners that are not three numbers, or facets that are not three corners")
        corners = vertices[faces] if len(faces) else np.zeros((0, 3, 3))
    except Exception as error:  # a reader's own errors are of every kind
        raise BadInput(f"{path}: cannot be read as {kind.upper()} ({shown(str(error), 100)}); export it again.") from None
    return corners, []


def _read_step(path: Path) -> tuple[Array, list[str]]:
    """Facets on the solid's own surface, and by how much they leave it."""
    import netgen.meshing as meshing
    from netgen.occ import OCCGeometry, Pnt, Vertex

    data = read_whole(path, MOST_BYTES, "a STEP file.")
    if not data.lstrip().startswith(b"ISO-10303"):
        raise BadInput(f"{path}: is no STEP file (it does not begin with ISO-10303); export it again.")
    try:
        with words_kept_back():
            geometry = OCCGeometry(str(path))
        solids = list(geometry.solids)
        low, high = geometry.shape.bounding_box
        size = max(high[i] - low[i] for i in range(3))
        wanted = meshing.MeshingParameters(
            maxh=size / ACROSS, curvaturesafety=BEND, perfstepsend=meshing.MeshingStep.MESHSURFACE, quad_dominated=False
        )
        mesh = geometry.GenerateMesh(wanted)
        points = np.array([list(p.p) for p in mesh.Points()], float)
        faces = np.array([[v.nr - 1 for v in element.vertices] for element in mesh.Elements2D()], np.int64).reshape(-1, 3)
        corners = points[faces]
        middles = corners[np.linspace(0, len(corners) - 1, min(CHECKED, len(corners))).astype(int)].mean(axis=1)
        off = max(min(face.Distance(Vertex(Pnt(*map(float, p)))) for face in geometry.shape.faces) for p in middles)
    except Exception as error:
        raise BadInput(f"{path}: no surface can be made of this STEP file ({shown(str(error), 100)}); export an STL.") from None
    if len(solids) != 1:
        raise BadInput(f"{path}: holds {len(solids)} solids, one blade is asked for; export the blade alone.")
    told = f"{len(corners)} facets stand for the STEP's surface: corners on it, middles up to {1e3 * off:.1f} um off."
    return corners, [told]
