"""What every force world grinds: lines on the blade, the joints taught for them, the recordings of a log; and what the sensor
would show of it without noise, with any effects inside and outside the catalogue.

All worlds of a check share the lines, so that the contact is solved once and kept, in the check's folder. The joints of a
machine bring its own blade to its own wheel, as somebody who taught the program on it would have them, to TAUGHT of a
millimetre. A log has as many rows as a morning at the machine gives: both directions on every line, a slow and a quick pass, a
ladder of setpoints, a belt that runs backwards and another speed, air runs, a pause of twenty minutes. Order and levels are
drawn, and so are those that are sealed. Contact, arm and sensor are the virtual cell's (`ocp.simulate.twin`).
"""

import pickle
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from functools import cache, partial
from pathlib import Path

import numpy as np
from scipy.interpolate import CubicSpline
from scipy.spatial.transform import Rotation

from ocp.blindtest.worlds.outside import GrindingInstants, moved_by
from ocp.blindtest.worlds.recipes import OUTSIDE, of_arm
from ocp.model.cell import Cell, read_cell
from ocp.shell.output import as_written, files_added
from ocp.simulate.twin.arm import Moments, VirtualArm, arm_moments, make_arm
from ocp.simulate.twin.collide import true_wheel
from ocp.simulate.twin.contact import ContactMoments, ContactResult
from ocp.simulate.twin.contact.grinder import make_grinder
from ocp.simulate.twin.contact.sensor import read_sensor
from ocp.simulate.twin.contact.table import Tables
from ocp.simulate.twin.contact.wheel_and_blade import belt_travel
from ocp.simulate.twin.path_motion import follow, frames, nominal_error, nominal_jacobian
from ocp.simulate.twin.run import true_blade
from ocp.simulate.twin.truth import Truth
from robots.errors import Infeasible
from robots.pose import Array, invert, make_transform
from robots.tracker_readings import Index
from trajectories.blade import Blade, find_shape, read_blade
from trajectories.passes import PassOptions, passes

STEP = 0.5e-3  # m between points of a line
UNIT = 2.4e-3  # m: lines are whole multiples, so that runs of all feeds begin and end at the same places
PLACES = (0.3, 0.65, 1.3)  # of a side's lines: two on the first side, one (less 1) on the other
DEPTH = 5.2e-4  # m of overlap that is taught: about what 20 N take
TAUGHT = 5e-5  # m, one sigma of a line's place as taught
KNOTS = 2.4e-3  # m between the points of a line that are taught
# A posture over the table with the blade hanging down, from which the inverse kinematics begins, deg.
BEGIN = np.radians([0.12, -85.6, 107.8, 179.0, -66.0, 96.2])
LEFT = 1e-6  # m, rad that may be left
HZ = 100.0  # rows a second
GAP = 20.0  # s between runs
PAUSE = (900.0, 1500.0)  # s, once
LATE = (400.0, 900.0)  # s from the last run to the sealed ones
WARM, WARMING, COLD = 14.0, 900.0, 3.0  # K, s, K: how the wheel heats, and how warm it is at the start over the hall


@dataclass(frozen=True, eq=False)
class GroundLine:
    """A line on the blade: number, length m, contacts p m, n, t (blade frame) as splines in s."""

    number: int
    length: float
    p: CubicSpline
    n: CubicSpline
    t: CubicSpline

    def at(self, s: Array) -> tuple[Array, Array, Array]:
        """p, n, t (k, 3) at s (k,) m, n and t unit and square to each other."""
        n = self.n(s) / np.linalg.norm(self.n(s), axis=1, keepdims=True)
        t = self.t(s) - n * (self.t(s) * n).sum(axis=1, keepdims=True)
        return self.p(s), n, t / np.linalg.norm(t, axis=1, keepdims=True)


@cache
def blade_lines(stl: Path, unit: str, cell_path: Path) -> tuple[Blade, tuple[GroundLine, ...]]:
    """A blade and lines spread over both of its sides. Raises BadInput as the blade's readers, Infeasible: a blade too short."""
    cell = read_cell(cell_path)
    blade = read_blade(stl, unit)
    piece, wheel = cell.workpiece, cell.wheel
    options = PassOptions(
        clamp_normal=tuple(piece.clamp_normal),
        clamp_offset=piece.clamp_offset,
        direction="spanwise",
        step=STEP,
        wheel_radius=wheel.radius,
        wheel_width=wheel.width,
    )
    laid, _ = passes(blade, find_shape(blade, piece.aerofoil), options)
    sides = [[p for p in laid if p.side == side] for side in dict.fromkeys(p.side for p in laid)]
    chosen = [sides[min(int(place), len(sides) - 1)] for place in PLACES]
    picked = [side[int(place % 1.0 * len(side))] for side, place in zip(chosen, PLACES, strict=True)]
    length = UNIT * np.floor(min(p.s[-1] for p in picked) / UNIT - 1e-9)
    if length < 10 * UNIT:
        raise Infeasible(f"{stl}: its lines are {1e3 * length:.0f} mm long, too short for a force world")
    curves = ((CubicSpline(path.s, values) for values in (path.p, path.n, path.t)) for path in picked)
    return blade, tuple(GroundLine(k + 1, float(length), *three) for k, three in enumerate(curves))


def taught(
    lines: Sequence[GroundLine], cell: Cell, truth: Truth, arm: VirtualArm, rng: np.random.Generator
) -> tuple[CubicSpline, ...]:
    """Joints (6,) over s of every line. Raises Infeasible: out of reach."""
    found = []
    for line in lines:
        s = np.linspace(0.0, line.length, round(line.length / KNOTS) + 1)
        goal = _goal(cell, truth, line, s, TAUGHT * rng.normal())
        q = _reached(cell, goal, line)
        for _ in range(4):
            still = arm_moments(q, cell.workpiece.payload_name, cell.tables.reference_temperature_C)
            error = nominal_error(goal, arm.flange(still))
            q = q + np.linalg.solve(nominal_jacobian(cell.robot, frames(cell.robot, q)), error[..., None])[..., 0]
        if np.abs(error).max() > 1e2 * LEFT:
            raise Infeasible(f"line {line.number} of the blade is out of reach of the robot")
        found.append(CubicSpline(s, q))
    return tuple(found)


def _reached(cell: Cell, goal: Array, line: GroundLine) -> Array:
    """Joints (k, 6) of the nominal arm along poses; the flange turned about its axis to the side that is ground."""
    robot = cell.robot
    guess = BEGIN.copy()
    first = np.asarray(line.n(0.0))
    guess[5] += np.arctan2(first[0], first[1]) * -robot.sign[5] if first[1] > 0 else -np.pi
    found, left = follow(robot, goal, guess)
    if left.max() > LEFT or not np.all((found > robot.q_min) & (found < robot.q_max)):
        raise Infeasible(f"line {line.number} of the blade is out of reach of the robot")
    return found


def _goal(cell: Cell, truth: Truth, line: GroundLine, s: Array, off: float) -> Array:
    """Poses (k, 4, 4) of the flange that bring this machine's contacts to its wheel, `off` m too deep, the feed downward."""
    out = -cell.wheel.contact_direction
    wheel = true_wheel(cell, truth)
    down = np.cross(wheel.axis, out)
    p, n, t = line.at(s)
    own = np.stack([n, t, np.cross(n, t)], axis=2)
    wanted = np.stack([out, down, np.cross(out, down)], axis=1)
    R = wanted @ np.swapaxes(own, 1, 2)
    place = wheel.centre - (wheel.radius - DEPTH - off) * out
    T = make_transform(R, place - np.einsum("kij,kj->ki", R, p))
    return np.asarray(T @ invert(true_blade(cell, truth)))


@dataclass(frozen=True)
class Run:
    """A recording: number of the line, setpoint N, feed m/s, belt m/s with sign, travel +1 or -1 along s, in contact or with the
    flange drawn back; clock s at its start; how often the line was ground before."""

    line: int
    setpoint: float = 20.0
    feed: float = 0.04
    belt: float = 20.0
    travel: int = 1
    contact: bool = True
    clock: float = 0.0
    ground_before: int = 0


@dataclass(frozen=True, eq=False)
class RunRows:
    """Instants of recordings (n,): run, s m, time since the run's start s, and the runs themselves."""

    runs: tuple[Run, ...]
    run: Index
    s: Array
    time: Array

    def then(self, later: "RunRows") -> "RunRows":
        """These rows and later ones, one after the other."""
        run = np.concatenate([self.run, later.run + len(self.runs)])
        return RunRows((*self.runs, *later.runs), run, np.append(self.s, later.s), np.append(self.time, later.time))

    def each(self, name: str) -> Array:
        """A field of the runs at every instant (n,)."""
        return np.array([getattr(r, name) for r in self.runs])[self.run]

    @property
    def clock(self) -> Array:
        """Campaign's clock (n,) s."""
        return np.asarray(self.each("clock") + self.time)

    @property
    def wheel_warmth(self) -> Array:
        """Temperature of the wheel over the hall's at the start (n,) K."""
        return np.asarray(COLD + WARM * (1 - np.exp(-self.clock / WARMING)))


def drawn_runs(rng: np.random.Generator, process: float, speed: float) -> tuple[tuple[Run, ...], tuple[Run, ...]]:
    """Runs of a log and its sealed ones; process force N and belt speed m/s of the cell."""
    low, high = round(process * rng.uniform(0.6, 0.8)), round(process * rng.uniform(1.3, 1.5))
    order = rng.permutation(3) + 1
    first = [Run(int(k), travel=d) for k in order for d in (1, -1)]
    a, b, c = (int(k) for k in order)
    others = [Run(a, feed=0.02), Run(b, feed=0.08, travel=-1), Run(a, setpoint=low), Run(c, setpoint=high), Run(b, setpoint=high)]
    others += [Run(b, belt=-speed), Run(c, belt=rng.choice([0.5, 1.25]) * speed, travel=-1), Run(c, setpoint=low, travel=-1)]
    middle = [others[k] for k in rng.permutation(len(others))]
    last = [Run(a), Run(b, travel=-1), Run(c)]
    runs = [*first, Run(a, contact=False), *middle, *last, Run(b, contact=False)]
    runs = [_scaled(r, process) for r in runs]
    pause = {len(runs) - 4 - int(rng.integers(0, 3)): float(rng.uniform(*PAUSE))}
    timed, clock, ground = _timed(runs, 0.0, {}, pause)
    new = [Run(c, setpoint=low, feed=0.06), Run(b, setpoint=high, feed=0.03, travel=-1)]
    new += [Run(a, setpoint=round(0.5 * (process + high), 1), belt=0.75 * speed, travel=-1)]
    sealed, _, _ = _timed([_scaled(r, process) for r in new], clock + float(rng.uniform(*LATE)), ground, {})
    return tuple(timed), tuple(sealed)


def _scaled(run: Run, process: float) -> Run:
    return replace(run, setpoint=float(run.setpoint if run.setpoint != 20.0 else process), belt=float(run.belt))


def _timed(
    runs: list[Run], clock: float, ground: dict[int, int], pause: dict[int, float]
) -> tuple[list[Run], float, dict[int, int]]:
    """Runs with clock and grindings before; the clock after the last, and how often every line was ground."""
    found, ground = [], dict(ground)
    for k, run in enumerate(runs):
        clock += pause.get(k, 0.0)
        found.append(replace(run, clock=clock, ground_before=ground.get(run.line, 0)))
        if run.contact:
            ground[run.line] = ground.get(run.line, 0) + 1
        clock += GAP + 0.072 / run.feed
    return found, clock, ground


def rows_of_runs(lines: Sequence[GroundLine], runs: tuple[Run, ...]) -> RunRows:
    """Instants of runs at HZ, from one end of the line to the other."""
    index, s, time = [], [], []
    for k, run in enumerate(runs):
        line = lines[run.line - 1]
        count = round(line.length / run.feed * HZ) + 1
        t = np.arange(count) / HZ
        way = np.minimum(run.feed * t, line.length)
        s.append(way if run.travel > 0 else line.length - way)
        time.append(t)
        index.append(np.full(count, k, np.int64))
    return RunRows(runs, np.concatenate(index), np.concatenate(s), np.concatenate(time))


SAVED_FROM = 24  # contacts solved anew, from which the store is written again
_STORES: dict[Path, Tables] = {}
_Settled = tuple[Array, Array, Array, Callable[[Array], Array] | None]


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
        q, T, compliance, bent = self._settled(truth, rows, hall, rng)
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
        if bent is not None:
            asked = grinder.borne(asked, bent)
        result = grinder.force(asked)
        fn, ft = read_sensor(truth, result, asked, np.random.default_rng(0))
        if strange:
            fn = fn + outside("reading", replace(at, force=result.force))
        return Log(rows, q, shown, result, fn, ft * (1 + gains[0]) + gains[1])

    def _settled(self, truth: Truth, rows: RunRows, hall: Array, rng: np.random.Generator | None) -> _Settled:
        """Joints (n, 6), the flange's poses (n, 4, 4) and compliances (n, 6, 6), those under wrenches (n, 6) where they go with
        these; kept for each set of effects of the arm."""
        weights = truth.mass_scale.tobytes(), truth.mass_shift.tobytes(), repr(truth.payloads)
        key = (id(rows), id(truth.placement), *weights, repr(of_arm(truth.effects)))
        if rng is None and key in self.settled:
            return self.settled[key]
        still = self.still(rows, hall)
        arm = make_arm(self.cell, truth)
        at = arm.settled(still, rng)
        found = still.q, at.links[:, 6], arm.compliance_at(at), partial(arm.compliance_at, at) if arm.bends_on else None
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
