"""Nodal weights of a Hertz pressure on an elliptical patch of the blade's surface.

p = p0 sqrt(1 - (x/a)^2 - (y/b)^2) (Johnson 1985, eq. 3.58), x along the feed t, y along b = n x t, both in the tangent
plane at the contact; the total is one newton. What the patch overhangs beyond an edge carries nothing.
"""

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_matrix
from scipy.spatial import cKDTree

from ocp.contact.blade.elasticity import QuadraticMesh, face_shape
from robots.errors import BadInput

Array = NDArray[np.float64]
Index = NDArray[np.int64]

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
        face = face[normal[face] @ n[k] > FACING] if len(face) else face
        b_axis = np.cross(n[k], t[k])
        frame = np.stack([t[k] / a, b_axis / b, n[k] / max(a, b)], axis=1)
        face = face[_touches(corner[face] - p[k], frame)] if len(face) else face
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


def _touches(corner: Array, frame: Array) -> NDArray[np.bool_]:
    """Tell which facets (k, 3, 3), relative to the contact, can meet the patch: its box in scaled axes."""
    local = corner @ frame
    return np.asarray(np.all((local.min(axis=1) < 1.0) & (local.max(axis=1) > -1.0), axis=1))


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
