"""Effects that the catalogue does not hold: how a list of them is written down, and a virtual arm that carries them.

In a world with such an effect "none of these" is the right answer. There are two lists, kept apart on purpose: the first
was known to the author of the diagnosis, the second was invented unseen. An effect has one
size; its form says, per unit size, how much it moves of one of these:

    angle     dq (n,) rad of its joint
    link      rotation vectors (n, 3) rad, base axes, of the joint's link and all after it about the joint's origin; of an effect
              without a joint the whole arm about its base
    frame     rotation vectors (n, 3) rad, tracker's axes, of the readings about the tracker's head
    nest      shifts (n, 3) m of the reflector in its nest, base axes
    overlap   m (n,) by which the contact is deeper
    push      N (n,) that the flange pushes with beside its setpoint
    reading   N (n,) that the normal reading shows beside the contact's force
"""

from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from ocp.model.cell import Cell
from ocp.simulate.twin.arm import Moments, VirtualArm, hung, link_weights
from ocp.simulate.twin.machine import GRAVITY
from ocp.simulate.twin.planting import EffectKind, Key, Planted
from ocp.simulate.twin.tracker import nest_links
from robots.pose import Array, apply, invert
from robots.robot import Robot

Form = Callable[[Planted, Any], Array]


@dataclass(frozen=True, eq=False)
class ArmInstants:
    """What forms of the arm and the tracker may depend on, n readings: q (n, 6) rad, sign (n, 6), tau (n, 6) N m, warmth (n,) K,
    time (n,) s; links (n, 7, 4, 4), weights: their masses (7,) kg and centres (7, 3) m; mass (n,) kg and centre (n, 3) m (base
    axes) of the payload; point (n, 3) m of the reading in the tracker's frame, turn (3, 3) from base to tracker axes. Without
    noise and without effects outside the catalogue."""

    robot: Robot
    q: Array
    sign: Array
    tau: Array
    warmth: Array
    time: Array
    links: Array
    weights: tuple[Array, Array]
    mass: Array
    centre: Array
    point: Array
    turn: Array

    def moment_across(self, joint: int) -> tuple[Array, Array]:
        """Moments (n, 3) N m, base axes, of the weight of all links after the joint (0..5) and of the payload about its origin:
        whole, and the part square to the joint's axis."""
        origin, axis = self.links[:, joint, :3, 3], self.links[:, joint, :3, 2]
        weight = GRAVITY * self.robot.gravity_direction
        moment = self.mass[:, None] * np.cross(self.centre - origin, weight)
        for link in range(joint + 1, 7):
            centre = apply(self.links[:, link], np.broadcast_to(self.weights[1][link], (len(self.q), 3)))
            moment = moment + self.weights[0][link] * np.cross(centre - origin, weight)
        return moment, np.asarray(moment - (moment * axis).sum(axis=1, keepdims=True) * axis)


@dataclass(frozen=True, eq=False)
class GrindingInstants:
    """What forms of the grinding may depend on (n,): s m, travel +-1, time s since the run's start, clock s, belt m/s, way of the
    belt m since the run's start, radius m of the wheel, force N without the effect; q (n, 6) rad."""

    s: Array
    travel: Array
    time: Array
    clock: Array
    belt: Array
    way: Array
    radius: float
    force: Array
    q: Array


@dataclass(frozen=True)
class Outside:
    """An effect of a list: its kind (`draw_effect` draws from it as from the catalogue's), what it moves, the form."""

    kind: EffectKind
    moves: str
    form: Form


def outside(name: str, moves: str, form: Form, joints: tuple[int, ...], *keys: Key) -> Outside:
    """A line of a list; the first key is the size."""
    return Outside(EffectKind(name, joints, keys, "outside"), moves, form)


def size(name: str, unit: str, low: float, high: float, signed: bool = True) -> Key:
    """The key of an effect's size."""
    return Key(name, unit, low, high, signed)


def by_name(*effects: Outside) -> dict[str, Outside]:
    """A list by the names of its effects."""
    return {one.kind.name: one for one in effects}


def joint_index(planted: Planted) -> int:
    """0..5."""
    return (planted.joint or 1) - 1


def moved_by(
    known: Mapping[str, Outside], planted: Iterable[Planted], what: str, at: ArmInstants | GrindingInstants
) -> Iterator[tuple[Planted, Array]]:
    """Those of the planted effects that move `what`, with how much, at their sizes."""
    for p in planted:
        one = known.get(p.effect)
        if one is not None and one.moves == what:
            yield p, np.asarray(p.number(one.kind.keys[0].name) * one.form(p, at))


class OutsideArm(VirtualArm):
    """A virtual arm with effects outside the catalogue on top of those inside it, for the nests of a campaign.

    It stands where the virtual cell asks an arm for its links, so that noise, nests and files are the virtual cell's own. Turns
    of the tracker's frame are done to the scene instead, which is the same to the reading.
    """

    cell: Cell
    targets: tuple[str, ...]
    known: Mapping[str, Outside]

    def links(self, m: Moments, rng: np.random.Generator | None = None) -> Array:
        """Frames (n, 7, 4, 4) of base and links with all effects; `m` of the campaign whose nests the arm was made for."""
        planted, known, at = self.truth.effects, self.known, self._instants(m)
        dq = np.zeros_like(m.q)
        for p, angle in moved_by(known, planted, "angle", at):
            dq[:, joint_index(p)] += angle
        frames = super().links(replace(m, q=m.q + dq), rng).copy()
        for p, turned in moved_by(known, planted, "link", at):
            joint = p.joint or 1
            _turn(frames, slice(joint, 7), at.links[:, joint - 1, :3, 3], turned)
        head = invert(self.truth.T_tracker_base)[:3, 3]
        for _, turned in moved_by(known, planted, "frame", at):
            _turn(frames, slice(0, 7), np.broadcast_to(head, (len(m), 3)), turned @ self.truth.T_tracker_base[:3, :3])
        for _, shift in moved_by(known, planted, "nest", at):
            frames[..., :3, 3] += shift[:, None]
        return frames

    def _instants(self, m: Moments) -> ArmInstants:
        settled = self.settled(m)
        n = len(m)
        loads = [hung(self.truth, name) for name in m.payload]
        nests = np.array([self.truth.nests[name] for name in self.targets]).reshape(-1, 3)
        on = settled.links[np.arange(n), nest_links(self.cell, self.targets)]
        return ArmInstants(
            robot=self.robot,
            q=m.q,
            sign=m.approach,
            tau=settled.load_torque[:, :6],
            warmth=m.temperature_C - self.reference_C,
            time=m.time_s,
            links=settled.links,
            weights=link_weights(self.robot, self.truth),
            mass=np.array([mass for mass, _ in loads]),
            centre=apply(settled.links[:, 6], np.array([c for _, c in loads])),
            point=apply(self.truth.T_tracker_base, apply(on, nests)),
            turn=self.truth.T_tracker_base[:3, :3],
        )


def _turn(frames: Array, links: slice, origin: Array, turn: Array) -> None:
    """Turn these links' frames (n, ., 4, 4) about points (n, 3) by rotation vectors (n, 3), in place."""
    R = Rotation.from_rotvec(turn).as_matrix()[:, None]
    part = frames[:, links]
    part[..., :3, 3] = origin[:, None] + (R @ (part[..., :3, 3] - origin[:, None])[..., None])[..., 0]
    part[..., :3, :3] = R @ part[..., :3, :3]
