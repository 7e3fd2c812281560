"""What effects do to tracker readings: shifts of the joint angles, and displacements of the reflectors that come on top."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from ocp.effects.effect import Active, Effect, Scanned
from ocp.effects.engine.evaluate import ArmRows, TrackerRows, arm_columns, arm_rows, loaded, softened, tracker_columns
from robots.calibration.layout import State, believed_compliance
from robots.calibration.residuals import row_groups
from robots.calibration.solver import Campaign
from robots.gravity import GRAVITY
from robots.pose import Array
from robots.robot import Robot
from robots.tracker_readings import Index, Instrument, Readings

COLUMNS = {"temperature_C": "temperature", "time_s": "time", "clock_s": "time"}  # of the file, as `Readings` calls them
COLUMNS |= {name: name for name in ("approach", "target", "payload")}
SPRINGS_WITHIN = (0.5, 2.0)  # of what is believed of a spring: it is right within 35 %, no right one leaves these
Motion = tuple[Array | None, Array | None]


@dataclass(frozen=True)
class PlacedReadings:
    """Readings with commanded joints (signs, loads, times as measured), the arm's parameters they are predicted with, their
    reflectors `point` (n, 3) m in the tracker's frame, the cell's reference temperature deg C, what the joints' springs were
    believed to be before any reading (6,) rad/(N m), and the effects that act there.

    Torques bend the joints through springs near what is believed: in a fit that lacks a torque (a balancer) the springs stand in
    for it and may come out zero or negative, and would hide it for good. Effects that turn a joint with its load bend it under
    torques that other effects add, too.
    """

    robot: Robot
    readings: Readings
    instrument: Instrument
    state: State
    point: Array
    reference: float
    believed: Array
    active: tuple[Active, ...] = ()

    def __len__(self) -> int:
        return len(self.readings)

    @cached_property
    def turns(self) -> Array:
        """Tracker from base (n, 3, 3) of each reading's station."""
        return np.asarray(self.state.stations[self.readings.station, :3, :3])

    @cached_property
    def base_point(self) -> Array:
        """Reflectors (n, 3) m in the base frame."""
        off = self.point - self.state.stations[self.readings.station, :3, 3]
        return np.asarray(np.einsum("nji,nj->ni", self.turns, off))

    @cached_property
    def warm(self) -> Array | None:
        """K (n,) above the reference temperature."""
        return None if self.readings.temperature is None else self.readings.temperature - self.reference

    @cached_property
    def groups(self) -> list[tuple[Index, int, ArmRows]]:
        """Readings whose nest sits on the same link and whose load pulls at the same link: rows, link of the nest, the arm with
        the effects that act there: torques with theirs, springs that give as much more."""
        return [(rows, on, softened(self.active, loaded(self.active, arm))) for rows, on, arm in self.bare_groups]

    @cached_property
    def more(self) -> tuple[Array, Array]:
        """What the active effects add: load torques (n, 6) N m, and give of the joints (n, 6) rad/(N m)."""
        torque, give = np.zeros((2, len(self), 6))
        for (rows, _, arm), (_, _, bare) in zip(self.groups, self.bare_groups, strict=True):
            torque[rows], give[rows] = (arm.block(name) - bare.block(name) for name in ("tau", "c"))
        return torque, give

    @cached_property
    def bare_groups(self) -> list[tuple[Index, int, ArmRows]]:
        """`groups` without effects."""
        r, found = self.readings, []
        springs = np.clip(self.state.arm[30:], SPRINGS_WITHIN[0] * self.believed, SPRINGS_WITHIN[1] * self.believed)
        whole = np.concatenate([self.state.arm[:30], np.where(self.believed > 0, springs, self.state.arm[30:])])
        for rows, inputs in row_groups(r, self.instrument, self.state):
            parts = [None if a is None else a[rows] for a in (r.approach, self.warm, r.time, None, r.waited)]
            arm = arm_rows(self.robot, whole, inputs, r.payloads, r.payload[rows].astype(float), *parts)
            found.append((rows, inputs.nest_link, arm))
        return found

    @cached_property
    def tilts(self) -> Array:
        """Displacement (n, 3, 6, 4) m/rad in the tracker's frame when axis j tilts about x and y of the link before it, and about
        the same two turned with the joint."""
        out = np.zeros((len(self), 3, 6, 4))
        for rows, on, arm in self.groups:
            frames = arm.block("frames").reshape(-1, 7, 3, 4)
            for j in range(min(on, 6)):
                lever = self.base_point[rows] - frames[:, j, :, 3]
                z, turned = frames[:, j, :, 2], frames[:, j + 1, :, 0]
                across = turned - np.sum(turned * z, axis=1, keepdims=True) * z
                across /= np.linalg.norm(across, axis=1, keepdims=True)
                for k, about in enumerate((frames[:, j, :, 0], frames[:, j, :, 1], across, np.cross(z, across))):
                    out[rows, :, j, k] = np.einsum("nij,nj->ni", self.turns[rows], np.cross(about, lever))
        return out

    @cached_property
    def moments(self) -> Array:
        """Moments (n, 6, 2) N m of all weight beyond axis j about x and y of the link before it, at the axis' origin."""
        out = np.zeros((len(self), 6, 2))
        for rows, _, arm in self.groups:
            frames = arm.block("frames").reshape(-1, 7, 3, 4)
            payload = arm.block("payload")
            masses = [(payload[:, 0], frames[:, 6, :, :3] @ payload[:, 1:4, None])]
            masses += [
                (np.full(len(rows), self.robot.link_mass[i]), frames[:, i, :, :3] @ self.robot.link_com[i][:, None])
                for i in range(6, 0, -1)
            ]
            total, moment = np.zeros(len(rows)), np.zeros((len(rows), 3))  # mass and its first moment about the base
            links = (6, 6, 5, 4, 3, 2, 1)
            for (mass, centre), link in zip(masses, links, strict=True):
                total = total + mass
                moment = moment + mass[:, None] * (centre[:, :, 0] + frames[:, link, :, 3])
                lever = moment - total[:, None] * frames[:, link - 1, :, 3]
                weight = GRAVITY * np.cross(lever, self.robot.gravity_direction)
                out[rows, link - 1] = np.einsum("ni,nik->nk", weight, frames[:, link - 1, :, :2])
        return out

    @cached_property
    def sight(self) -> Array:
        """Unit vectors (n, 3) from the reflectors to the tracker's head, in the axes of the links that carry them."""
        towards = -self.point / np.linalg.norm(self.point, axis=1, keepdims=True)
        return np.asarray(np.einsum("nji,nj->ni", self.tracker_rows.R, towards))

    @cached_property
    def hang(self) -> Array:
        """Unit vectors (n, 3) that point down, in the axes of the links that carry the reflectors."""
        return np.asarray(np.einsum("nji,njk,k->ni", self.tracker_rows.R, self.turns, self.robot.gravity_direction))

    @cached_property
    def tracker_rows(self) -> TrackerRows:
        """What the tracker's own effects see."""
        r = self.readings
        R = np.empty((len(r), 3, 3))
        for rows, on, arm in self.groups:
            R[rows] = self.turns[rows] @ arm.block("frames").reshape(-1, 7, 3, 4)[:, on, :, :3]
        return TrackerRows(self.point, R, r.target.astype(float), r.targets, r.time, self.warm)


def motion(effect: Effect, joint: int, scans: Sequence[Scanned], seen: PlacedReadings) -> Motion:
    """Shift of the joints (V, n, 6, m) rad and displacement of the reflectors (V, n, 3, m) m in the tracker's frame that comes
    on top, per unit coefficient, of V variants; None where there is none of a kind."""
    shape = (len(scans), len(seen))
    shift = point = None
    if effect.joint is not None or effect.torque is not None:
        shift = np.zeros((*shape, 6, effect.size))
    if effect.twist is not None or effect.reading is not None:
        point = np.zeros((*shape, 3, effect.size))
    if effect.on_arm:
        for rows, on, arm in seen.groups:
            columns = arm_columns(effect, joint, scans, arm)
            if shift is not None:
                shift[:, rows[:, None], columns.moving] = columns.shift
            if point is not None and columns.twists:
                moved = columns.at(arm, seen.base_point[rows], np.zeros((len(rows), 3, 6)), on)
                point[:, rows] += seen.turns[rows] @ moved
    if effect.reading is not None and point is not None:
        point += tracker_columns(effect, joint, scans, seen.tracker_rows)
    return shift, point


def displaced(found: Motion, d_joints: Array) -> Array:
    """Displacement (V, n, 3, m) m of the reflectors, to first order; d_joints (n, 3, 6) m/rad in the tracker's frame."""
    shift, point = found
    if shift is None:
        assert point is not None
        return point
    moving = np.flatnonzero(np.any(shift.any(axis=0), axis=(0, 2)))  # most effects move one joint
    moved = by_readings(d_joints[:, :, moving], shift[:, :, moving])
    return np.asarray(moved if point is None else moved + point)


def by_readings(matrices: Array, columns: Array) -> Array:
    """Products (V, n, i, m) of a matrix (n, i, k) of each reading with its columns (V, n, k, m), all variants' at once; in memory
    they lie by readings. Lone columns go one by one: other last digits would turn the draws of a promise."""
    V, n, k, m = columns.shape
    if m == 1:
        return np.asarray(matrices @ columns)
    every = matrices @ columns.transpose(1, 2, 0, 3).reshape(n, k, V * m)
    return np.asarray(every.reshape(*every.shape[:2], V, m).transpose(2, 0, 1, 3))


def together(active: Sequence[Active], seen: PlacedReadings) -> tuple[list[Array], Array, Array]:
    """Of effects: derivative (n, 9, m) of shift and displacement in the coefficients, one array each; the whole shift (n, 6) rad
    and the whole displacement (n, 3) m at their values. Of those that act there (`seen.active`), what one gives under another's
    torque is in the derivatives of both and counts once."""
    n = len(seen)
    whole = np.zeros((n, 9))
    parts = []
    for one in active:
        shift, point = motion(one.effect, one.joint, [one.scanned], seen)
        part = np.zeros((n, 9, one.effect.size))
        if shift is not None:
            part[:, :6] = shift[0]
        if point is not None:
            part[:, 6:] = point[0]
        whole += part @ one.a
        parts.append(part)
    torque, give = seen.more
    return parts, whole[:, :6] - torque * give, whole[:, 6:]


def without_effects(campaign: Campaign, state: State, effects: Sequence[Active], reference: float) -> Campaign:
    """The campaign that an arm without these effects would have given, to first order about a state: joints where the effects
    take them, reflectors without what comes on top. reference deg C: of the cell."""
    if not effects:
        return campaign
    r = campaign.readings
    shift, displacement = effects_on(campaign, r, r.point, state, effects, reference)
    return replace(campaign, readings=replace(r, q=r.q + shift, point=r.point - displacement))


def effects_on(
    campaign: Campaign, readings: Readings, point: Array, state: State, effects: Sequence[Active], reference: float
) -> tuple[Array, Array]:
    """What effects do to readings at an arm's state, their reflectors at about `point` (n, 3) m: shift (n, 6) rad of the joints,
    displacement (n, 3) m of the reflectors on top. reference deg C: of the cell."""
    believed = believed_compliance(campaign.robot)
    seen = PlacedReadings(campaign.robot, readings, campaign.instrument, state, point, reference, believed, tuple(effects))
    return together(effects, seen)[1:]


def shown_in(effects: Sequence[Active], readings: Readings) -> tuple[Active, ...]:
    """Effects that move the arm or its readings and for which these have the columns."""
    return tuple(a for a in effects if (a.effect.on_arm or a.effect.reading is not None) and has_columns(a.effect, readings))


def has_columns(effect: Effect, readings: Readings) -> bool:
    """Whether conditions have the columns that an effect needs."""
    return all(getattr(readings, COLUMNS[c], None) is not None for c in effect.needs if c in COLUMNS)
