"""The blade as a triangle mesh, and its elementary measures."""

import hashlib
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from robots.pose import Array

IntArray = NDArray[np.int64]


@dataclass(frozen=True)
class Blade:
    """A closed, outward oriented, trustworthy surface in the frame of its file.

    vertices (nv, 3) m; faces (nf, 3) indices, counter-clockwise seen from outside; notices say what was mended.
    """

    name: str
    sha256: str
    vertices: Array
    faces: IntArray
    notices: tuple[str, ...] = ()

    @property
    def content(self) -> str:
        """A name of all that is found in the blade and told of it."""
        told = repr((self.name, self.notices, self.vertices.shape, self.vertices.dtype.str, self.faces.dtype.str))
        parts = told.encode(), self.vertices.tobytes(), self.faces.tobytes()
        return hashlib.sha256(b"".join(parts)).hexdigest()


def area_vectors(vertices: Array, faces: IntArray) -> Array:
    """Facet normals scaled by the facet's area, (nf, 3) in the square of the vertices' unit."""
    a, b, c = (vertices[faces[:, i]] for i in range(3))
    return 0.5 * np.cross(b - a, c - a)


def facet_normals(vertices: Array, faces: IntArray) -> tuple[Array, Array]:
    """Unit normals (nf, 3), zero for facets without area, and areas (nf,)."""
    vectors = area_vectors(vertices, faces)
    areas = np.linalg.norm(vectors, axis=1)
    return vectors / np.where(areas > 0, areas, 1.0)[:, None], areas


def area_weighted_normals(blade: Blade) -> Array:
    """Normals (nv, 3) at the vertices, the facets' weighted by their areas."""
    normals, areas = facet_normals(blade.vertices, blade.faces)
    total = np.zeros_like(blade.vertices)
    for k in range(3):
        np.add.at(total, blade.faces[:, k], normals * areas[:, None])
    return np.asarray(total / np.maximum(np.linalg.norm(total, axis=1, keepdims=True), 1e-30))


def volume(vertices: Array, faces: IntArray) -> float:
    """Enclosed volume, positive when the facets look outward (divergence theorem)."""
    a, b, c = (vertices[faces[:, i]] - vertices.mean(axis=0) for i in range(3))
    return float(np.einsum("ij,ij->", a, np.cross(b, c)) / 6.0)


def directed_edges(faces: IntArray) -> IntArray:
    """The three directed edges of every facet, (3 nf, 2); rows i, i + nf, i + 2 nf belong to facet i."""
    return np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]])


def edge_keys(edges: IntArray, n_vertices: int) -> IntArray:
    """One integer per undirected edge, the same for (i, j) and (j, i), (n,)."""
    return edges.min(axis=1) * np.int64(n_vertices) + edges.max(axis=1)


def place_mm(point: Array) -> str:
    """A point (3,) m as text for messages, in mm."""
    return "(" + ", ".join(f"{1e3 * value:.2f}" for value in point) + ") mm"
