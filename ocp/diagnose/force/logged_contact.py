"""A logged contact as effects see it and move it.

Samples are numbers of the contact for the effects' hooks, row by row: the believed model's own figures at its equilibrium.
Effects of the arm act through joints that stand elsewhere, and a blade that is carried elsewhere: a small motion of a link
and of all that follows it moves the blade as a shift and a turn of its frame on the flange would. Both are parameters of the
model, so that contact geometry follows exactly. docs/diagnosis_force.md, eq. 4.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from ocp.calibrate.force.model import STATE, PlacedRows
from ocp.calibrate.force.rows import LogConditions
from ocp.effects.effect import Effect, Scanned, scan_key
from ocp.effects.engine.compiled import RowLayout
from ocp.effects.engine.evaluate import CONTACT_LAYOUT, ArmRows, arm_columns, arm_rows
from ocp.model.cell import Cell
from ocp.model.force_balance import axis_directions
from ocp.model.theta import BLOCKS, NAMES
from robots.calibration.reading_model import RowInputs
from robots.pose import Array, Index, skew

PLACE = CONTACT_LAYOUT.places
ABOUT_JOINTS = ("joint_lever", "joint_push", "tau")
_AT = RowLayout(tuple((name, len(names)) for name, names in BLOCKS.items())).places  # of theta


def samples_of(cell: Cell, rows: PlacedRows, conditions: LogConditions, F: Array, state: Array, stiffness: Array) -> Array:
    """Samples (n, k), in the order of `CONTACT_LAYOUT`, of rows in contact at forces F (n,) N with their state (n, k); columns
    that a log does not have are nan. Where theta turns the wheel's axis or shifts the blade the frames follow.
    """
    base, theta, wheel, c = rows.base, rows.theta, cell.wheel, conditions
    T, w = state[:, STATE["T"]].reshape(-1, 4, 4), base.waypoint
    R = T[:, :3, :3]
    u, v = axis_directions(wheel.axis)
    turned = theta[:, _AT["wheel_axis"]]
    axis = wheel.axis - turned[:, :1] * v + turned[:, 1:] * u
    axis /= np.linalg.norm(axis, axis=1, keepdims=True)
    off = np.einsum("kij,kj->ki", R, w[:, :3]) + T[:, :3, 3] - wheel.centre - theta[:, _AT["wheel_centre"]]
    radial = off - np.sum(off * axis, axis=1, keepdims=True) * axis
    e = radial / np.linalg.norm(radial, axis=1, keepdims=True)
    own = _blade_turn(theta[:, _AT["blade_rotation"]]) @ cell.workpiece.T_flange_blade[:3, :3]
    flange = R @ own.transpose(0, 2, 1)
    n_base = np.einsum("kij,kj->ki", R, w[:, 3:6])
    of_state = ("arc", "lateral", "turn", "tilt", "curvature", "parts", "slopes", "friction_deflection", *ABOUT_JOINTS)
    of_log = ("s", "setpoint", "feed", "belt", "time", "clock", "ground_before", "warm", "wheel_warm", "travel")
    blocks: dict[str, Any] = {name: state[:, STATE[name]] for name in of_state} | {name: getattr(c, name) for name in of_log}
    blocks |= {"F": F, "p": w[:, :3], "n": w[:, 3:6], "t": w[:, 6:9], "e": e, "n_base": n_base, "axis": axis, "line": c.line}
    blocks |= {"R_flange": flange.reshape(-1, 9), "R_blade": R.reshape(-1, 9), "belt_direction": np.cross(axis, e)}
    blocks |= {"normal_stiffness": stiffness, "push_axis": _push_axis(cell, flange, n_base)}
    blocks["lever"] = np.abs(w[:, :3] @ cell.workpiece.clamp_normal - cell.workpiece.clamp_offset)
    blocks |= {"q": base.q}
    blocks["clamp_deflection"] = F / cell.workpiece.clamp_stiffness
    return CONTACT_LAYOUT.stack(len(F), blocks)


def _push_axis(cell: Cell, R_flange: Array, n: Array) -> Array:
    """Directions (n, 3) in which the flange pushes the blade, base frame; the contact's normal where it has no axis."""
    if cell.flange is None or cell.flange.axis is None:
        return n
    direction = R_flange @ cell.flange.axis
    return np.asarray(direction * np.where(np.sum(direction * n, axis=1, keepdims=True) < 0, -1.0, 1.0))


def _blade_turn(r: Array) -> Array:
    """Rotations (n, 3, 3) of small rotation vectors (n, 3) to second order, as `ocp.model.force_balance` takes them."""
    S = skew(r)
    return np.asarray(np.eye(3) + S + 0.5 * S @ S)


BLADE = tuple(NAMES.index(n) for n in ("blade_x", "blade_y", "blade_z", "blade_c", "blade_b", "blade_a"))


@dataclass(frozen=True)
class Moved:
    """Per unit coefficient of V variants: shift (k, n, V, m) rad of the joints `moving` (k,) (0..5); shift m and turn rad (6, n,
    V, m) of the blade in its grip, flange axes, that stand for motions of links (None: none)."""

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
        moves = [k for k in range(len(found.moving)) if found.shift[:, :, k].any()]
        blade = None
        for link, twist in found.twists.items():
            lever = self.origin - self.rows.origins[:, link]
            moved = twist[:, :, :3] + np.cross(twist[:, :, 3:], lever[None, :, :, None], axis=2)
            both = [np.einsum("nji,vnjm->invm", self.flange, part) for part in (moved, twist[:, :, 3:])]
            blade = np.concatenate(both) + (0.0 if blade is None else blade)
        return Moved(found.moving[moves], np.ascontiguousarray(found.shift[:, :, moves].transpose(2, 1, 0, 3)), blade)


def logged_arm(cell: Cell, theta: Array, q: Array, c: LogConditions) -> LoggedArm:
    """The arm with parameters theta (m,) at commanded joints q (n, 6) rad under conditions c."""
    n = len(q)
    parameters = theta[:36].copy()
    # Under gravity bends what the believed model lets bend; under the contact force all springs do
    # (`ocp/model/force_balance.py`).
    parameters[30:] *= [float(j in cell.compliant_joints) for j in range(1, 7)]
    hanging = theta[[NAMES.index(k) for k in ("payload_mass", "payload_com_x", "payload_com_y", "payload_com_z")]]
    inputs = RowInputs(q, np.tile(hanging, (n, 1)), np.zeros((n, 6)), np.zeros((n, 3)), np.zeros((n, 3)))
    names = tuple(cell.tables.payloads)
    hung = np.full(n, names.index(cell.workpiece.payload_name) if names else 0)
    clock = c.clock if "clock_s" in c.given else None
    rows = arm_rows(cell.robot, parameters, inputs, names, hung, c.approach, c.warm, clock, c.speed)
    flange = rows.block("frames").reshape(-1, 7, 3, 4)[:, 6]
    place = cell.workpiece.T_flange_blade[:3, 3] + theta[list(BLADE[:3])]
    return LoggedArm(rows, flange[:, :, 3] + flange[:, :, :3] @ place, flange[:, :, :3])
