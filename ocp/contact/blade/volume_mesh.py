"""Ten-node tetrahedra inside a closed triangle surface, whatever its triangles look like.

The surface is remeshed first (`surface_mesh`), then filled by Netgen; fTetWild, slower but content with almost any
surface, is the last resort. Each attempt is checked: closed, no turned element, the volume of the surface.
"""

import signal
import subprocess
import sys
import tempfile
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ocp.contact.blade.elasticity import EDGES, QuadraticMesh, quadratic_mesh, tetra_edges, tetra_volumes
from ocp.contact.blade.surface_mesh import SizeLaw, edges_of, remesh
from ocp.shell.cache import content_key, remember
from robots.errors import BadInput

Array = NDArray[np.float64]
Index = NDArray[np.int64]

VERSION = "volume mesh 5"  # part of the cache key: raise it when results change
FINE = 0.25  # edge length at the clamp plane, of the element size
GROWTH = 0.3  # of edge length per distance from that plane
TOLERANCE = 1e-5  # m the remeshed surface may leave the STL; a hundredth of the thickness of a 1 mm blade
LOOSE_TOLERANCE = 2e-5  # m, for fTetWild, whose time grows as its envelope gets thin
MAX_ELEMENTS = 60_000  # more would take minutes and gigabytes
COARSENED, COARSER = 3, 1.1  # tries with too many elements, and by how much longer their edges get than the count asks for
MAX_VOLUME_ERROR = 0.01  # of the surface's volume
SECONDS = {"netgen": 180, "fTetWild": 300}  # of computing, after which a mesher is given up: a busy machine changes no mesh
PATIENCE = 20 if hasattr(signal, "SIGXCPU") else 1  # times as long on the clock: for what hangs; Windows counts no computing
_UNIT = 1e-3  # m: meshers get millimetres, for which their absolute tolerances are made
ON_PLANE = 1e-3  # of the mean edge length: nearer vertices are moved onto the plane


@dataclass(frozen=True)
class VolumeMesh:
    """A solid mesh and how it was made.

    `volume_error` is relative to the volume inside the given surface.
    """

    mesh: QuadraticMesh
    mesher: str
    volume_error: float


def volume_mesh(vertices: Array, faces: Index, size: float, fine_plane: tuple[Array, float] | None = None) -> VolumeMesh:
    """Fill a closed surface with ten-node tetrahedra.

    Args:
        vertices: (nv, 3) m.
        faces: (nf, 3), outward.
        size: wished edge length in m.
        fine_plane: unit normal (3,) and offset in m of a plane near which edges are shorter, down to FINE * size.

    Raises:
        BadInput: the surface is not closed, the size is useless, or no mesher could fill the surface.
    """
    vertices, faces = np.asarray(vertices, float), np.asarray(faces, np.int64)
    if not np.isfinite(size) or size <= 0.0:
        raise BadInput(f"the element size {size} m of the blade mesh is not a positive length")
    try:
        edges_of(faces)
    except ValueError:
        raise BadInput(
            "the blade surface has open or doubly used edges, so it encloses no solid; "
            "close it in the CAD system and export it again"
        ) from None
    inside = surface_volume(vertices, faces)
    if inside <= 0.0:
        raise BadInput("the blade surface encloses no volume or its facets point inwards; turn the normals outwards")
    expected = surface_area(vertices, faces) / size**2
    if expected > MAX_ELEMENTS / 3.0:
        raise BadInput(
            f"an element size of {size * 1e3:.3g} mm would need more than {MAX_ELEMENTS} elements on "
            f"this blade; take at least {size * 1e3 * (3.0 * expected / MAX_ELEMENTS) ** 0.5:.2g} mm"
        )

    def compute() -> dict[str, NDArray[np.generic]]:
        points, tetrahedra, mesher = _attempts(vertices, faces, size, inside, fine_plane)
        return {"points": points, "tetrahedra": tetrahedra, "mesher": np.array(mesher)}

    entry = remember("mesh", content_key(VERSION, vertices, faces, float(size), *(fine_plane or ())), compute)
    mesh = quadratic_mesh(entry["points"].astype(float), entry["tetrahedra"].astype(np.int64))
    return VolumeMesh(mesh, str(entry["mesher"]), mesh.volume / inside - 1.0)


def _size_law(size: float, fine_plane: tuple[Array, float] | None) -> SizeLaw:
    """Return the wished edge length as a function of place: FINE * size on the plane, growing to `size` away from it.

    The stress is singular along the rim of a clamp; even elements there cost more accuracy than anywhere else.
    """

    def law(points: Array) -> Array:
        if fine_plane is None:
            return np.full(len(points), size)
        apart = np.abs(points @ fine_plane[0] - fine_plane[1])
        return np.minimum(FINE * size + GROWTH * apart, size)

    return law


def surface_volume(vertices: Array, faces: Index) -> float:
    """Volume in m^3 inside a closed surface; negative when its facets point inwards."""
    corner = vertices[faces] - vertices.mean(axis=0)
    return float(np.linalg.det(corner).sum() / 6.0)


def surface_area(vertices: Array, faces: Index) -> float:
    """Area in m^2 of a triangle surface."""
    corner = vertices[faces]
    normal = np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0])
    return float(0.5 * np.linalg.norm(normal, axis=1).sum())


def _attempts(
    vertices: Array, faces: Index, size: float, inside: float, fine_plane: tuple[Array, float] | None
) -> tuple[Array, Index, str]:
    """Try meshers in turn; the first sound result wins."""
    reasons = []
    for mesher, scale in (("netgen", 1.0), ("netgen", 0.8), ("fTetWild", 1.0)):
        try:
            return *_checked(*_filled(mesher, vertices, faces, scale * size, fine_plane), inside), mesher
        except ValueError as error:
            reasons.append(f"{mesher} at {scale * size * 1e3:.3g} mm: {error}")
    raise BadInput(
        "the blade surface could not be filled with tetrahedra ("
        + "; ".join(reasons)
        + "); repair the surface in the CAD system or choose another element size"
    )


def _filled(
    mesher: str, vertices: Array, faces: Index, size: float, fine_plane: tuple[Array, float] | None
) -> tuple[Array, Index]:
    """What a mesher makes of a surface, with longer edges where those of `size` m would be too many elements. Raises ValueError
    as `_run`."""
    for _ in range(COARSENED):
        surface = remesh(vertices, faces, _size_law(size, fine_plane), TOLERANCE) if mesher == "netgen" else (vertices, faces)
        points, tetrahedra = _run(mesher, *surface, size)
        if len(tetrahedra) <= MAX_ELEMENTS:
            break
        size *= COARSER * (len(tetrahedra) / MAX_ELEMENTS) ** 0.5  # those at the clamp plane are the most: they are an area
    return points, tetrahedra


def _run(mesher: str, vertices: Array, faces: Index, size: float) -> tuple[Array, Index]:
    """Call a mesher in a child process.

    Raises:
        ValueError: it was not there, failed or took too long; the message is a short reason.
    """
    with tempfile.TemporaryDirectory(prefix="grindplan-mesh-") as folder:
        source, target = Path(folder) / "surface.npz", Path(folder) / "solid.npz"
        np.savez(source, vertices=vertices / _UNIT, faces=faces, size=size / _UNIT, tolerance=LOOSE_TOLERANCE / _UNIT)
        script = Path(__file__).with_name("mesher.py")
        try:
            done = subprocess.run(
                [sys.executable, "-P", str(script), mesher, str(source), str(target), str(SECONDS[mesher])],
                cwd=folder,
                capture_output=True,
                timeout=PATIENCE * SECONDS[mesher],
                check=False,
            )
        except subprocess.TimeoutExpired:
            raise ValueError(f"not done after {PATIENCE * SECONDS[mesher]} s") from None
        except OSError as error:
            raise ValueError(f"could not be started ({error})") from None
        if done.returncode == -getattr(signal, "SIGXCPU", 0) != 0:
            raise ValueError(f"not done after {SECONDS[mesher]} s of computing")
        if done.returncode != 0 or not target.exists():
            said = done.stderr.decode(errors="replace").strip().splitlines()
            raise ValueError(f"gave up with {said[-1][:120] if said else f'exit code {done.returncode}'}")
        with np.load(target, allow_pickle=False) as data:
            return data["points"] * _UNIT, data["tetrahedra"]


def _checked(points: Array, tetrahedra: Index, inside: float) -> tuple[Array, Index]:
    """Return positively oriented tetrahedra.

    Raises:
        ValueError: the mesh is empty, too large, folded or does not fill the surface.
    """
    if not 0 < len(tetrahedra) <= MAX_ELEMENTS:
        raise ValueError(f"{len(tetrahedra)} elements, wanted 1 to {MAX_ELEMENTS}")
    volume = tetra_volumes(points, tetrahedra)
    if np.median(volume) < 0.0:
        tetrahedra, volume = tetrahedra[:, [1, 0, 2, 3]], -volume
    if volume.min() <= 0.0:
        raise ValueError(f"{np.count_nonzero(volume <= 0.0)} turned elements")
    if abs(volume.sum() / inside - 1.0) > MAX_VOLUME_ERROR:
        raise ValueError(f"its volume is off by {100.0 * (volume.sum() / inside - 1.0):.1f} %")
    return points, tetrahedra


def clamp_cut(points: Array, tetrahedra: Index, normal: Array, offset: float) -> tuple[Array, Index]:
    """Split tetrahedra so that none reaches across the plane `normal . x = offset`.

    Args:
        points: (np, 3) m.
        tetrahedra: (nt, 4).
        normal: (3,) unit; everything with normal . x < offset is held.
        offset: m.

    Returns:
        Points and tetrahedra.

    Raises:
        BadInput: the clamp holds nothing or everything.
    """
    height = points @ normal - offset
    lowest, highest = height.min(), height.max()
    edge = points[tetrahedra[:, 0]] - points[tetrahedra[:, 1]]
    near = np.abs(height) < ON_PLANE * np.mean(np.linalg.norm(edge, axis=1))
    points = points - np.where(near, height, 0.0)[:, None] * normal
    height[near] = 0.0
    if height.min() >= 0.0 or height.max() <= 0.0:
        raise BadInput(
            f"the clamp plane at {offset * 1e3:.4g} mm holds {'nothing' if height.min() >= 0.0 else 'all'} of the blade, "
            f"which reaches from {(lowest + offset) * 1e3:.4g} to {(highest + offset) * 1e3:.4g} mm along the clamp normal; "
            "move clamp_offset_mm (clamp_to_mm) between them"
        )
    while True:
        low, high, _ = tetra_edges(tetrahedra)
        crossing = height[low] * height[high] < 0.0
        if not crossing.any():
            return points, tetrahedra
        low, high = low[crossing], high[crossing]
        share = height[low] / (height[low] - height[high])
        count = len(points)
        points, tetrahedra = _split(points, tetrahedra, low, high, share)
        height = np.concatenate([height, np.zeros(len(points) - count)])


def _split(points: Array, tetrahedra: Index, low: Index, high: Index, share: Array) -> tuple[Array, Index]:
    """Split those of the listed edges that come first in every tetrahedron around them.

    The new vertex lies at `share` of the way from `low` to `high`; both halves of each tetrahedron stay in the list,
    so the mesh stays conforming.
    """
    count = len(points)
    ends = np.sort(tetrahedra[:, EDGES], axis=2)
    wanted = low * count + high
    key = ends[..., 0] * count + ends[..., 1]
    found = np.minimum(np.searchsorted(wanted, key), len(wanted) - 1)
    owner, which = np.nonzero(wanted[found] == key)
    edge = found[owner, which]
    first = np.full(len(tetrahedra), len(low))
    np.minimum.at(first, owner, edge)
    ready = np.ones(len(low), bool)
    ready[edge[first[owner] != edge]] = False
    middle = np.cumsum(ready) - 1 + count
    new = points[low] + share[:, None] * (points[high] - points[low])
    points = np.vstack([points, new[ready]])
    taken = ready[edge]
    owner, edge = owner[taken], edge[taken]
    tetra = tetrahedra[owner]
    halves = [np.where(tetra == end[edge, None], middle[edge, None], tetra) for end in (low, high)]
    return points, np.vstack([np.delete(tetrahedra, owner, axis=0), *halves])
