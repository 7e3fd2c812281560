"""The waves of time and path that a force log speaks for most: a chatter, a saw along a scarred guide, a wheel that is not round.

Of the whitened residual e = W y about a fit, with y = W^T e and unit waves c, s of one number,

    gain = ((c^T y)^2 + (s^T y)^2) / (1/2 (|W c|^2 + |W s|^2)),

the squares that the wave takes from the residual; lengths are taken at a few numbers and interpolated. What averages over
blocks lose of the picked ones is kept as rows of their own (`log_averages.py`).
"""

from collections.abc import Iterable, Iterator

import numpy as np

from ocp.diagnose.engine.channel_system import Wave
from ocp.diagnose.force.fit import EffectFit, ForceProblem
from ocp.diagnose.rules import LEAST_WAVES, WAVES_PICKED
from robots.pose import Array

TURNS = (1, 2, 3, 4)  # waves per revolution of the wheel
HIGHEST = 0.8  # of half the logging rate
SHORTEST = 3e-3  # m, of a wave along the path
FINE = 4  # numbers tried in the width of a line
PROBES = 12


def telling_waves(problem: ForceProblem, fit: EffectFit) -> tuple[Wave, ...]:
    """All of the wheel's turn, and of each other kind the few whose gain is largest, each over its neighbours."""
    log, c = problem.log, problem.scene.conditions
    touching = log.contact.astype(float)
    turned = c.belt / problem.scene.cell.wheel.radius * c.time / (2 * np.pi)
    found = [Wave("turn", float(k), touching[:, None] * _both(k * turned), len(TURNS)) for k in TURNS if np.ptp(turned) > 1.0]
    n = len(log)
    white = fit.whiteners[0]
    y = white.back(fit.residual[:n, None])[:, 0]
    for where, along, weight, highest in _kinds(problem, fit):
        # Everything within a run is seen against the run's own mean: the longest stretch sets how many waves differ.
        length = max(float(np.ptp(along[(c.run == r) & log.contact])) for r in np.unique(c.run[log.contact]))
        lowest = LEAST_WAVES / max(length, 1e-9)
        if highest < 2 * lowest:
            continue
        numbers = np.arange(lowest, highest, 1.0 / (FINE * length))
        masked = touching * weight
        waves = np.exp(2j * np.pi * np.outer(numbers, along))
        score = np.abs(waves @ (masked * y)) ** 2
        probes = np.unique(np.linspace(0, len(numbers) - 1, PROBES).round().astype(int))
        sizes = [float(np.sum(white.whole(masked[:, None] * _both(numbers[k] * along)) ** 2)) / 2 for k in probes]
        gain = score / np.interp(numbers, numbers[probes], sizes)
        among = max(int(len(numbers) / 2), WAVES_PICKED)
        for k in _peaks(gain):
            found.append(Wave(where, float(numbers[k]), masked[:, None] * _both(numbers[k] * along), among))
    return tuple(found)


def picked_squares(waves: Iterable[Wave]) -> float:
    """Squares beyond their number that noise alone has in the rows of waves that were picked among many."""
    return float(sum(2.0 * np.log(w.among) - 2.0 for w in waves if w.where != "turn"))


def _kinds(problem: ForceProblem, fit: EffectFit) -> Iterator[tuple[str, Array, Array, float]]:
    """What waves may go with: its name, the coordinate (n,), a sign (n,), the highest number."""
    log, c = problem.log, problem.scene.conditions
    steps = np.diff(log.time)[np.diff(log.run) == 0]
    one = np.ones(len(log))
    # Beside a train of knocks a wave in time is what its bell leaves, at any overtone or its image.
    knocking = any("hz" in one.scanned for one in fit.active)
    if len(steps) and np.median(steps) > 0 and not knocking:
        yield "time wave", c.time, one, HIGHEST / (2.0 * float(np.median(steps)))
    way = np.abs(np.diff(c.s))[np.diff(log.run) == 0]
    if len(way) and np.median(way) > 0:
        highest = min(1.0 / SHORTEST, HIGHEST / (2.0 * float(np.median(way))))
        yield "s wave", c.s, one, highest
        if np.ptp(c.travel) > 0:
            yield "s wave x travel", c.s, c.travel, highest


def _both(turns: Array) -> Array:
    """Cosine and sine (n, 2) of so many turns (n,)."""
    return np.column_stack([np.cos(2 * np.pi * turns), np.sin(2 * np.pi * turns)])


def _peaks(gain: Array) -> list[int]:
    """Indices of the largest gains, a line's width apart."""
    left, found = gain.copy(), list[int]()
    while len(found) < WAVES_PICKED and left.max() > 0:
        k = int(np.argmax(left))
        found.append(k)
        left[max(0, k - FINE) : k + FINE + 1] = 0.0
    return found
