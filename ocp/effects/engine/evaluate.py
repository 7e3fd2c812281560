"""Arm and tracker effects in numbers: what every variant does to the joints, the links and the readings.

    displaced nest = d_joints (joint + c torque) + sum of twists at the links up to the nest's,                     (1)

d_joints the derivative of the nest in the commanded joints, which already bends the arm at the displaced posture
(`robots.calibration.reading_model`).
"""

from collections.abc import Sequence
from dataclasses import dataclass

import casadi as ca
import numpy as np

from ocp.effects.context import TrackerContext
from ocp.effects.effect import Active, Effect, Scanned
from ocp.effects.engine.compiled import Hook, RowLayout, evaluated
from ocp.effects.engine.rows import ARM_LAYOUT, ArmRows
from robots.pose import Array

TRACKER_LAYOUT = RowLayout.of("point 3, R 9, time 1, warm 1, target 1")


@dataclass(frozen=True)
class ArmColumns:
    """Per unit coefficient, v variants, n rows, m coefficients: joints (v, n, 6, m) rad of the commanded joints, twists {link:
    (v, n, 6, m)} m and rad in base axes at the origin of the link's frame."""

    joints: Array
    twists: dict[int, Array]

    def at(self, rows: ArmRows, point: Array, d_joints: Array, link: int = 6) -> Array:
        """Displacement (v, n, 3, m) m, base axes, of points (n, 3) m (base frame) of `link`; d_joints (n, 3, 6) m/rad in the
        commanded joints, base axes (eq. 1)."""
        out = self._by_joints(d_joints)
        for i, twist in self.twists.items():
            if i <= link:
                lever = point - rows.origins[:, i]
                out += twist[:, :, :3] + np.cross(twist[:, :, 3:], lever[None, :, :, None], axis=2)
        return out

    def spin(self, spin_joints: Array, link: int = 6) -> Array:
        """Turn (v, n, 3, m) rad, base axes, of `link`; spin_joints (n, 3, 6) in the commanded joints."""
        out = self._by_joints(spin_joints)
        for i, twist in self.twists.items():
            if i <= link:
                out += twist[:, :, 3:]
        return out

    def _by_joints(self, slope: Array) -> Array:
        """slope (n, 3, 6) times the joints, (v, n, 3, m), over the joints that move at all."""
        v, n, _, m = self.joints.shape
        out = np.zeros((v, n, 3, m))
        for j in range(6):
            if self.joints[:, :, j].any():
                out += slope[None, :, :, j, None] * self.joints[:, :, None, j]
        return out


def arm_columns(effect: Effect, joint: int, scans: Sequence[Scanned], rows: ArmRows) -> ArmColumns:
    """What an effect at `joint` (0: none) does to the arm, for every variant."""
    if not scans:
        return ArmColumns(np.zeros((0, len(rows), 6, effect.size)), {})
    if effect.joint is not None:
        joints = evaluated(Hook(effect, "joint", joint, ARM_LAYOUT, rows.place), rows.state, scans)[-1]
    else:
        joints = np.zeros((len(scans), len(rows), 6, effect.size))
    if effect.torque is not None:
        torque = evaluated(Hook(effect, "torque", joint, ARM_LAYOUT, rows.place), rows.state, scans)[-1]
        joints = joints + rows.block("c")[None, :, :, None] * torque
    twists = {}
    if effect.twist is not None:
        twists = evaluated(Hook(effect, "twist", joint, ARM_LAYOUT, rows.place), rows.state, scans)
    return ArmColumns(joints, twists)


def arm_shift(active: Sequence[Active], rows: ArmRows) -> ArmColumns:
    """The joint shifts and twists of effects with values, summed: one variant, one coefficient of one.

    For a nonlinear prediction predict at q + joints[0, :, :, 0] and add `at` with d_joints of zeros for the twists.
    """
    joints = np.zeros((1, len(rows), 6, 1))
    twists: dict[int, Array] = {}
    for item in active:
        if not item.effect.on_arm:
            continue
        columns = arm_columns(item.effect, item.joint, (item.scanned,), rows)
        joints[..., 0] += columns.joints @ item.a
        for link, twist in columns.twists.items():
            twists[link] = twists.get(link, np.zeros(1)) + (twist @ item.a)[..., None]
    return ArmColumns(joints, twists)


def shifted_joints(active: Sequence[Active], rows: ArmRows) -> Array:
    """What active effects add to the commanded joints (n, 6) rad."""
    return np.asarray(arm_shift(active, rows).joints[0, :, :, 0])


@dataclass(frozen=True)
class TrackerPlace:
    """Names of the reflector nests."""

    targets: tuple[str, ...]

    def context(self, row: ca.SX) -> TrackerContext:
        """What hooks see of a symbolic row."""
        x = TRACKER_LAYOUT.split(row)
        return TrackerContext(x["point"], ca.reshape(x["R"], 3, 3).T, x["time"], x["warm"], x["target"], self.targets)


@dataclass(frozen=True)
class TrackerRows:
    """n readings: point (n, 3) m predicted in the tracker's frame, R (n, 3, 3) of the nest's link in that frame, time (n,) s,
    warm (n,) K, target (n,) index in `targets`."""

    point: Array
    R: Array
    target: Array
    targets: tuple[str, ...]
    time: Array | None = None
    warm: Array | None = None


def tracker_columns(effect: Effect, joint: int, scans: Sequence[Scanned], rows: TrackerRows) -> Array:
    """What an effect adds to readings, per unit coefficient: (v, n, 3, m) m in the tracker's frame."""
    n = len(rows.point)
    if effect.reading is None or not scans:
        return np.zeros((len(scans), n, 3, effect.size))
    blocks = {"point": rows.point, "R": rows.R.reshape(n, 9), "time": rows.time, "warm": rows.warm, "target": rows.target}
    hook = Hook(effect, "reading", joint, TRACKER_LAYOUT, TrackerPlace(rows.targets))
    return evaluated(hook, TRACKER_LAYOUT.stack(n, blocks), scans)[-1]


def tracker_shift(active: Sequence[Active], rows: TrackerRows) -> Array:
    """What active effects add to the readings (n, 3) m in the tracker's frame."""
    out = np.zeros((len(rows.point), 3))
    for item in active:
        if item.effect.reading is not None:
            out += tracker_columns(item.effect, item.joint, (item.scanned,), rows)[0] @ item.a
    return out
