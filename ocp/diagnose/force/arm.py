"""What effects of the arm do to a logged contact: joints that stand elsewhere, and a blade that is carried elsewhere.

A small motion of a link and of all that follows it moves the blade as a shift and a turn of its frame on the flange would:
both are parameters of the model, so that contact geometry follows exactly. docs/diagnosis_force.md, eq. 4.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from ocp.calibrate.force.log import Index
from ocp.calibrate.force.rows import LogConditions
from ocp.diagnose.engine.channel_system import scan_key
from ocp.effects.effect import Effect, Scanned
from ocp.effects.engine.evaluate import ArmRows, arm_columns, arm_rows
from ocp.model.cell import Cell
from ocp.model.theta import NAMES
from robots.calibration.reading_model import RowInputs
from robots.pose import Array

BLADE = tuple(NAMES.index(n) for n in ("blade_x", "blade_y", "blade_z", "blade_c", "blade_b", "blade_a"))


@dataclass(frozen=True)
class Moved:
    """Per unit coefficient of V variants: shift (V, n, k, m) rad of the joints `moving` (k,) (0..5); shift m and turn rad (V, n,
    6, m) of the blade in its grip, flange axes, that stand for motions of links (None: none)."""

    moving: Index
    shift: Array
    blade: Array | None


@dataclass(frozen=True)
class LoggedArm:
    """The arm at n rows of a log; origin (n, 3) m of the blade's frame and turn (n, 3, 3) of the flange, base frame."""

    rows: ArmRows = field(repr=False)
    origin: Array = field(repr=False)
    flange: Array = field(repr=False)
    store: dict[tuple[Any, ...], Moved] = field(default_factory=dict, repr=False)

    def columns(self, effect: Effect, joint: int, scans: Sequence[Scanned]) -> "Moved":
        """What each variant does, per unit coefficient; kept, for it does not depend on any fit."""
        key = (effect.name, joint, *map(scan_key, scans))
        if key not in self.store:
            self.store[key] = self._columns(effect, joint, scans)
        return self.store[key]

    def _columns(self, effect: Effect, joint: int, scans: Sequence[Scanned]) -> "Moved":
        found = arm_columns(effect, joint, scans, self.rows)
        moving = np.flatnonzero([found.joints[:, :, j].any() for j in range(found.joints.shape[2])])
        blade = None
        for link, twist in found.twists.items():
            lever = self.origin - self.rows.origins[:, link]
            moved = twist[:, :, :3] + np.cross(twist[:, :, 3:], lever[None, :, :, None], axis=2)
            both = [np.einsum("nji,vnjm->vnim", self.flange, part) for part in (moved, twist[:, :, 3:])]
            blade = np.concatenate(both, axis=2) + (0.0 if blade is None else blade)
        return Moved(moving, np.ascontiguousarray(found.joints[:, :, moving]), blade)


def logged_arm(cell: Cell, theta: Array, q: Array, conditions: LogConditions) -> LoggedArm:
    """The arm with parameters theta (m,) at commanded joints q (n, 6) rad."""
    n = len(q)
    parameters = theta[:36].copy()
    # Under gravity bends what the believed model lets bend; under the contact force all springs do
    # (`ocp/model/force_balance.py`).
    parameters[30:] *= [float(j in cell.compliant_joints) for j in range(1, 7)]
    hanging = theta[[NAMES.index(k) for k in ("payload_mass", "payload_com_x", "payload_com_y", "payload_com_z")]]
    inputs = RowInputs(q, np.tile(hanging, (n, 1)), np.zeros((n, 6)), np.zeros((n, 3)), np.zeros((n, 3)))
    names = tuple(cell.tables.payloads)
    own = cell.tables.workpiece.payload if cell.tables.workpiece is not None else None
    hung = np.full(n, names.index(own) if own in names else 0)
    c = conditions
    clock = c.clock if "clock_s" in c.given else None
    rows = arm_rows(cell.robot, parameters, inputs, names, hung, c.approach, c.warm, clock, c.speed)
    flange = rows.block("frames").reshape(-1, 7, 3, 4)[:, 6]
    place = cell.workpiece.T_flange_blade[:3, 3] + theta[list(BLADE[:3])]
    origin = flange[:, :, 3] + flange[:, :, :3] @ place
    return LoggedArm(rows, origin, flange[:, :, :3])
