"""Semi-analytical finite elements of the elastic ring: radial give of its outer face under pressure waves.

Fourier in the angle, u_r = U cos(n theta), u_theta = V sin(n theta), u_z = W cos(n theta); quadratic elements (Q2) in
the (r, z) section, the volumetric strain projected on P1 per element, which is the Q2/P1 mixed method with the pressure
eliminated: stable up to the incompressible limit (Boffi, Brezzi, Fortin 2013, chapter 8). docs/wheel.md, eq. 1, 2.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import cho_solve_banded, cholesky_banded

from robots.pose import Array

Index = NDArray[np.int64]
GAUSS_X, GAUSS_W = np.polynomial.legendre.leggauss(3)
# Ratio of neighbouring element heights below the surface, and height of the topmost one in units of the cell.
GROWTH = 1.5
TOP_ELEMENT = 0.75


@dataclass(frozen=True)
class RingSection:
    """Stiffness of the ring's section, K(n) = K0 + n K1 + n^2 K2 in LAPACK's lower banded form, for a unit modulus.

    bands (3, m, dof); load (dof, cells): force of a unit pressure on one cell per radian and radius; width (cells,) m.
    """

    bands: Array
    load: Array
    width: Array
    radius: float

    def compliance(self, n: float) -> Array:
        """Mean radial displacement (cells, cells) [m] of cell i under the pressure cos(n theta) [unit modulus] on cell j."""
        factor = cholesky_banded(self.bands[0] + n * self.bands[1] + n * n * self.bands[2], lower=True)
        U = cho_solve_banded((factor, True), self.load)
        S = self.radius * (self.load.T @ U) / self.width[:, None]
        return np.asarray(S)


def ring_section(radius: float, thickness: float, edges: Array, poisson: float, cell: float) -> RingSection:
    """Section of a ring of outer `radius` bonded at `radius - thickness`, free elsewhere.

    `edges` (cells + 1,) m are the pressure cells across the width, one element each; `cell` m sets the height of the
    topmost elements. Lengths in m, modulus 1.
    """
    r_edges = radius - depth_grid(thickness, TOP_ELEMENT * cell)[::-1]
    n_r, n_z = 2 * len(r_edges) - 1, 2 * len(edges) - 1
    half = 3 * (2 * n_r + 3)
    dof = 3 * (n_r - 1) * n_z
    bands = np.zeros((3, half + 1, dof))
    load = np.zeros((dof, len(edges) - 1))
    mu, lam = 0.5 / (1 + poisson), poisson / ((1 + poisson) * (1 - 2 * poisson))
    for i in range(len(r_edges) - 1):
        # All elements of a layer differ only in their width, few widths are distinct.
        layer: dict[int, Array] = {}
        for j in range(len(edges) - 1):
            width = edges[j + 1] - edges[j]
            key = round(width * 1e9)
            if key not in layer:
                layer[key] = ring_element_stiffness(r_edges[i], r_edges[i + 1], width, mu, lam)
            index = _element_dofs(i, j, n_r)
            _add(bands, layer[key], index)
    for j in range(len(edges) - 1):
        top = _element_dofs(len(r_edges) - 2, j, n_r)[[6, 7, 8], 0]
        load[top, j] = np.array([1.0, 4.0, 1.0]) / 6 * (edges[j + 1] - edges[j])
    return RingSection(bands, load, np.diff(edges), radius)


def depth_grid(thickness: float, top: float) -> Array:
    """Element boundaries (m + 1,) from the surface, 0, to the bond: heights grow by GROWTH from `top`, at most h / 4."""
    heights: list[float] = []
    while sum(heights) < thickness:
        heights.append(min(top * GROWTH ** len(heights), thickness / 4))
    grid = np.concatenate([[0.0], np.cumsum(heights)])
    return grid * (thickness / grid[-1])


def ring_element_stiffness(r0: float, r1: float, width: float, mu: float, lam: float) -> Array:
    """K0, K1, K2 (3, 27, 27) of one Q2 element r0..r1 by `width`; dof = 3 node + component, node = 3 i_r + i_z."""
    half = np.array([0.5 * (r1 - r0), 0.5 * width])
    xi, eta = np.meshgrid(GAUSS_X, GAUSS_X, indexing="ij")
    weight = np.outer(GAUSS_W, GAUSS_W).ravel() * half.prod()
    r = (0.5 * (r0 + r1) + half[0] * xi).ravel()
    Nr, dNr = _lagrange(xi.ravel(), half[0])
    Nz, dNz = _lagrange(eta.ravel(), half[1])
    N = np.einsum("gi,gj->gij", Nr, Nz).reshape(-1, 9)
    N_r = np.einsum("gi,gj->gij", dNr, Nz).reshape(-1, 9)
    N_z = np.einsum("gi,gj->gij", Nr, dNz).reshape(-1, 9)
    w = weight * r
    over_r = N / r[:, None]
    # Strain rows rr, tt, zz, rz, rt, tz as B[0] + n B[1], each (gauss, 6, 9, 3).
    strain = np.zeros((2, len(r), 6, 9, 3))
    strain[0, :, 0, :, 0], strain[0, :, 1, :, 0], strain[1, :, 1, :, 1], strain[0, :, 2, :, 2] = N_r, over_r, over_r, N_z
    strain[0, :, 3, :, 0], strain[0, :, 3, :, 2] = N_z, N_r
    strain[1, :, 4, :, 0], strain[0, :, 4, :, 1] = -over_r, N_r - over_r
    strain[0, :, 5, :, 1], strain[1, :, 5, :, 2] = N_z, -over_r
    B = strain.reshape(2, len(r), 6, 27)
    shear = np.array([2.0, 2.0, 2.0, 1.0, 1.0, 1.0]) * mu
    div = B[:, :, :3].sum(2)
    P = np.column_stack([np.ones(9), xi.ravel(), eta.ravel()])
    project = P @ np.linalg.solve((P.T * w) @ P, P.T * w)
    div = np.einsum("gh,nhd->ngd", project, div)

    def product(a: int, b: int) -> Array:
        deviator = np.einsum("g,s,gsd,gse->de", w, shear, B[a], B[b], optimize=True)
        return np.asarray(deviator + lam * (div[a].T * w) @ div[b])

    return np.stack([product(0, 0), product(0, 1) + product(1, 0), product(1, 1)])


def _lagrange(x: Array, half: float) -> tuple[Array, Array]:
    """Quadratic shape functions (g, 3) at -1, 0, 1 and their derivatives per metre."""
    N = np.column_stack([0.5 * x * (x - 1), 1 - x * x, 0.5 * x * (x + 1)])
    return N, np.column_stack([x - 0.5, -2 * x, x + 0.5]) / half


def _element_dofs(i: int, j: int, n_r: int) -> Index:
    """Global dofs (9, 3) of element (i, j); r runs fastest, the bonded row is left out (negative)."""
    a, b = np.meshgrid(2 * i + np.arange(3), 2 * j + np.arange(3), indexing="ij")
    node = np.where(a > 0, (a - 1) + (n_r - 1) * b, -1).ravel()
    return np.where(node[:, None] >= 0, 3 * node[:, None] + np.arange(3), -1)


def _add(bands: Array, K: Array, index: Index) -> None:
    """Add an element to the lower bands in place (assembly of a fresh array)."""
    flat = index.ravel()
    row, col = np.meshgrid(flat, flat, indexing="ij")
    keep = (row >= col) & (col >= 0)
    for part, values in zip(bands, K, strict=True):
        np.add.at(part, (row[keep] - col[keep], col[keep]), values[keep])
