"""Compliance of the wheel's elastic cover on a grid of pressure cells: finite thickness, finite width, real curvature.

The ring does not change with the angle, so the compliance is a convolution along x: one (cells, cells) matrix across the
width for each wave number, from semi-analytical finite elements of the ring's section: the radial give of its outer face under
pressure waves. Fourier in the angle, u_r = U cos(n theta), u_theta = V sin(n theta), u_z = W cos(n theta); quadratic elements
(Q2) in the (r, z) section, the volumetric strain projected on P1 per element, which is the Q2/P1 mixed method with the pressure
eliminated: stable up to the incompressible limit (Boffi, Brezzi, Fortin 2013, chapter 8). docs/wheel.md, eq. 1 to 3.
"""

from dataclasses import asdict, dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy.fft import next_fast_len
from scipy.interpolate import CubicSpline
from scipy.linalg import cho_solve_banded, cholesky_banded

from ocp.shell.cache import content_key, remember
from robots.errors import BadInput
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


PERIOD = 6.0  # length of the periodic sector in cover thicknesses: images weigh less than 0.1 %
N_WAVES = 28  # wave numbers at which finite elements are solved; between them a cubic spline
ALIASES = 3  # waves shorter than a cell that are kept, in sampling wave numbers
VERSION = "wheel cover 2"  # raise it when the finite elements change
CELLS_A_RADIUS = 4.5
MAX_CELLS = 64  # across the width; more would take minutes to build a law, hard wide wheels get somewhat coarse cells


@dataclass(frozen=True)
class WheelGeometry:
    """Wheel with a rigid core: outer radius, width, cover thickness in m; modulus of the cover in Pa; Poisson's ratio."""

    radius: float
    width: float
    cover_thickness: float
    modulus: float
    poisson: float

    def __post_init__(self) -> None:
        if not 0 < self.cover_thickness < self.radius:
            raise BadInput(
                f"cover thickness {self.cover_thickness * 1e3:g} mm must lie between 0 and the wheel's radius "
                f"{self.radius * 1e3:g} mm"
            )
        if not 0 <= self.poisson <= 0.499:
            raise BadInput(f"Poisson's ratio {self.poisson:g} of the cover must lie between 0 and 0.499")
        if not (self.width > 0 and self.modulus > 0):
            raise BadInput("width and modulus of the wheel's cover must be positive")


@dataclass(frozen=True)
class Cover:
    """Compliance of a wheel's cover on cells y (n_y,) by x (n_x,), centred; x is arc length, periodic.

    spectrum (n_x // 2 + 1, n_y, n_y): discrete Fourier transform along x of the mean radial displacement [m] of cell i
    under a force [N] on cell j. Lengths m.
    """

    geometry: WheelGeometry
    x: Array
    y: Array
    dx: float
    dy: Array
    spectrum: Array

    @cached_property
    def kernel(self) -> Array:
        """Displacement (n_y, n_y, n_x) of cell (i, x + lag) under a unit force on cell (j, x), m/N."""
        return np.ascontiguousarray(np.fft.irfft(self.spectrum, len(self.x), axis=0).transpose(1, 2, 0))

    @cached_property
    def lagged(self) -> Array:
        """`kernel` (n_y, n_y, 2 n_x - 1) with the lags from 1 - n_x on."""
        return np.concatenate([self.kernel[..., :0:-1], self.kernel], axis=2)

    @property
    def area(self) -> Array:
        """Cell areas (n_y, 1), m^2."""
        return self.dx * self.dy[:, None]

    def displace(self, force: Array) -> Array:
        """Radial displacement (.., n_y, n_x) m under cell forces (.., n_y, n_x) N."""
        waves = np.fft.rfft(force, axis=-1).reshape(-1, len(self.y), len(self.spectrum))
        waves = np.ascontiguousarray(waves.transpose(2, 1, 0))
        moved = np.matmul(self.spectrum, waves.view(float))  # real and imaginary parts, one after the other
        return np.fft.irfft(moved.view(complex).transpose(2, 1, 0), len(self.x), axis=2).reshape(force.shape)

    def softer(self, modulus: float) -> "Cover":
        """The same cover with another modulus (Pa): compliance goes as 1/E."""
        ratio = self.geometry.modulus / modulus
        return replace(self, geometry=replace(self.geometry, modulus=modulus), spectrum=self.spectrum * ratio)


def default_cell(geometry: WheelGeometry, force: float) -> float:
    """Cell size (m): CELLS_A_RADIUS cells in the half-space contact radius under `force` N on the curvature 2/R.

    Error of the indentation then below 1 % (docs/wheel.md, convergence).
    """
    modulus = geometry.modulus / (1 - geometry.poisson**2)
    radius = (0.75 * force / modulus / (2 / geometry.radius)) ** (1 / 3)
    return float(np.clip(radius / CELLS_A_RADIUS, geometry.width / MAX_CELLS, geometry.cover_thickness / 4))


def build_cover(geometry: WheelGeometry, cell: float, period: float = PERIOD) -> Cover:
    """Compliance of the cover with cells of about `cell` m; `period` is the sector's length in cover thicknesses.

    Kept on disk for a unit modulus.
    """
    edges = width_cells(geometry.width, cell)
    circumference = 2 * np.pi * geometry.radius
    sectors = max(1, int(circumference / max(period * geometry.cover_thickness, 2.0 * geometry.width)))
    length = circumference / sectors
    n_x = next_fast_len(int(np.ceil(length / cell)), real=True)
    dx = length / n_x
    key = content_key(VERSION, repr(asdict(replace(geometry, modulus=1.0))), cell, period)
    spectrum = remember("cover", key, lambda: {"spectrum": _spectrum(geometry, edges, sectors, n_x, dx, cell)})["spectrum"]
    x = (np.arange(n_x) - n_x // 2) * dx
    y = 0.5 * (edges[1:] + edges[:-1])
    return Cover(geometry, x, y, dx, np.diff(edges), np.asarray(spectrum, float) / geometry.modulus)


def width_cells(width: float, cell: float) -> Array:
    """Cell boundaries (n + 1,) across the width: about `cell`, half of it at the two edges, where concave blades bear."""
    n = max(8, int(np.ceil(width / cell)))
    s = np.linspace(-1.0, 1.0, n + 1)
    graded = s + 0.15 * np.sin(np.pi * s)
    return 0.5 * width * graded


def _spectrum(geometry: WheelGeometry, edges: Array, sectors: int, n_x: int, dx: float, cell: float) -> Array:
    """`Cover.spectrum` for a unit modulus: waves that the grid cannot tell apart summed with the cells' averaging."""
    section = ring_section(geometry.radius, geometry.cover_thickness, edges, geometry.poisson, cell)
    q = np.arange(n_x // 2 + 1)
    top = sectors * n_x * (ALIASES + 0.5)
    scale = geometry.radius / geometry.cover_thickness
    nodes = scale * np.sinh(np.linspace(0.0, np.arcsinh(top / scale), N_WAVES))
    # S falls as 1/n; S times this is smooth and flat on the nodes' scale.
    values = np.stack([section.compliance(n) * np.hypot(1.0, n / scale) for n in nodes])
    spline = CubicSpline(np.arcsinh(nodes / scale), values)
    area = dx * np.diff(edges)
    total = np.zeros((len(q), len(area), len(area)))
    for alias in range(-ALIASES, ALIASES + 1):
        n = np.abs(sectors * (q + alias * n_x)).astype(float)
        mean = np.sinc(n * dx / (2 * np.pi * geometry.radius)) ** 2
        S = spline(np.arcsinh(n / scale)) / np.hypot(1.0, n / scale)[:, None, None]
        total += mean[:, None, None] * S
    total /= area
    return 0.5 * (total + total.transpose(0, 2, 1))
