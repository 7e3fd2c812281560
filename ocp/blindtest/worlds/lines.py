"""What every force world grinds: lines on the blade, the joints taught for them, and the recordings of a log.

All worlds of a check share the lines, so that the contact is solved once and kept. The joints of a machine bring its own blade
to its own wheel, as somebody who taught the program on it would have them, to TAUGHT of a millimetre. A log has as many rows as a
morning at the machine gives: both directions on every line, a slow and a quick pass, a ladder of setpoints, a belt that runs
backwards and another speed, air runs, a pause of twenty minutes. Order and levels are drawn, and so are those that are sealed.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path

import numpy as np
from scipy.interpolate import CubicSpline

from ocp.model.cell import Cell, read_cell
from ocp.simulate.twin.arm import VirtualArm, arm_moments
from ocp.simulate.twin.collide import true_wheel
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
