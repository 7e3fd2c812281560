"""A pass on a round bar, a wheel law in closed form: small, exact problems for the tests of model and optimiser."""

from dataclasses import dataclass, field, replace

import casadi as ca
import numpy as np

from ocp.data import CELL
from ocp.model.cell import Cell, read_cell
from ocp.model.cell_schema import FloorTable
from trajectories.passes import BladePath


@dataclass(frozen=True)
class LineLaw:
    """d = c F^(2/3) sqrt-free of shape but for the exact tilt along the belt; enough to exercise every argument."""

    limits: dict = field(default_factory=lambda: {"kxx": (1.0, 1e4), "tilt_y": (-0.05, 0.05)})

    def indentation(self, F, kxx, kyy, kxy, lateral, tilt_x, tilt_y):
        shape = 1 + 1e-3 * kyy + 1e-5 * kxy**2 + 20.0 * lateral**2 + tilt_y**2
        return 5e-5 * ca.exp(2 / 3 * ca.log(F)) * shape - 0.5 * tilt_x**2 / kxx

    def evaluate(self, F, kxx, kyy, kxy, lateral, tilt_x, tilt_y):
        return 5e-5 * F ** (2 / 3) * (1 + 1e-3 * kyy + 1e-5 * kxy**2) + 0 * kxx


def bundled_cell() -> Cell:
    return read_cell(CELL)


def with_floor(cell: Cell, height_mm: float) -> Cell:
    """The cell with a floor so high above its base."""
    return replace(cell, tables=cell.tables.model_copy(update={"floor": FloorTable(z_mm=height_mm)}))


def bar_pass(n: int = 40, radius: float = 0.04, length: float = 0.06, force: float = 20.0, feed: float = 0.04) -> BladePath:
    """Along z on a bar of `radius` about the blade's z axis, at its +y side, from z = 30 mm on."""
    z = 0.03 + np.linspace(0.0, length, n)
    ones = np.ones(n)
    return BladePath(
        line=1,
        side="convex",
        p=np.column_stack([0 * z, radius * ones, z]),
        n=np.tile([0.0, 1.0, 0.0], (n, 1)),
        t=np.tile([0.0, 0.0, 1.0], (n, 1)),
        s=np.linspace(0.0, length, n),
        curvature=np.tile([0.0, 1 / radius, 0.0], (n, 1)),
        extent=np.full((n, 4), 0.05),
        feed=feed * ones,
        force=force * ones,
    )
