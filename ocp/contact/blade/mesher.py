"""Child process that fills a closed surface with tetrahedra: `python mesher.py METHOD INPUT.npz OUTPUT.npz SECONDS`.

Meshers written in C++ end the process when a surface displeases them, which must not end the caller. Run by its
path and without any import from this package, so that it starts fast and works from anywhere. It ends after so many
seconds of computing, other processes' not counted, where the system can do that (not on Windows).
Input: vertices (nv, 3), faces (nf, 3), size, tolerance, all in one length unit. Output: points (np, 3), tetrahedra (nt, 4).
"""

import sys
import types
from contextlib import suppress

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Index = NDArray[np.int64]


def netgen(vertices: Array, faces: Index, size: float, tolerance: float) -> tuple[Array, Index]:
    """Fill a surface as it is (Netgen, advancing front and Delaunay; Schoeberl 1997)."""
    import netgen.meshing as meshing

    meshing.SetMessageImportance(0)
    mesh = meshing.Mesh(dim=3)
    mesh.AddPoints(np.ascontiguousarray(vertices))
    side = mesh.Add(meshing.FaceDescriptor(surfnr=1, domin=1, domout=0, bc=1))
    mesh.AddElements(dim=2, index=side, data=np.ascontiguousarray(faces, np.int32), base=0)
    # The surface sets the size; inside it may grow. One thread: several make the same mesh, and wait for each other by spinning.
    mesh.GenerateVolumeMesh(maxh=3.0 * size, parallel_meshing=False, nthreads=1)
    # Both are views of memory that goes with the mesh.
    tetrahedra = np.array(mesh.Elements3D().NumPy()["nodes"][:, :4], np.int64) - 1
    return np.array(mesh.Coordinates()), tetrahedra


def ftetwild(vertices: Array, faces: Index, size: float, tolerance: float) -> tuple[Array, Index]:
    """Fill what a surface of any quality encloses, within the tolerance (fTetWild; Hu et al. 2020)."""
    # pytetwild imports pyvista only to add a method to it; nothing here needs a graphics library.
    sys.modules["pyvista"] = types.ModuleType("pyvista")
    import pytetwild

    diagonal = float(np.linalg.norm(np.ptp(vertices, axis=0)))
    points, tetrahedra = pytetwild.tetrahedralize(
        vertices,
        np.ascontiguousarray(faces, np.int32),
        edge_length_abs=1.5 * size,
        epsilon=tolerance / diagonal,
        stop_energy=20.0,
        num_threads=1,
        quiet=True,
    )[:2]
    return np.asarray(points), np.asarray(tetrahedra, np.int64)


METHODS = {"netgen": netgen, "fTetWild": ftetwild}


def mesh_file(method: str, source: str, target: str) -> None:
    """Read the surface, fill it, write the tetrahedra."""
    with np.load(source, allow_pickle=False) as data:
        points, tetrahedra = METHODS[method](data["vertices"], data["faces"], float(data["size"]), float(data["tolerance"]))
    np.savez(target, points=points, tetrahedra=tetrahedra)


if __name__ == "__main__":
    with suppress(ImportError):
        import resource

        most = resource.getrlimit(resource.RLIMIT_CPU)[1]  # of a batch queue, say
        seconds = int(sys.argv[4])
        resource.setrlimit(resource.RLIMIT_CPU, (seconds if most == resource.RLIM_INFINITY else min(seconds, most), most))
    mesh_file(*sys.argv[1:4])
