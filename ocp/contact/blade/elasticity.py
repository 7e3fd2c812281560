"""Linear elasticity on ten-node tetrahedra: shape functions, element stiffness, consistent face loads of a contact patch.

The numbering of an element is that of CalculiX's C3D10: four corners, then the middles of the edges in
`EDGES`. Stiffness is integrated with the four-point rule of degree two (Hammer and Stroud 1956), exact for
straight edges, so that both codes integrate the same element (Zienkiewicz, Taylor and Zhu 2013, ch. 6).

A contact patch is elliptical and carries a Hertz pressure, p = p0 sqrt(1 - (x/a)^2 - (y/b)^2) (Johnson 1985, eq. 3.58), x along
the feed t, y along b = n x t, both in the tangent plane at the contact; the total is one newton. What the patch overhangs beyond
an edge carries nothing.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_matrix
from scipy.spatial import cKDTree

from robots.errors import BadInput

Array = NDArray[np.float64]
Index = NDArray[np.int64]

EDGES = np.array([[0, 1], [1, 2], [0, 2], [0, 3], [1, 3], [2, 3]])
# Outward faces: three corners, then the middles between corner 1-2, 2-3, 3-1 of the face.
FACES = np.array([[0, 2, 1, 6, 5, 4], [0, 1, 3, 4, 8, 7], [1, 2, 3, 5, 9, 8], [0, 3, 2, 7, 9, 6]])

_A, _B = 0.5854101966249685, 0.1381966011250105  # (5 + 3 sqrt 5)/20 and (5 - sqrt 5)/20
QUADRATURE = np.full((4, 4), _B) + (_A - _B) * np.eye(4)  # barycentric points of equal weight 1/4


@dataclass(frozen=True)
class Material:
    """Isotropic material: Young's modulus in Pa, Poisson's ratio, density in kg/m^3."""

    youngs_modulus: float = 114e9  # Ti-6Al-4V, annealed
    poisson_ratio: float = 0.34
    density: float = 4430.0

    @property
    def lame(self) -> tuple[float, float]:
        """Lame's constants lambda, mu in Pa."""
        e, nu = self.youngs_modulus, self.poisson_ratio
        return e * nu / ((1.0 + nu) * (1.0 - 2.0 * nu)), e / (2.0 * (1.0 + nu))


@dataclass(frozen=True)
class QuadraticMesh:
    """A solid in ten-node tetrahedra: nodes (nn, 3) in m, elements (ne, 10), surface (nf, 6) outward."""

    nodes: Array
    elements: Index
    surface: Index

    @property
    def volume(self) -> float:
        """Volume in m^3 of the straight-sided solid."""
        return float(np.sum(tetra_volumes(self.nodes, self.elements)))


def tetra_volumes(points: Array, tetrahedra: Index) -> Array:
    """Signed volumes (ne,) in m^3 from the first four columns of `tetrahedra`."""
    corner = points[tetrahedra[:, :4]]
    return np.asarray(np.linalg.det(corner[:, 1:] - corner[:, :1]) / 6.0)


def tetra_edges(tetrahedra: Index) -> tuple[Index, Index, Index]:
    """The two ends of every edge once, the smaller number first, and which of them the edges of the tetrahedra are (6 ne,)."""
    ends = np.sort(tetrahedra[:, EDGES].reshape(-1, 2), axis=1)
    count = int(tetrahedra.max()) + 1
    key, which = np.unique(ends[:, 0] * count + ends[:, 1], return_inverse=True)
    low, high = np.divmod(key, count)
    return low, high, which


def quadratic_mesh(points: Array, tetrahedra: Index) -> QuadraticMesh:
    """Make ten-node tetrahedra with straight edges from corners (nv, 3) and four-node tetrahedra (ne, 4)."""
    turned = tetra_volumes(points, tetrahedra) < 0.0
    corners = np.where(turned[:, None], tetrahedra[:, [1, 0, 2, 3]], tetrahedra)
    used, corners = np.unique(corners, return_inverse=True)
    points, corners = points[used], corners.reshape(-1, 4)
    first, second, middle = tetra_edges(corners)
    nodes = np.vstack([points, 0.5 * (points[first] + points[second])])
    elements = np.hstack([corners, len(points) + middle.reshape(-1, 6)]).astype(np.int64)
    faces = elements[:, FACES].reshape(-1, 6)
    _, index, count = np.unique(np.sort(faces[:, :3], axis=1), axis=0, return_index=True, return_counts=True)
    return QuadraticMesh(nodes, elements, faces[np.sort(index[count == 1])])


def shape_gradients(barycentric: Array) -> Array:
    """Gradients (..., 10, 4) of the ten shape functions in the four barycentric coordinates (..., 4).

    Corners L (2 L - 1), middles 4 L_i L_j (Zienkiewicz, Taylor and Zhu 2013, eq. 6.43).
    """
    gradient = np.zeros((*barycentric.shape[:-1], 10, 4))
    for i in range(4):
        gradient[..., i, i] = 4.0 * barycentric[..., i] - 1.0
    for row, (i, j) in enumerate(EDGES, start=4):
        gradient[..., row, i] = 4.0 * barycentric[..., j]
        gradient[..., row, j] = 4.0 * barycentric[..., i]
    return gradient


_REFERENCE = shape_gradients(QUADRATURE)
_REFERENCE = _REFERENCE[..., 1:] - _REFERENCE[..., :1]  # (4, 10, 3): derivatives in L2, L3, L4 with L1 = 1 - ...


def element_stiffness(corners: Array, material: Material) -> Array:
    """Stiffness (ne, 30, 30) in N/m of elements with node positions (ne, 10, 3), node by node x, y, z.

    K_ab = integral of lambda ga gb^T + mu gb ga^T + mu (ga . gb) I (Hughes 2000, eq. 2.7).
    """
    lame, shear = material.lame
    jacobian = np.einsum("qad,eai->eqid", _REFERENCE, corners)
    # In 1/m (ne, 4, 10, 3) at the quadrature points, whose weights (ne, 4) are in m^3.
    gradient, weight = _REFERENCE @ np.linalg.inv(jacobian), np.linalg.det(jacobian) / 24.0
    count = len(corners)
    flat = gradient.reshape(count, 4, 30)
    outer = (np.swapaxes(flat * weight[..., None], 1, 2) @ flat).reshape(count, 10, 3, 10, 3)
    stiffness = lame * outer + shear * np.swapaxes(outer, 2, 4)
    trace = shear * np.einsum("eaibi->eab", outer)
    for i in range(3):
        stiffness[:, :, i, :, i] += trace
    return stiffness.reshape(count, 30, 30)


def face_shape(barycentric: Array) -> Array:
    """Six shape functions (nq, 6) of a face at barycentric points (nq, 3): corners, then middles 12, 23, 31."""
    l1, l2, l3 = barycentric.T
    corner = [l * (2.0 * l - 1.0) for l in (l1, l2, l3)]
    return np.stack([*corner, 4.0 * l1 * l2, 4.0 * l2 * l3, 4.0 * l3 * l1], axis=1)


FACING = 0.5  # least cosine between a facet's normal and the contact's: the surface that turns by less than 60 deg
POINTS_PER_AXIS = 10.0  # quadrature points over the shorter semi-axis; weights are then sound to 0.2 %


def patch_weights(mesh: QuadraticMesh, p: Array, n: Array, t: Array, semi_axes: tuple[float, float]) -> csr_matrix:
    """Return weights (m, nn), rows of sum 1: pressure-weighted mean over patch k of any nodal field u is w[k] @ u.

    The same weights are the consistent nodal loads of a unit force spread over the patch.

    Args:
        mesh: the solid.
        p: (m, 3) m contact points on its surface.
        n: (m, 3) outward unit normals.
        t: (m, 3) unit tangents; the semi-axis semi_axes[0] lies along them.
        semi_axes: (a, b) in m.

    Raises:
        BadInput: a patch finds no surface that faces it.
    """
    a, b = semi_axes
    corner = mesh.nodes[mesh.surface[:, :3]]
    centre = corner.mean(axis=1)
    reach = np.linalg.norm(corner - centre[:, None], axis=2).max()
    area = 0.5 * np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0])
    normal = area / np.linalg.norm(area, axis=1)[:, None]
    near = cKDTree(centre).query_ball_point(p, max(a, b) * 1.5 + reach)
    rows, columns, values = [], [], []
    for k, candidates in enumerate(near):
        face = np.array(candidates, np.int64)
        face = face[normal[face] @ n[k] > FACING]
        b_axis = np.cross(n[k], t[k])
        frame = np.stack([t[k] / a, b_axis / b, n[k] / max(a, b)], axis=1)
        local = (corner[face] - p[k]) @ frame  # facets that can meet the patch: its box in scaled axes
        face = face[np.all((local.min(axis=1) < 1.0) & (local.max(axis=1) > -1.0), axis=1)]
        weights = _face_weights(corner[face] - p[k], area[face] @ n[k], frame, min(a, b)) if len(face) else np.zeros((0, 6))
        total = weights.sum()
        if total <= 0.0:
            at = ", ".join(f"{x * 1e3:.2f}" for x in p[k])
            raise BadInput(
                f"the contact patch at ({at}) mm finds no blade surface that faces it; "
                "check that the waypoints were made from this blade"
            )
        rows.append(np.full(weights.size, k))
        columns.append(mesh.surface[face].ravel())
        values.append(weights.ravel() / total)
    return csr_matrix((np.concatenate(values), (np.concatenate(rows), np.concatenate(columns))), shape=(len(p), len(mesh.nodes)))


def patch_loads(weights: csr_matrix) -> csr_matrix:
    """Return nodal forces (3 nn, 3 m) in N of unit forces along x, y, z on each of m patches."""
    coo = weights.tocoo()
    rows = (3 * coo.col[:, None] + np.arange(3)).ravel()
    columns = (3 * coo.row[:, None] + np.arange(3)).ravel()
    return csr_matrix((np.repeat(coo.data, 3), (rows, columns)), shape=(3 * weights.shape[1], 3 * weights.shape[0]))


def _face_weights(corner: Array, area: Array, frame: Array, shortest: float) -> Array:
    """Integrate pressure times shape functions over facets (k, 3, 3): weights (k, 6), not normalised.

    The pressure ends with a vertical slope at the rim of the patch, so facets are cut into small triangles and
    the middle point of each is used.
    """
    longest = np.linalg.norm(corner - np.roll(corner, 1, axis=1), axis=2).max()
    points = _subdivision(int(np.clip(np.ceil(POINTS_PER_AXIS * longest / shortest), 4, 40)))
    x, y, z = np.moveaxis((points @ corner) @ frame, 2, 0)
    pressure = np.sqrt(np.maximum(1.0 - x * x - y * y, 0.0)) * (np.abs(z) < 1.0)
    return np.asarray((pressure * area[:, None]) @ face_shape(points) / len(points))


def _subdivision(parts: int) -> Array:
    """Barycentric centres (parts^2, 3) of a triangle cut into parts^2 equal triangles."""
    i, j = np.meshgrid(np.arange(parts), np.arange(parts), indexing="ij")
    up = np.stack([i, j], 2)[i + j < parts] + 1.0 / 3.0
    down = np.stack([i, j], 2)[i + j < parts - 1] + 2.0 / 3.0
    first = np.concatenate([up, down]) / parts
    return np.column_stack([first, 1.0 - first.sum(axis=1)])
