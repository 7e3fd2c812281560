"""The virtual cell's hidden numbers as one record: what differs from what is believed, and what was planted."""

from dataclasses import dataclass

import numpy as np

from ocp.model.cell import Cell
from ocp.simulate.twin.truth.planting import Planted
from robots.pose import Array

SENSOR_SIGMA = 0.3  # N, one sigma of a force reading


@dataclass(frozen=True, eq=False)
class Truth:
    """A virtual cell, SI and radians.

    mdh (6, 5) design numbers; placement (6, 6): shift m and turn (rotation vector) rad of link i's frame against its design
    place, in that frame's axes; stiffness (6,) N m/rad (0 rigid), bends (6,) whether weight bends the joint (under contact all
    springs give); mass_scale (7,) of base and links; payloads: mass kg and centre (3,) m by name. ripple (6, 3) amplitude rad,
    order, phase; play (6,) half width rad; repeatability rad. T_tracker_base; nests: places (3,) m in their links' frames,
    nest_turns: rotation vectors of 6D targets. wheel_shift m and wheel_axis_turn (rotation vector) in base axes; blade_shift m
    and blade_turn (rotation vector) in flange axes, on top of the cell's. cover_scale, blade_scale, flange_scale: factors on
    stiffness, 1 = as in the cell; flange_offset N. sensor N; outliers: share of gross tracker readings.
    """

    seed: int
    mdh: Array
    placement: Array
    stiffness: Array
    bends: Array
    mass_scale: Array
    payloads: dict[str, tuple[float, Array]]
    ripple: Array
    play: Array
    repeatability: float
    T_tracker_base: Array
    nests: dict[str, Array]
    nest_turns: dict[str, Array]
    wheel_shift: Array
    wheel_axis_turn: Array
    blade_shift: Array
    blade_turn: Array
    cover_scale: float
    blade_scale: float
    flange_scale: float
    flange_offset: float
    sensor_bias: float
    sensor_sigma: float
    outliers: float
    effects: tuple[Planted, ...]

    def planted(self, effect: str) -> list[Planted]:
        """The planted effects of a name."""
        return [p for p in self.effects if p.effect == effect]


def believed_payloads(cell: Cell) -> dict[str, tuple[float, Array]]:
    """Mass kg and centre (3,) m in the flange frame of everything the cell names."""
    return {name: (table.mass_kg, 1e-3 * np.array(table.com_mm)) for name, table in cell.tables.payloads.items()}
