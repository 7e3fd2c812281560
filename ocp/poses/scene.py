"""The collision scene of a measurement: arm, blade, wheel, floor, and the brackets that hold the reflectors."""

import coal
import numpy as np

from ocp.model.cell import Cell
from ocp.plan.motion.collision import ARM_MARGIN, Body, Pair, Scene, _between
from robots.pose import Array
from robots.tracker_readings import Nest

ROD = 0.025  # m, radius of the straight rod that stands for a reflector's bracket; a 1.5 inch ball has 19 mm


class MeasuringScene(Scene):
    """A `Scene` with a rod from the flange to every nest it carries; rods may meet column, arm, wheel and floor.

    Nests on other links are taken to sit close to them.
    """

    def __init__(self, cell: Cell, blade_vertices: Array, nests: dict[str, Nest]) -> None:
        """`blade_vertices` (n, 3) m in the blade frame; `nests` by name."""
        super().__init__(cell, blade_vertices)
        fixed = list(range(len(self._bodies)))
        for name, nest in nests.items():
            if nest.link != 6 or nest.place is None:
                continue
            placement, length = _between(np.zeros(3), nest.place)
            self._bodies.append(Body(f"reflector {name}", 6, coal.Capsule(ROD, max(length, 1e-3)), placement))
            mine = len(self._bodies) - 1
            for i in fixed:
                if self._bodies[i].frame <= 3 or self._bodies[i].frame == 7:
                    self._pairs.append(Pair(i, mine, ARM_MARGIN))
