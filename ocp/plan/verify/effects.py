"""A cell's effects by the second route: the library's formulas on numbers that the verification itself found.

Postures are elementary motions, torques Pinocchio's, slopes the direct contact's; nothing of the symbolic model is used.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.interpolate import interp1d

from ocp.contact.wheel.gap import LocalShape
from ocp.effects.engine.arm_rows import LAYOUT, ArmPlace, ArmRows
from ocp.effects.engine.contact_rows import ContactPlace, added_overlap
from ocp.effects.engine.evaluate import arm_shift
from ocp.model.cell import Cell
from robots.elementary import elementary_frames
from robots.pose import Array
from robots.rigid_body import inverse_dynamics
from robots.robot import Robot

FIXED_POINT_STEPS = 4


@dataclass(frozen=True)
class BelievedArm:
    """Robot with calibrated MD-H, compliance (6,) rad/(N m) that gravity bends, payload kg and m."""

    robot: Robot
    bends: Array
    payload_mass: float
    payload_com: Array

    def torque(self, q: Array) -> Array:
        """Load torque (m, 6) N m of weight at postures q (m, 6), positive along +q."""
        still = np.zeros_like(q)
        return -np.asarray(inverse_dynamics(self.robot, self.payload_mass, self.payload_com, q, still, still))


def at_stations(conditions: Mapping[str, Array] | None, of: Array, s: Array) -> dict[str, Array]:
    """Conditions (n, k) at arc lengths `of` (n,), between them at s (m,)."""
    found = {}
    for name, values in (conditions or {}).items():
        found[name] = np.asarray(interp1d(of, values, axis=0, bounds_error=False, fill_value=(values[0], values[-1]))(s))
    return found


def moved_arm(cell: Cell, arm: BelievedArm, q: Array, q_real: Array, seen: Mapping[str, Array]) -> tuple[Array, Array]:
    """Bent joints (m, 6) and flange poses (m, 4, 4) with the cell's effects; q commanded, q_real as the believed arm bends."""
    m = len(q)
    payload = np.concatenate([[arm.payload_mass], arm.payload_com])
    frames = elementary_frames(arm.robot, q_real)
    blocks = {
        "q": q, "q_real": q_real, "tau": arm.torque(q_real), "c": arm.bends, "payload": payload, "hung": 0.0,
        "frames": frames[:, :, :3, :].reshape(m, 84),
    } | {name: seen[name] for name in ("approach", "speed", "warm", "time")}  # fmt: skip
    rows = ArmRows(ArmPlace.of(arm.robot, (cell.workpiece.payload.name,)), LAYOUT.stack(m, blocks))
    shift = arm_shift([e.active for e in cell.effects], rows)
    dq, real = shift.joints[0, :, :, 0], q_real
    for _ in range(FIXED_POINT_STEPS):
        real = q + dq + arm.bends * arm.torque(real)
    frames = elementary_frames(arm.robot, real)
    T, at = frames[:, 6].copy(), frames[..., :3, 3].copy()
    for link in sorted(shift.twists):
        motion = shift.twists[link][0, :, :, 0]
        v, w = motion[:, :3], motion[:, 3:]
        turned = T[:, :3, 3] - at[:, link]
        T[:, :3, 3] += v + np.cross(w, turned)
        T[:, :3, :3] += np.cross(w[:, :, None], T[:, :3, :3], axis=1)
        for i in range(link + 1, 7):
            at[:, i] += v + np.cross(w, at[:, i] - at[:, link])
        at[:, link] += v
    return real, T


@dataclass(frozen=True)
class ContactSample:
    """A contact of a pass: point, normal and feed in the blade frame, T_base_blade, outward radial e, lateral m, the local shape,
    numbers of the cell's conditions there."""

    cell: Cell
    p: Array
    n: Array
    t: Array
    T: Array
    e: Array
    lateral: float
    shape: LocalShape
    seen: Mapping[str, Array]

    def overlap(self, F: float, parts: Sequence[float], slopes: Sequence[float], friction_give: float) -> float:
        """Overlap m that the cell's effects add at the force F N; parts m and slopes m/N of flange, wheel, blade, robot;
        friction_give m: what the parts give more per unit of friction."""
        cell, wheel, R = self.cell, self.cell.wheel, self.T[:3, :3]
        clamp, start = cell.workpiece, cell.wheel.contact_direction
        R_flange, normal = R @ clamp.T_flange_blade[:3, :3].T, R @ self.n
        push = normal
        if cell.flange is not None and cell.flange.axis is not None:
            push = R_flange @ cell.flange.axis
            push = push * np.sign(push @ normal)
        belt = np.cross(wheel.axis, self.e)
        heading = -(R @ self.t) * (1 if cell.process.grinding == "down" else -1) * (np.sign(wheel.belt_speed) or 1.0)
        blocks = {
            "F": F, "parts": np.array(parts), "slopes": np.array(slopes), "lateral": self.lateral, "p": self.p, "n": self.n,
            "curvature": np.array([self.shape.kxx, self.shape.kyy, self.shape.kxy]), "t": self.t, "e": self.e,
            "tilt": np.array([self.shape.tilt_x, self.shape.tilt_y]), "belt_direction": belt, "n_base": normal,
            "arc": np.arctan2(np.cross(start, self.e) @ wheel.axis, start @ self.e), "axis": wheel.axis,
            "turn": np.arctan2(heading @ wheel.axis, heading @ belt), "R_flange": R_flange.reshape(1, 9),
            "R_blade": R.reshape(1, 9), "normal_stiffness": 1.0 / sum(slopes), "friction_give": friction_give,
            "lever": abs(clamp.clamp_normal @ self.p - clamp.clamp_offset), "push_axis": push,
            "clamp_give": F / clamp.clamp_stiffness,
        } | {name: value for name, value in self.seen.items() if name not in ("approach", "speed")}  # fmt: skip
        active = [e.active for e in cell.effects]
        return added_overlap(active, ContactPlace(wheel.radius, wheel.friction), blocks, cell.flange is None)
