"""The cover as a compliance between pressure cells on its surface, waves around the wheel and spectral elements across it; and
its contact with a rigid surface.

The compliance is a convolution along the belt, full across the width. The waves are added around the whole wheel, so there are no
periodic images but the wheel's own; the convolution is done by padded Fourier transforms for many loads at once
(docs/virtual_grinding.md, eq. 3). Modulus 1: lengths are right when cell forces are given as force over modulus, m^2.

The cover is a ring: bonded to the core at its inner radius, loaded at the outer one, both side faces free. Displacements
u_r = U(r, y) cos n theta, u_theta = V sin n theta, u_y = W cos n theta; the energy is a quadratic form in (U, V, W) and its
matrix a sum of Kronecker products of one-dimensional matrices in r and y (docs/virtual_grinding.md, eq. 2). Lagrange
polynomials of degree 4 across the width and 5 through the thickness, integrated in full: no locking at such degrees.

The contact: find cell forces f >= 0 that carry a given force and close the gap where they are not zero,
min 1/2 f C f + g f with sum f cos(angle) = F. Conjugate gradients on the cells in contact, many problems side by side, restarted
when cells join (Polonsky and Keer 1999, Wear 231, 206-219). A motion of the wheel by d toward the blade closes the gap by
d cos(angle); dividing by that cosine brings back the plain form.
"""

from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.polynomial.legendre import Legendre, leggauss
from numpy.typing import NDArray
from scipy.fft import irfft, next_fast_len, rfft
from scipy.interpolate import CubicSpline
from scipy.linalg import solveh_banded
from scipy.sparse import coo_matrix, csr_matrix, kron

from robots.pose import Array

DEGREE_Y, DEGREE_R = 4, 5
CELLS_PER_ELEMENT = 2
FINEST_LAYER, GROWTH = 1.6, 2.6  # thickness of the outermost element in cells, and how much each below is thicker


@dataclass(frozen=True)
class LineElements:
    """One-dimensional elements: `value` and `slope` (points, nodes) of the nodal polynomials at the integration points, whose
    places and weights are (points,)."""

    place: Array
    weight: Array
    value: Array
    slope: Array

    def matrix(self, left: Array, right: Array, factor: Array | float = 1.0) -> csr_matrix:
        """Integral of left_i right_j times a factor at the integration points."""
        return csr_matrix(left.T @ ((self.weight * factor)[:, None] * right))


def _to_nodes(degree: int) -> Array:
    """Polynomials on Gauss-Lobatto nodes from powers (degree + 1, degree + 1), the highest power first."""
    nodes = np.concatenate([[-1.0], np.sort(Legendre.basis(degree).deriv().roots().real), [1.0]])
    return np.linalg.inv(np.vander(nodes, degree + 1))


def elements(breaks: Array, degree: int) -> LineElements:
    """Continuous Lagrange polynomials on Gauss-Lobatto nodes between `breaks` (k+1,), degree + 2 Gauss points an element."""
    points, weights = leggauss(degree + 2)
    to_nodes = _to_nodes(degree)
    powers = np.arange(degree, -1, -1)
    value = np.vander(points, degree + 1) @ to_nodes
    lowered = np.where(powers > 0, powers * points[:, None] ** np.maximum(powers - 1, 0), 0.0)
    slope = lowered @ to_nodes
    count = len(breaks) - 1
    shape = (count * len(points), count * degree + 1)
    all_values, all_slopes = np.zeros(shape), np.zeros(shape)
    a, b = breaks[:-1, None], breaks[1:, None]
    places, all_weights = 0.5 * (a + b) + 0.5 * (b - a) * points, 0.5 * (b - a) * weights
    for k, size in enumerate(np.diff(breaks)):
        rows, columns = slice(k * len(points), (k + 1) * len(points)), slice(k * degree, k * degree + degree + 1)
        all_values[rows, columns], all_slopes[rows, columns] = value, slope * 2.0 / size
    return LineElements(places.ravel(), all_weights.ravel(), all_values, all_slopes)


@dataclass(frozen=True)
class CoverSection:
    """Stiffness K0 + n K1 + n^2 K2 of the section per unit modulus, as lower bands (bandwidth + 1, unknowns), and the loads of
    the pressure cells (unknowns, cells): integral of the radial polynomials over each cell at the outer radius, m."""

    bands: tuple[Array, Array, Array]
    cells: Array
    radius: float
    cell: float

    def response(self, n: float) -> Array:
        """Mean radial displacement of cell i under a unit pressure wave on cell j, (cells, cells) m/Pa times the modulus."""
        bands = self.bands[0] + n * self.bands[1] + n * n * self.bands[2]
        moved = solveh_banded(bands, self.cells, lower=True, check_finite=False)
        answer = self.radius / self.cell * (self.cells.T @ moved)
        return np.asarray(0.5 * (answer + answer.T))


def cover_section(radius: float, width: float, thickness: float, poisson: float, cells: int) -> CoverSection:
    """Section of a cover of the given outer radius, width and thickness in m, with an even number of cells across the width."""
    cell = width / cells
    depth = [0.0]
    layer = FINEST_LAYER * cell
    while depth[-1] + 1.5 * layer < thickness:
        depth.append(depth[-1] + layer)
        layer *= GROWTH
    depth.append(thickness)
    r = elements(radius - np.array(depth[::-1]), DEGREE_R)
    y = elements(np.linspace(-width / 2, width / 2, cells // CELLS_PER_ELEMENT + 1), DEGREE_Y)
    r = LineElements(r.place, r.weight, r.value[:, 1:], r.slope[:, 1:])  # bonded: the innermost node does not move
    parts = _stiffness(r, y, poisson)
    loads = np.zeros((y.value.shape[1], r.value.shape[1], 3, cells))
    loads[:, -1, 0, :] = _cell_loads(y, width, cells)
    return CoverSection((parts[0], parts[1], parts[2]), loads.reshape(-1, cells), radius, cell)


def _cell_loads(y: LineElements, width: float, cells: int) -> Array:
    """Integral over each cell of the polynomials across the width (nodes, cells), exactly: Gauss points inside each cell."""
    points, weights = leggauss(DEGREE_Y)
    edges = np.linspace(-width / 2, width / 2, cells + 1)
    breaks = edges[::CELLS_PER_ELEMENT]
    to_nodes = _to_nodes(DEGREE_Y)
    loads = np.zeros((y.value.shape[1], cells))
    for j in range(cells):
        k = j // CELLS_PER_ELEMENT
        place = 0.5 * (edges[j] + edges[j + 1]) + 0.5 * (edges[j + 1] - edges[j]) * points
        local = 2.0 * (place - breaks[k]) / (breaks[k + 1] - breaks[k]) - 1.0
        values = np.vander(local, DEGREE_Y + 1) @ to_nodes
        loads[k * DEGREE_Y : k * DEGREE_Y + DEGREE_Y + 1, j] += 0.5 * (edges[j + 1] - edges[j]) * weights @ values
    return loads


def _stiffness(r: LineElements, y: LineElements, poisson: float) -> list[Array]:
    """Lower bands of K0, K1, K2 for modulus 1; unknowns in the order y, r, component."""
    lam = poisson / ((1 + poisson) * (1 - 2 * poisson))
    mu = 0.5 / (1 + poisson)
    a = lam + 2 * mu
    R = r.place
    M, A, G = y.matrix(y.value, y.value), y.matrix(y.slope, y.slope), y.matrix(y.value, y.slope)
    vv = {k: r.matrix(r.value, r.value, R**k) for k in (-1, 0, 1)}
    dd, dv = r.matrix(r.slope, r.slope, R), r.matrix(r.slope, r.value)
    rdv = r.matrix(r.slope, r.value, R)
    both = dv + dv.T
    zero = csr_matrix(kron(M, vv[0]).shape)

    def grid(across: csr_matrix, through: csr_matrix) -> csr_matrix:
        return csr_matrix(kron(across, through, format="csr"))

    # Blocks U, V, W of twice the energy per unit angle: a tr(e)^2-like terms, docs/virtual_grinding.md eq. 2.
    UU = [grid(M, a * (dd + vv[-1]) + lam * both) + grid(A, mu * vv[1]), zero, grid(M, mu * vv[-1])]
    VV = [grid(M, mu * (dd - both + vv[-1])) + grid(A, mu * vv[1]), zero, grid(M, a * vv[-1])]
    WW = [grid(A, a * vv[1]) + grid(M, mu * dd), zero, grid(M, mu * vv[-1])]
    UV = [zero, grid(M, lam * dv + a * vv[-1] - mu * (dv.T - vv[-1])), zero]
    UW = [grid(G, lam * (rdv + vv[0])) + grid(G.T, mu * rdv.T), zero, zero]
    VW = [zero, grid(G, lam * vv[0]) - grid(G.T, mu * vv[0]), zero]
    width = 3 * (DEGREE_Y * r.value.shape[1] + DEGREE_R) + 3
    return [_bands([[UU[k], UV[k], UW[k]], [UV[k].T, VV[k], VW[k]], [UW[k].T, VW[k].T, WW[k]]], width) for k in range(3)]


def _bands(blocks: list[list[csr_matrix]], width: int) -> Array:
    """Lower bands of the symmetric matrix of 3 x 3 blocks, the three components of a node side by side."""
    rows, columns, values = [], [], []
    for i in range(3):
        for j in range(3):
            block = coo_matrix(blocks[i][j])
            lower = 3 * block.row + i >= 3 * block.col + j
            rows.append((3 * block.row + i)[lower])
            columns.append((3 * block.col + j)[lower])
            values.append(block.data[lower])
    row, column, value = np.concatenate(rows), np.concatenate(columns), np.concatenate(values)
    bands = np.zeros((width, 3 * blocks[0][0].shape[0]))
    np.add.at(bands, (row - column, column), value)
    return bands


WAVES = 26  # sections solved
BEYOND = 4.0  # waves are added up to this multiple of the shortest the cells tell apart; the rest is 0.1 % of a cell's own give
CELLS_PER_PATCH = 6.0  # cells a half-length of a patch
CELLS_ACROSS = (12, 44)
REFERENCE_CURVATURE = 15.0  # 1/m: a moderately rounded blade sets the cells' size


@dataclass(frozen=True)
class Grid:
    """Cells on the cover: x (nx,) along the belt from the contact, y (ny,) across from the wheel's middle, sizes dx, dy in m."""

    x: Array
    y: Array
    dx: float
    dy: float


@dataclass(frozen=True)
class Rubber:
    """Compliance of the cover's surface on a grid.

    transfer (waves, ny, ny) acts on transforms along x padded to the length `padded`, m/m^2 for cell forces over modulus; own:
    compliance of one cell in the middle; cosine (nx,): of the wheel's angle at the cells.
    """

    radius: float
    width: float
    thickness: float
    grid: Grid
    transfer: NDArray[np.float32]
    own: float
    padded: int
    cosine: Array

    def displace(self, forces: NDArray[Any]) -> NDArray[Any]:
        """Radial displacement (nx, ny, k) m of the cells under cell forces over modulus (nx, ny, k)."""
        count = forces.shape[2]
        waves = rfft(forces, self.padded, axis=0)
        moved = self.transfer @ np.concatenate([waves.real, waves.imag], axis=2)
        answer = np.empty(waves.shape, waves.dtype)
        answer.real, answer.imag = moved[..., :count], moved[..., count:]
        return np.asarray(irfft(answer, self.padded, axis=0)[: forces.shape[0]])


def cell_size(radius: float, width: float, modulus: float, poisson: float, force: float) -> float:
    """Size of the cells, m: a share of the patch that `force` N makes on a half-space (Hertz), within bounds across the width."""
    plane = modulus / (1 - poisson**2)
    patch = (0.75 * force / plane / np.sqrt((1 / radius) * (1 / radius + REFERENCE_CURVATURE))) ** (1 / 3)
    across = np.clip(width * CELLS_PER_PATCH / patch, *CELLS_ACROSS)
    return float(width / (2 * np.round(across / 2)))


@lru_cache(maxsize=8)
def make_rubber(radius: float, width: float, thickness: float, poisson: float, cell: float, reach: float) -> Rubber:
    """The cover on cells of about `cell` m, `reach` m to both sides of the contact along the belt."""
    across = max(2 * round(width / cell / 2), 2)
    dy = width / across
    along, dx = 2 * int(np.ceil(reach / cell)), cell
    section = cover_section(radius, width, thickness, poisson, across)
    last = 2 * np.pi * radius / dx
    n = np.concatenate([[0.0], np.geomspace(0.35, last, WAVES - 1)])
    answers = np.array([section.response(k) for k in n])
    scale = np.sqrt(1 + (n * thickness / radius) ** 2)
    spline = CubicSpline(np.arcsinh(n * thickness / radius), answers * scale[:, None, None])
    whole = np.arange(0, int(BEYOND * np.pi * radius / dx) + 1, dtype=float)
    inside = np.minimum(whole, last)
    waves = spline(np.arcsinh(inside * thickness / radius)) / np.sqrt(1 + (whole * thickness / radius) ** 2)[:, None, None]
    weight = np.where(whole > 0, 2.0, 1.0) * np.sinc(whole * dx / (2 * np.pi * radius)) ** 2 / (dy * 2 * np.pi * radius)
    lags = np.arange(along)
    around = np.cos(np.outer(lags * dx / radius, whole)) * weight
    kernel = np.tensordot(around, waves, axes=1)  # (lags, ny, ny)
    padded = next_fast_len(2 * along, real=True)
    wrapped = np.zeros((padded, across, across))
    wrapped[:along] = kernel
    wrapped[padded - along + 1 :] = kernel[:0:-1]
    transfer = np.ascontiguousarray(rfft(wrapped, axis=0).real, np.float32)
    x = np.asarray((np.arange(along) - 0.5 * (along - 1)) * dx)
    grid = Grid(x, np.asarray((np.arange(across) + 0.5) * dy - width / 2), dx, dy)
    own = float(kernel[0, across // 2, across // 2])
    return Rubber(radius, width, thickness, grid, transfer, own, padded, np.cos(x / radius))


STEPS = 250
TOLERANCE = 2e-4  # rms opening on the cells in contact over the approach: the approach itself is then right to the square
CHECK = 4  # steps between looks for problems that are done


@dataclass(frozen=True)
class Patches:
    """Solved contacts k: approach (k,) m, cell forces over modulus times cosine (nx, ny, k), residual (k,) opening on the cells
    in contact over the approach's range (rms)."""

    approach: Array
    forces: Array
    residual: Array


def press(rubber: Rubber, gap: Array, load: Array, start: Array | None = None) -> Patches:
    """Contacts for gaps (nx, ny, k) m, inf where there is no blade, under loads (k,) of force over modulus, m^2.

    `start` (nx, ny, k): cell forces of a similar contact. Every gap must be finite somewhere.
    """
    # Single precision: half the time, and its rounding is a thousandth of TOLERANCE.
    cosine = rubber.cosine[:, None, None].astype(np.float32)
    there = np.isfinite(gap)
    open_gap = np.where(there, gap, 1.0).astype(np.float32) / cosine
    load = load.astype(np.float32)
    count = gap.shape[2]
    f = _guess(rubber, open_gap, there, load)
    if start is not None:
        known = np.where(there, start, 0.0)
        total = known.sum(axis=(0, 1))
        f = np.where(total > 0, known * (load / np.where(total > 0, total, 1.0)), f)
    f = f.astype(np.float32)
    forces, approach, residual = np.zeros(f.shape), np.zeros(count), np.full(count, np.inf)
    todo = np.arange(count)
    direction = np.zeros_like(f)
    squared, keep = np.ones(count, np.float32), np.zeros(count, np.float32)
    for step in range(STEPS + 1):
        opening = rubber.displace(f / cosine) / cosine + open_gap
        touching = f > 0
        number = touching.sum(axis=(0, 1)).astype(np.float32)
        level = (opening * touching).sum(axis=(0, 1)) / number
        opening -= level
        fresh = ((opening * touching) ** 2).sum(axis=(0, 1))
        if step % CHECK == 0 or step == STEPS:
            lowest = np.where(there, opening, 0.0).min(axis=(0, 1))
            size = level - np.where(there, open_gap, np.inf).min(axis=(0, 1))
            off = np.maximum(np.sqrt(fresh / number), -0.3 * lowest) / size
            done = (off < TOLERANCE) | (step == STEPS)
            if done.any():
                at = todo[done]
                forces[:, :, at], residual[at] = f[:, :, done], off[done]
                approach[at] = level[done] + (opening * f)[:, :, done].sum(axis=(0, 1)) / load[done]
                left = ~done
                todo, load, squared, keep, fresh = todo[left], load[left], squared[left], keep[left], fresh[left]
                f, direction, opening = f[:, :, left], direction[:, :, left], opening[:, :, left]
                open_gap, there, touching, number = open_gap[:, :, left], there[:, :, left], touching[:, :, left], number[left]
                if not len(todo):
                    break
        # A single cell in contact has no direction to search; a step of its own compliance lets its neighbours in.
        again = keep * fresh / np.where(squared > 0, squared, 1.0)
        direction = np.where(touching, opening + again * direction, 0.0).astype(np.float32)
        squared = fresh
        answer = rubber.displace(direction / cosine) / cosine
        answer -= (answer * touching).sum(axis=(0, 1)) / number
        along = (answer * direction).sum(axis=(0, 1))
        length = (opening * direction).sum(axis=(0, 1)) / np.where(along > 0, along, 1.0)
        length = np.where(number > 1, length, 1.0 / rubber.own).astype(np.float32)
        f = np.maximum(f - length * direction, 0.0)
        joining = there & (f == 0) & (opening < 0)
        keep = np.where(joining.any(axis=(0, 1)), 0.0, 1.0).astype(np.float32)
        f = np.where(joining, -length * opening, f)
        f *= load / f.sum(axis=(0, 1))
    return Patches(approach, forces, residual)


def _guess(rubber: Rubber, gap: NDArray[Any], there: NDArray[Any], load: NDArray[Any]) -> NDArray[Any]:
    """Forces (nx, ny, k) of a Winkler bed of the cover that carry the loads: pressure rises with the depth under a level."""
    nx, ny, count = gap.shape
    bed = rubber.grid.dx * rubber.grid.dy / rubber.thickness
    flat = np.sort(np.where(there, gap, np.inf).reshape(nx * ny, count), axis=0)
    finite = np.where(np.isfinite(flat), flat, 0.0)
    rank = np.arange(1, nx * ny + 1)[:, None]
    carried = bed * (finite * rank - np.cumsum(finite, axis=0))
    enough = (carried < load) & np.isfinite(flat)
    cells = np.maximum(enough.sum(axis=0), 1)
    total = np.cumsum(finite, axis=0)[cells - 1, np.arange(count)]
    level = (load / bed + total) / cells
    f = np.where(there, np.maximum(level - gap, 0.0), 0.0)
    return np.asarray(f * load / f.sum(axis=(0, 1)))
