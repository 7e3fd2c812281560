"""What the sensor of a grinding machine would show without noise, with any effects inside and outside the catalogue.

Contact, arm and sensor are the virtual cell's (`ocp.simulate.twin`); solutions of the contact are kept in the check's folder.
"""

import pickle
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
from scipy.interpolate import CubicSpline
from scipy.spatial.transform import Rotation

from ocp.blindtest.worlds.lines import GroundLine, RunRows
from ocp.blindtest.worlds.outside import GrindingInstants, moved_by
from ocp.blindtest.worlds.recipes import OUTSIDE, of_arm
from ocp.model.cell import Cell
from ocp.shell.output import as_written, files_added
from ocp.simulate.twin.arm import Moments, arm_moments, make_arm
from ocp.simulate.twin.contact import ContactMoments, ContactResult
from ocp.simulate.twin.contact.grinder import make_grinder
from ocp.simulate.twin.contact.sensor import read_sensor
from ocp.simulate.twin.contact.table import Tables
from ocp.simulate.twin.contact.wheel_and_blade import belt_travel
from ocp.simulate.twin.truth import Truth
from robots.pose import Array
from trajectories.blade import Blade

SAVED_FROM = 24  # contacts solved anew, from which the store is written again
_STORES: dict[Path, Tables] = {}
_Settled = tuple[Array, Array, Array]


@dataclass(frozen=True, eq=False)
class Log:
    """What happened at n instants: moments of the contact, the contact, readings fn, ft (n,) N without noise; q (n, 6) rad."""

    rows: RunRows
    q: Array
    moments: ContactMoments
    result: ContactResult
    fn: Array
    ft: Array

    def last(self, rows: RunRows) -> "Log":
        """The last of the instants, those of `rows`."""
        last = slice(-len(rows.s), None)
        moments = replace(self.moments.take(last), run=rows.run)
        return Log(rows, self.q[last], moments, self.result.take(last), self.fn[last], self.ft[last])

    @property
    def both(self) -> Array:
        """Readings (2, n) N."""
        return np.stack([self.fn, self.ft])


@dataclass(frozen=True, eq=False)
class Bench:
    """A cell, its blade and the lines on it, the joints taught for them, and the contact's store."""

    cell: Cell
    blade: Blade
    lines: tuple[GroundLine, ...]
    joints: tuple[CubicSpline, ...]
    tables: Tables
    settled: dict[tuple[object, ...], _Settled] = field(default_factory=dict)

    def log(
        self,
        truth: Truth,
        rows: RunRows,
        hall: Array,
        rng: np.random.Generator | None = None,
        moved: Array | None = None,
        gains: tuple[float, float] = (0.0, 0.0),
    ) -> Log:
        """Readings without noise of a truth; hall (n,) deg C; rng: joints repeat as badly as they do; moved (6,) or (n, 6): twist
        m, rad of the flange about its origin, base axes; gains: gain and zero (N) of the tangential axis."""
        strange = [p for p in truth.effects if p.effect in OUTSIDE]
        truth = replace(truth, effects=tuple(p for p in truth.effects if p.effect not in OUTSIDE), sensor_sigma=0.0)
        q, T, compliance = self._settled(truth, rows, hall, rng)
        if moved is not None:
            twist, T = np.broadcast_to(moved, (len(q), 6)).copy(), T.copy()
            T[:, :3, 3] += twist[:, :3]
            T[:, :3, :3] = Rotation.from_rotvec(twist[:, 3:]).as_matrix() @ T[:, :3, :3]
        asked = shown = self._asked(rows, T, compliance, hall)
        grinder = make_grinder(self.cell, truth, self.blade, self.tables)
        seen = rows.s, rows.each("travel"), rows.time, rows.clock, asked.belt, belt_travel(asked)
        at = GrindingInstants(*seen, radius=self.cell.wheel.radius, force=np.zeros(len(q)), q=q)

        def outside(what: str, at: GrindingInstants) -> Array:
            return sum((amount for _, amount in moved_by(OUTSIDE, strange, what, at)), np.zeros(len(q)))

        if strange:
            T = T.copy()
            T[:, :3, 3] -= outside("overlap", at)[:, None] * self.cell.wheel.contact_direction
            asked = replace(asked, T_base_flange=T, setpoint=asked.setpoint + outside("push", at))
        result = grinder.force(asked)
        fn, ft = read_sensor(truth, result, asked, np.random.default_rng(0))
        if strange:
            fn = fn + outside("reading", replace(at, force=result.force))
        return Log(rows, q, shown, result, fn, ft * (1 + gains[0]) + gains[1])

    def _settled(self, truth: Truth, rows: RunRows, hall: Array, rng: np.random.Generator | None) -> _Settled:
        """Joints (n, 6), the flange's poses (n, 4, 4) and compliances (n, 6, 6); kept for each set of effects of the arm."""
        weights = truth.mass_scale.tobytes(), truth.mass_shift.tobytes(), repr(truth.payloads)
        key = (id(rows), id(truth.placement), *weights, repr(of_arm(truth.effects)))
        if rng is None and key in self.settled:
            return self.settled[key]
        still = self.still(rows, hall)
        arm = make_arm(self.cell, truth)
        at = arm.settled(still, rng)
        found = still.q, at.links[:, 6], arm.compliance_at(at)
        if rng is None:
            self.settled[key] = found
        return found

    def still(self, rows: RunRows, hall: Array) -> Moments:
        """The arm's moments on the path."""
        line, q, rate = rows.each("line"), np.empty((len(rows.s), 6)), np.empty((len(rows.s), 6))
        for k, spline in enumerate(self.joints):
            own = line == k + 1
            q[own], rate[own] = spline(rows.s[own]), spline(rows.s[own], 1)
        approach = np.sign(rate * (rows.each("travel") * rows.each("feed"))[:, None])
        return arm_moments(q, self.cell.workpiece.payload_name, hall, approach, rows.clock, visit=rows.run)

    def _asked(self, rows: RunRows, T: Array, compliance: Array, hall: Array) -> ContactMoments:
        n = len(rows.s)
        p, normal, t = (np.empty((n, 3)) for _ in range(3))
        line = rows.each("line").astype(np.int64)
        for one in self.lines:
            own = line == one.number
            p[own], normal[own], t[own] = one.at(rows.s[own])
        return ContactMoments(
            T_base_flange=T,
            arm_compliance=compliance,
            p=p,
            n=normal,
            t=t,
            s=rows.s,
            line=line,
            contact=rows.each("contact").astype(bool),
            clock_s=rows.clock,
            time_s=rows.time,
            run=rows.run,
            wheel_temperature_C=self.cell.tables.reference_temperature_C + rows.wheel_warmth,
            temperature_C=hall,
            **{name: rows.each(name) for name in ("setpoint", "feed", "belt", "ground_before")},
        )


def store_of(path: Path, make: Callable[[], Tables]) -> Tables:
    """Solutions of the contact kept in a file and in this process."""
    if path not in _STORES:
        _STORES[path] = pickle.loads(path.read_bytes()) if as_written(path, path.parent) else make()
    return _STORES[path]


def save_store(path: Path, tables: Tables, before: int) -> None:
    """Write the store where it grew, with what another process may have written meanwhile; whole or not at all."""
    if len(tables.nodes) < before + SAVED_FROM:
        return
    if as_written(path, path.parent):
        other: Tables = pickle.loads(path.read_bytes())
        tables.nodes.update(other.nodes)
        tables.solid.update(other.solid)
    with files_added(path.parent) as part:
        (part / path.name).write_bytes(pickle.dumps(tables))
