"""A machine of a force world: what its sensor would show without noise, with any effects, and the files of its log.

Contact, arm and sensor are the virtual cell's (`ocp.simulate.twin`); solutions of the contact are kept in the check's folder.
"""

import os
import pickle
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, fields, replace
from pathlib import Path

import numpy as np
from scipy.interpolate import CubicSpline

from ocp.blindtest.worlds.course import Course
from ocp.blindtest.worlds.force_outside import KINDS as OUTSIDE
from ocp.blindtest.worlds.force_outside import Instants, overlaps, pushes, readings
from ocp.blindtest.worlds.runs import Rows
from ocp.model.cell import Cell
from ocp.simulate.twin.arm.arm import Moments, make_arm, moments
from ocp.simulate.twin.contact import ContactMoments, ContactResult, Tables, make_grinder, read_sensor
from ocp.simulate.twin.contact.wheel import belt_travel
from ocp.simulate.twin.truth.kinds_arm import KINDS as ARM_KINDS
from ocp.simulate.twin.truth.machine import Truth
from ocp.simulate.twin.truth.planting import Planted
from robots.pose import Array

SAVED_FROM = 24  # contacts solved anew, from which the store is written again
ARM = frozenset(kind.name for kind in ARM_KINDS)
_KEPT: dict[Path, Tables] = {}
_Settled = tuple[Array, Array, Array]


@dataclass(frozen=True, eq=False)
class Log:
    """What happened at n instants: moments of the contact, the contact, readings fn, ft (n,) N without noise; q (n, 6) rad."""

    rows: Rows
    q: Array
    moments: ContactMoments
    result: ContactResult
    fn: Array
    ft: Array

    def last(self, rows: Rows) -> "Log":
        """The last of the instants, those of `rows`."""
        n = len(rows.s)
        names = [f.name for f in fields(self.moments)]
        moments = replace(self.moments, **{name: getattr(self.moments, name)[-n:] for name in names})
        moments = replace(moments, run=rows.run)
        result = ContactResult(**{f.name: getattr(self.result, f.name)[-n:] for f in fields(self.result)})
        return Log(rows, self.q[-n:], moments, result, self.fn[-n:], self.ft[-n:])

    @property
    def both(self) -> Array:
        """Readings (2, n) N."""
        return np.stack([self.fn, self.ft])


@dataclass(frozen=True, eq=False)
class Bench:
    """A cell, the lines, the joints taught for them, and the contact's store."""

    cell: Cell
    course: Course
    joints: tuple[CubicSpline, ...]
    tables: Tables
    settled: dict[tuple[object, ...], _Settled] = field(default_factory=dict)

    def log(self, truth: Truth, rows: Rows, hall: Array, rng: np.random.Generator | None = None, moved: Array | None = None,
            gains: tuple[float, float] = (0.0, 0.0)) -> Log:  # fmt: skip
        """Readings without noise of a truth; hall (n,) deg C; rng: joints repeat as badly as they do; moved (6,) or (n, 6): twist
        m, rad of the flange about its origin, base axes; gains: gain and zero (N) of the tangential axis."""
        inside = tuple(p for p in truth.effects if p.effect not in OUTSIDE)
        strange = [p for p in truth.effects if p.effect in OUTSIDE]
        truth = replace(truth, effects=inside, sensor_sigma=0.0)
        q, T, give = self._settled(truth, rows, hall, rng)
        if moved is not None:
            T = _twisted(T, np.broadcast_to(moved, (len(q), 6)).copy())
        asked = told = self._asked(rows, T, give, hall)
        grinder = make_grinder(self.cell, truth, self.course.blade, self.tables)
        if strange:
            at = self._instants(rows, q, asked)
            deeper, pushed = (np.sum([f(p, at) for p in strange], axis=0) for f in (overlaps, pushes))
            T = T.copy()
            T[:, :3, 3] -= deeper[:, None] * self.cell.wheel.contact_direction
            asked = replace(asked, T_base_flange=T, setpoint=asked.setpoint + pushed)
        result = grinder.force(asked)
        fn, ft = read_sensor(truth, result, asked, np.random.default_rng(0))
        if strange:
            fn = fn + np.sum([readings(p, replace(at, force=result.force)) for p in strange], axis=0)
        return Log(rows, q, told, result, fn, ft * (1 + gains[0]) + gains[1])

    def _settled(self, truth: Truth, rows: Rows, hall: Array, rng: np.random.Generator | None) -> _Settled:
        """Joints (n, 6), the flange's poses (n, 4, 4) and compliances (n, 6, 6); kept for each set of effects of the arm."""
        own = tuple(p for p in truth.effects if p.effect in ARM)
        key = (id(rows), id(truth.placement), truth.mass_scale.tobytes(), repr(own))
        if rng is None and key in self.settled:
            return self.settled[key]
        still = self.still(rows, hall)
        arm = make_arm(self.cell, truth)
        at = arm.settled(still, rng)
        found = still.q, at.links[:, 6], arm.give(at)
        if rng is None:
            self.settled[key] = found
        return found

    def still(self, rows: Rows, hall: Array) -> Moments:
        """The arm's moments on the path."""
        line, travel, feed = rows.each("line"), rows.each("travel"), rows.each("feed")
        q, rate = np.empty((len(rows.s), 6)), np.empty((len(rows.s), 6))
        for k, spline in enumerate(self.joints):
            own = line == k + 1
            q[own], rate[own] = spline(rows.s[own]), spline(rows.s[own], 1)
        approach = np.sign(rate * (travel * feed)[:, None])
        piece = self.cell.workpiece.payload
        name = "" if piece is None else piece.name
        return moments(q, name, hall, approach, rows.clock, visit=rows.run)

    def _asked(self, rows: Rows, T: Array, give: Array, hall: Array) -> ContactMoments:
        n = len(rows.s)
        p, normal, t = (np.empty((n, 3)) for _ in range(3))
        line = rows.each("line").astype(np.int64)
        for one in self.course.lines:
            own = line == one.number
            p[own], normal[own], t[own] = one.at(rows.s[own])
        return ContactMoments(
            T_base_flange=T, arm_compliance=give, p=p, n=normal, t=t, s=rows.s, line=line,
            setpoint=rows.each("setpoint"), feed=rows.each("feed"), belt=rows.each("belt"),
            contact=rows.each("contact").astype(bool), clock_s=rows.clock, time_s=rows.time, run=rows.run,
            ground_before=rows.each("ground_before"),
            wheel_temperature_C=self.cell.tables.reference_temperature_C + rows.wheel_warmth, temperature_C=hall,
        )  # fmt: skip

    def _instants(self, rows: Rows, q: Array, asked: ContactMoments) -> Instants:
        return Instants(
            s=rows.s, travel=rows.each("travel"), time=rows.time, clock=rows.clock, belt=asked.belt, way=belt_travel(asked),
            radius=self.cell.wheel.radius, force=np.zeros(len(q)), q=q,
        )  # fmt: skip


def _twisted(T: Array, twist: Array) -> Array:
    """Flange poses (n, 4, 4) moved by small twists (n, 6) about their origins."""
    from scipy.spatial.transform import Rotation

    out = T.copy()
    out[:, :3, 3] += twist[:, :3]
    out[:, :3, :3] = Rotation.from_rotvec(twist[:, 3:]).as_matrix() @ T[:, :3, :3]
    return out


def store_of(path: Path, make: Callable[[], Tables]) -> Tables:
    """Solutions of the contact kept in a file and in this process."""
    if path not in _KEPT:
        _KEPT[path] = pickle.loads(path.read_bytes()) if path.is_file() else make()
    return _KEPT[path]


def keep(path: Path, tables: Tables, before: int) -> None:
    """Write the store where it grew, with what another process may have written meanwhile; whole or not at all."""
    if len(tables.nodes) < before + SAVED_FROM:
        return
    if path.is_file():
        other: Tables = pickle.loads(path.read_bytes())
        tables.nodes.update(other.nodes)
        tables.solid.update(other.solid)
    part = path.with_suffix(f".{os.getpid()}.part")
    part.write_bytes(pickle.dumps(tables))
    part.replace(path)


def effects_of(truth: Truth, effects: Sequence[Planted]) -> Truth:
    """The same machine with these effects."""
    return replace(truth, effects=tuple(effects))
