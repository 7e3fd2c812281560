"""The cover as a compliance between pressure cells on its surface: a convolution along the belt, full across the width.

The waves of `section.py` are added around the whole wheel, so there are no periodic images but the wheel's own; the
convolution is done by padded Fourier transforms for many loads at once (docs/virtual_grinding.md, eq. 3). Modulus 1: lengths
are right when cell forces are given as force over modulus, m^2.
"""

from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.fft import irfft, next_fast_len, rfft
from scipy.interpolate import CubicSpline

from ocp.simulate.twin.contact.section import ring_section
from robots.pose import Array

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
    along = 2 * int(np.ceil(reach / cell))
    dx = cell
    section = ring_section(radius, width, thickness, poisson, across)
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
    x = (np.arange(along) - 0.5 * (along - 1)) * dx
    y = (np.arange(across) + 0.5) * dy - width / 2
    grid = Grid(np.asarray(x, np.float64), np.asarray(y, np.float64), dx, dy)
    own = float(kernel[0, across // 2, across // 2])
    return Rubber(radius, width, thickness, grid, transfer, own, padded, np.cos(x / radius))
