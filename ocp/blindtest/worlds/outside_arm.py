"""A virtual arm with effects that the catalogue does not hold on top of those it does.

It stands where the virtual cell asks an arm for its links, so that noise, nests and files are the virtual cell's own. Turns of
the tracker's frame are done to the scene instead, which is the same to the reading.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from scipy.spatial.transform import Rotation

from ocp.blindtest.worlds import outside, outside_late
from ocp.blindtest.worlds.outside import Forms, Instants
from ocp.blindtest.worlds.outside_late import EVERY
from ocp.model.cell import Cell
from ocp.simulate.twin.arm.arm import Arm, Moments, make_arm
from ocp.simulate.twin.arm.planted import hung
from ocp.simulate.twin.tracker import nest_links
from ocp.simulate.twin.truth.machine import Truth
from ocp.simulate.twin.truth.planting import Planted
from robots.pose import Array, apply, invert


class OutsideArm(Arm):
    """An arm of which `links` are asked with the nest of every instant known."""

    cell: Cell
    targets: tuple[str, ...]

    def links(self, m: Moments, rng: np.random.Generator | None = None) -> Array:
        """Frames (n, 7, 4, 4) of base and links with all effects; `m` of the campaign whose nests the arm was made for."""
        planted = [p for p in self.truth.effects if p.effect in EVERY]
        at = self._instants(m)
        dq = sum((_forms_of(p).shifts(p, at) for p in planted), np.zeros_like(m.q))
        frames = super().links(replace(m, q=m.q + dq), rng).copy()
        for p in planted:
            turned = _forms_of(p).twist(p, at)
            if turned is not None:
                joint = p.joint or 1
                _turn(frames, slice(joint, 7), at.links[:, joint - 1, :3, 3], turned)
        for p in planted:
            turned = _forms_of(p).frame_turn(p, at)
            if turned is not None:
                head = invert(self.truth.T_tracker_base)[:3, 3]
                _turn(frames, slice(0, 7), np.broadcast_to(head, (len(m), 3)), turned @ self.truth.T_tracker_base[:3, :3])
            moved = _forms_of(p).move(p, at)
            if moved is not None:
                frames[..., :3, 3] += moved[:, None]
        return frames

    def _instants(self, m: Moments) -> Instants:
        """The machine without these effects and without noise."""
        settled = self.settled(m)
        n = len(m)
        names = (m.payload,) * n if isinstance(m.payload, str) else m.payload
        loads = [hung(self.truth, name) for name in names]
        nests = np.array([self.truth.nests[name] for name in self.targets]).reshape(-1, 3)
        on = settled.links[np.arange(n), nest_links(self.cell, self.targets)]
        return Instants(
            robot=self.robot, q=m.q, sign=m.approach, tau=settled.load_torque[:, :6],
            warmth=m.temperature_C - self.reference_C, time=m.time_s, links=settled.links,
            mass=np.array([mass for mass, _ in loads]), centre=apply(settled.links[:, 6], np.array([c for _, c in loads])),
            point=apply(self.truth.T_tracker_base, apply(on, nests)), turn=self.truth.T_tracker_base[:3, :3],
        )  # fmt: skip


def arm_of(cell: Cell, truth: Truth, targets: Sequence[str]) -> Arm:
    """The arm of a cell, able to carry effects outside the catalogue where the truth holds any; targets: nest of each instant
    that it will be asked for."""
    arm = make_arm(cell, truth)
    if not any(p.effect in EVERY for p in truth.effects):
        return arm
    wrapped = OutsideArm(arm.robot, arm.truth, arm.hardware, arm.reference_C)
    wrapped.cell, wrapped.targets = cell, tuple(targets)
    return wrapped


def _forms_of(planted: Planted) -> Forms:
    """The list that an effect stands in."""
    return outside.FORMS if planted.effect in outside.KINDS else outside_late.FORMS


def _turn(frames: Array, links: slice, origin: Array, turn: Array) -> None:
    """Turn these links' frames (n, ., 4, 4) about points (n, 3) by rotation vectors (n, 3), in place."""
    R = Rotation.from_rotvec(turn).as_matrix()[:, None]
    part = frames[:, links]
    part[..., :3, 3] = origin[:, None] + (R @ (part[..., :3, 3] - origin[:, None])[..., None])[..., 0]
    part[..., :3, :3] = R @ part[..., :3, :3]
