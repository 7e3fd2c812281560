"""Compliance of the wheel's elastic cover on a grid of pressure cells: finite thickness, finite width, real curvature.

The ring does not change with the angle, so the compliance is a convolution along x: one (cells, cells) matrix across the
width for each wave number, from `ocp.contact.wheel.annulus`. docs/wheel.md, eq. 2, 3.
"""

from dataclasses import asdict, dataclass, replace
from functools import cached_property
from typing import Protocol

import numpy as np
from scipy.fft import next_fast_len
from scipy.interpolate import CubicSpline

from ocp.contact.wheel.annulus import ring_section
from robots.errors import BadInput
from robots.pose import Array

PERIOD = 6.0  # length of the periodic sector in cover thicknesses: images weigh less than 0.1 % (docs/wheel.md)
N_WAVES = 28  # wave numbers at which finite elements are solved; between them a cubic spline
ALIASES = 3  # waves shorter than a cell that are kept, in sampling wave numbers
CELLS_A_RADIUS = 4.5
MAX_CELLS = 64  # across the width; more would take minutes to build a law, hard wide wheels get somewhat coarse cells


class Store(Protocol):
    """A content-addressed cache of arrays; the planner hands in `ocp.shell.cache`."""

    def load(self, key: str) -> dict[str, Array] | None:
        """Arrays stored under `key`, or None."""

    def store(self, key: str, arrays: dict[str, Array]) -> None:
        """Keep `arrays` under `key`."""


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

    @property
    def area(self) -> Array:
        """Cell areas (n_y, 1), m^2."""
        return self.dx * self.dy[:, None]

    def displace(self, force: Array) -> Array:
        """Radial displacement (n_y, n_x) m under cell forces (n_y, n_x) N."""
        waves = np.fft.rfft(force, axis=1).T[:, :, None]
        moved = np.matmul(self.spectrum, waves)[:, :, 0]
        return np.fft.irfft(moved.T, len(self.x), axis=1)

    def softer(self, modulus: float) -> "Cover":
        """The same cover with another modulus (Pa): compliance goes as 1/E."""
        ratio = self.geometry.modulus / modulus
        return replace(self, geometry=replace(self.geometry, modulus=modulus), spectrum=self.spectrum * ratio)


def default_cell(geometry: WheelGeometry, force: float, curvature: float | None = None) -> float:
    """Cell size (m): CELLS_A_RADIUS cells in the half-space contact radius under `force` N on `curvature` (default 2/R).

    Error of the indentation then below 1 % (docs/wheel.md, convergence).
    """
    modulus = geometry.modulus / (1 - geometry.poisson**2)
    radius = (0.75 * force / modulus / (curvature or 2 / geometry.radius)) ** (1 / 3)
    return float(np.clip(radius / CELLS_A_RADIUS, geometry.width / MAX_CELLS, geometry.cover_thickness / 4))


def build_cover(geometry: WheelGeometry, cell: float, store: Store | None = None, period: float = PERIOD) -> Cover:
    """Compliance of the cover with cells of about `cell` m; `period` is the sector's length in cover thicknesses."""
    edges = width_cells(geometry.width, cell)
    circumference = 2 * np.pi * geometry.radius
    sectors = max(1, int(circumference / max(period * geometry.cover_thickness, 2.0 * geometry.width)))
    length = circumference / sectors
    n_x = next_fast_len(int(np.ceil(length / cell)), real=True)
    dx = length / n_x
    key = f"cover 2 {asdict(replace(geometry, modulus=1.0))} cell {cell!r} period {period!r}"
    found = store.load(key) if store is not None else None
    if found is not None:
        spectrum = found["spectrum"]
    else:
        spectrum = _spectrum(geometry, edges, sectors, n_x, dx, cell)
        if store is not None:
            store.store(key, {"spectrum": spectrum})
    x = (np.arange(n_x) - n_x // 2) * dx
    y = 0.5 * (edges[1:] + edges[:-1])
    return Cover(geometry, x, y, dx, np.diff(edges), spectrum / geometry.modulus)


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
