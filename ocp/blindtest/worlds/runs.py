"""Which recordings a force world's log holds: lines, setpoints, feeds, belts, air runs, pauses; and those that are sealed.

As many rows as a morning at the machine gives: both directions on every line, a slow and a quick pass, a ladder of setpoints, a
belt that runs backwards and another speed, air runs, a pause of twenty minutes. Order and levels are drawn.
"""

from dataclasses import dataclass

import numpy as np

from ocp.blindtest.worlds.course import Course, Line
from robots.pose import Array
from robots.tracker_readings import Index

HZ = 100.0  # rows a second
GAP = 20.0  # s between runs
PAUSE = (900.0, 1500.0)  # s, once
LATE = (400.0, 900.0)  # s from the last run to the sealed ones
WARM, WARMING, COLD = 14.0, 900.0, 3.0  # K, s, K: how the wheel heats, and how warm it is at the start over the hall


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
class Rows:
    """Instants of recordings (n,): run, s m, time since the run's start s, and the runs themselves."""

    runs: tuple[Run, ...]
    run: Index
    s: Array
    time: Array

    def then(self, later: "Rows") -> "Rows":
        """These rows and later ones, one after the other."""
        run = np.concatenate([self.run, later.run + len(self.runs)])
        return Rows((*self.runs, *later.runs), run, np.append(self.s, later.s), np.append(self.time, later.time))

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
    lines = rng.permutation(3) + 1
    first = [Run(int(k), travel=d) for k in lines for d in (1, -1)]
    a, b, c = (int(k) for k in lines)
    others = [
        Run(a, feed=0.02), Run(b, feed=0.08, travel=-1), Run(a, setpoint=low), Run(c, setpoint=high), Run(b, setpoint=high),
        Run(b, belt=-speed), Run(c, belt=rng.choice([0.5, 1.25]) * speed, travel=-1), Run(c, setpoint=low, travel=-1),
    ]  # fmt: skip
    middle = [others[k] for k in rng.permutation(len(others))]
    last = [Run(a), Run(b, travel=-1), Run(c)]
    runs = [*first, Run(a, contact=False), *middle, *last, Run(b, contact=False)]
    runs = [_scaled(r, process) for r in runs]
    pause = {len(runs) - 4 - int(rng.integers(0, 3)): float(rng.uniform(*PAUSE))}
    timed, clock, ground = _timed(runs, 0.0, {}, pause)
    new = [
        Run(c, setpoint=low, feed=0.06), Run(b, setpoint=high, feed=0.03, travel=-1),
        Run(a, setpoint=round(0.5 * (process + high), 1), belt=0.75 * speed, travel=-1),
    ]  # fmt: skip
    sealed, _, _ = _timed([_scaled(r, process) for r in new], clock + float(rng.uniform(*LATE)), ground, {})
    return tuple(timed), tuple(sealed)


def _scaled(run: Run, process: float) -> Run:
    return Run(**{**vars(run), "setpoint": float(run.setpoint if run.setpoint != 20.0 else process), "belt": float(run.belt)})


def _timed(
    runs: list[Run], clock: float, ground: dict[int, int], pause: dict[int, float]
) -> tuple[list[Run], float, dict[int, int]]:
    """Runs with clock and grindings before; the clock after the last, and how often every line was ground."""
    found, ground = [], dict(ground)
    for k, run in enumerate(runs):
        clock += pause.get(k, 0.0)
        found.append(Run(**{**vars(run), "clock": clock, "ground_before": ground.get(run.line, 0)}))
        if run.contact:
            ground[run.line] = ground.get(run.line, 0) + 1
        clock += GAP + 0.072 / run.feed
    return found, clock, ground


def rows_of(course: Course, runs: tuple[Run, ...]) -> Rows:
    """Instants of runs at HZ, from one end of the line to the other."""
    index, s, time = [], [], []
    for k, run in enumerate(runs):
        line: Line = course.lines[run.line - 1]
        count = round(line.length / run.feed * HZ) + 1
        t = np.arange(count) / HZ
        way = np.minimum(run.feed * t, line.length)
        s.append(way if run.travel > 0 else line.length - way)
        time.append(t)
        index.append(np.full(count, k, np.int64))
    return Rows(runs, np.concatenate(index), np.concatenate(s), np.concatenate(time))
