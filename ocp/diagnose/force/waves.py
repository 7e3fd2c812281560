"""The waves of time and path, and the trains of knocks of a belt's splice, that a force log speaks for most.

**Waves**: a chatter, a wheel that is not round. Of the whitened residual e = W y about a fit, with y = W^T e and unit waves c, s
of one number,

    gain = ((c^T y)^2 + (s^T y)^2) / (1/2 (|W c|^2 + |W s|^2)),

the squares that the wave takes from the residual; lengths are taken at a few numbers and interpolated. Of time and of the
wheel's turn there are waves of one number whose phase each run has for itself (a hum, a wheel that turned on between runs): their
gains are sums over runs. A train that is none, whose knocks fall on such a wave by an alias of the campaign's clock, explains
less. **Periods** are waves with overtones, a saw along a scarred guide: their gains are sums; knocks in time have many. What
averages over blocks lose of the picked ones is kept as rows of their own (`log_averages.py`).

**Trains**: a knock a hundred times shorter than a run, among 10 rates a second and all places of a turn: far too many variants to
linearise each. With y = W^T e as above, a train of bells h at rate f, place p and length w has

    h . y = sum over m of c_m Re(exp(2 pi i m p) S(m f)),   c_m = (2 pi)^(1/2) w exp(-2 (pi m w)^2), twice that for m > 0

with S(g) = sum of y exp(-2 pi i g t) (Poisson summation): from S all variants are scored, the best few again with their exact
columns. The others count in the prior odds: `among` as sharp ones fit into all rates, places and lengths. Only the normal reading
is looked at: whether a knock rubs is not known before.
"""

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.special import chdtrc, chdtri

from ocp.diagnose import rules
from ocp.diagnose.engine.channel_system import Wave
from ocp.diagnose.engine.kernels import BY_RUN
from ocp.diagnose.force.fit import EffectFit, ForceProblem
from ocp.effects.belt_splice import LENGTHS, RATES, USUAL
from ocp.effects.effect import Scanned
from robots.pose import Array, Mask

TURNS = (1, 2, 3, 4)  # waves per revolution of the wheel
HIGHEST = 0.8  # of half the logging rate
SHORTEST = 2e-3  # m, of a wave along the path
FINE = 4  # numbers tried in the width of a line
LENGTH_PROBES = 12
SIDE = 16  # numbers between two whose waves are taken whole


def telling_waves(problem: ForceProblem, fit: EffectFit) -> tuple[Wave, ...]:
    """All of the wheel's turn, and of each other kind the few whose gain is largest, each over its neighbours."""
    log, c = problem.log, problem.scene.conditions
    touching = log.contact.astype(float)
    turned = c.belt / problem.scene.cell.wheel.radius * c.time / (2 * np.pi)
    found = [Wave("turn", float(k), touching[:, None] * _both(k * turned), len(TURNS)) for k in TURNS if np.ptp(turned) > 1.0]
    if not fit.residual.any():  # imagined readings speak for none
        return tuple(found)
    y = fit.whiteners[0].back(fit.residual[: len(log), None])[:, 0]
    if found:
        found += _apart(problem, fit, y, "turn wave" + BY_RUN, np.array(TURNS, float), turned, 1)
    for where, along, weight, highest in _kinds(problem, fit):
        # Everything within a run is seen against the run's own mean: the longest stretch sets how many waves differ.
        length = max(float(np.ptp(along[(c.run == r) & log.contact])) for r in np.unique(c.run[log.contact]))
        lowest = rules.LEAST_WAVES / max(length, 1e-9)
        if highest < 2 * lowest:
            continue
        numbers = np.arange(lowest, highest, 1.0 / (FINE * length))
        masked = touching * weight
        score = np.abs(_transform(numbers, along, masked * y)) ** 2
        probes = np.unique(np.linspace(0, len(numbers) - 1, LENGTH_PROBES).round().astype(int))
        sizes = _lengths(fit, masked, numbers[probes], along).sum(axis=1)
        gain = score / np.interp(numbers, numbers[probes], sizes)
        if where == "time wave":
            # Where trains have their tones, up to half the logging rate; slower ones would follow what smooth functions are for.
            finer = np.arange(max(lowest, RATES[0]), highest / HIGHEST, 1.0 / (FINE * rules.OVERTONES * length))
            found += _apart(problem, fit, y, "time wave" + BY_RUN, finer, along, rules.OVERTONES)
            found += _knocks(numbers, gain, highest / HIGHEST, along, touching)
        among = max(int(len(numbers) / 2), rules.WAVES_PICKED)
        waves = [(where, numbers[k], 1) for k in _peaks(gain)]
        tones = np.arange(1, rules.OVERTONES + 1)
        able = numbers[numbers * rules.OVERTONES <= numbers[-1]]
        periods = np.sum([np.interp(tone * able, numbers, gain) for tone in tones], axis=0)
        for k in _peaks(periods):
            # The last tone's lines are as many times narrower.
            near = able[k] + np.linspace(-1.0, 1.0, 4 * rules.OVERTONES + 1) / (FINE * length)
            every = np.outer(tones, near).ravel()
            gains = np.abs(np.exp(2j * np.pi * np.outer(every, along)) @ (masked * y)) ** 2
            best = np.argmax((gains / np.interp(every, numbers[probes], sizes)).reshape(len(tones), -1).sum(axis=0))
            waves.append((where.replace("wave", "period"), near[best], len(tones)))
        for name, number, count in waves:
            columns = [_both(tone * number * along) for tone in range(1, count + 1)]
            found.append(Wave(name, float(number), masked[:, None] * np.hstack(columns), among))
    return tuple(found)


def _knocks(numbers: Array, gain: Array, half: float, along: Array, touching: Array) -> Iterator[Wave]:
    """The period of many tones that gains most, where that is more than chance; a tone beyond `half` the logging rate is read at
    its image. numbers, gain (k,): of single waves; along (n,): what is even of the log's time."""
    rates = np.arange(RATES[0], half, (numbers[1] - numbers[0]) / rules.KNOCKING)
    if not len(rates):  # so slow a log shows none
        return
    tones = np.outer(np.arange(1, rules.KNOCKING + 1), rates)
    image = np.abs(tones - 2 * half * np.round(tones / (2 * half)))
    order = np.argsort(image, axis=0)
    tones, image = np.take_along_axis(tones, order, 0), np.take_along_axis(image, order, 0)
    apart = np.diff(image, axis=0, prepend=-np.inf) > FINE * (numbers[1] - numbers[0])  # tones of one image are one
    inside = apart & (image >= numbers[0]) & (image <= numbers[-1])
    gained = np.sum(np.where(inside, np.interp(image, numbers, gain), 0.0), axis=0)
    best = int(np.argmax(gained))
    if len(rates) * chdtrc(2 * inside[:, best].sum(), gained[best]) < rules.PLACE_SURE:
        columns = np.hstack([_both(tone * along) for tone in tones[inside[:, best], best]]) / rules.KNOCKING  # together 1 high
        yield Wave("time knocks", float(rates[best]), touching[:, None] * columns, len(rates) // 2)


def _apart(
    problem: ForceProblem, fit: EffectFit, y: Array, where: str, numbers: Array, along: Array, most: int
) -> Iterator[Wave]:
    """Of waves of evenly spaced numbers with a phase of their own in each run, alone and as periods of `most` tones, those that
    gain most, where that is more than chance; none of a single run, of very many, or where none is fast enough."""
    log = problem.log
    if not len(numbers) or most * numbers[0] > numbers[-1]:
        return
    runs = [(log.run == r) & log.contact for r in np.unique(log.run[log.contact])]
    each = np.array([own for own in runs if np.ptp(along[own]) * numbers[0] > 1.0])  # a wheel that stands makes no waves
    if not 1 < len(each) <= rules.RUNS_APART:
        return
    probes = np.unique(np.linspace(0, len(numbers) - 1, LENGTH_PROBES).round().astype(int))
    gain = np.zeros(len(numbers))
    for own, size in zip(each, each @ _lengths(fit, log.contact, numbers[probes], along).T, strict=True):
        gain += np.abs(_transform(numbers, along[own], y[own])) ** 2 / np.interp(numbers, numbers[probes], size)
    for count, name in {most: where.replace("wave", "period"), 1: where}.items():
        tones, able = np.arange(1, count + 1), numbers[numbers * count <= numbers[-1]]
        gained = np.sum([np.interp(tone * able, numbers, gain) for tone in tones], axis=0)
        if len(able) * chdtrc(2 * count * len(each), gained.max()) > rules.PLACE_SURE:
            continue  # chance makes as much, and every column is carried through all that follows
        best = float(able[gained.argmax()])
        columns = np.hstack([_both(tone * best * along) for tone in tones])
        columns = (each.T[:, :, None] * columns[:, None]).reshape(len(log), -1)
        yield Wave(name, best, columns, max(len(numbers) // (2 * most), rules.WAVES_PICKED))


def _lengths(fit: EffectFit, weight: Array | Mask, numbers: Array, along: Array) -> Array:
    """Whitened squares (k, n) of unit waves of numbers (k,) row by row, weighed (n,): means of cosine and sine."""
    white = fit.whiteners[0]
    return np.array([np.sum(white.whole(weight[:, None] * _both(g * along)) ** 2, axis=1) / 2 for g in numbers])


def _transform(numbers: Array, along: Array, y: Array) -> Array:
    """Sum of y exp(2 pi i g x) over places x (n,) for evenly spaced numbers g (k,): a wave of each `SIDE`th number times those of
    the numbers between."""
    between = np.exp(2j * np.pi * np.outer(along, numbers[:SIDE] - numbers[0])) * y[:, None]
    return np.asarray((np.exp(2j * np.pi * np.outer(numbers[::SIDE], along)) @ between).ravel()[: len(numbers)])


def picked_squares(waves: Iterable[Wave]) -> float:
    """Squares beyond their number that noise alone has in the rows of waves that were picked among many."""
    picked = [w for w in waves if w.where != "turn" and not any(_holds(period, w) for period in waves)]
    return float(sum(chdtri(w.columns.shape[1], 1.0 / w.among) - w.columns.shape[1] for w in picked))


def _holds(period: Wave, wave: Wave) -> bool:
    """Whether what a period (or knocks) holds of tones has a wave in it, or a period of fewer, which so shares its rows."""
    one, other = (w.where.replace("period", "wave").replace("knocks", "wave") for w in (period, wave))
    if one != other or period.columns.shape[1] <= wave.columns.shape[1]:
        return False
    return bool(np.sum((np.linalg.qr(period.columns)[0].T @ wave.columns) ** 2) > 0.5 * np.sum(wave.columns**2))


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
    while len(found) < rules.WAVES_PICKED and left.size and left.max() > 0:
        found.append(k := int(np.argmax(left)))
        left[max(0, k - FINE) : k + FINE + 1] = 0.0
    return found


WAVES = 12  # harmonics of the first look
PLACES = 32  # in a turn
BELLS = np.geomspace(*LENGTHS, 6)
LOOKED = 4096  # rates looked at in one piece, which stays at hand
KEPT = 6  # trains of each clock that are looked at exactly
SHARP = 3  # halvings of the steps there, at least
PROBES = 12
FAR = 2**22  # points at most of the transform over a campaign's clock; a longer one is not looked at for knocks


@dataclass(frozen=True)
class SpliceTrains:
    """Scanned values of `belt_splice`, most telling first, of how many they are the most telling, the squares beyond their number
    that noise alone has in their rows."""

    found: tuple[Scanned, ...]
    among: int
    picked: float = 0.0


def likely_trains(problem: ForceProblem, fit: EffectFit) -> SpliceTrains:
    """The trains of knocks that the residual speaks for most; none where nothing was measured or time does not run."""
    log, c = problem.log, problem.scene.conditions
    steps = np.diff(log.time)[np.diff(log.run) == 0]
    if not fit.residual.any():  # imagined readings: usual knocks that are only just worth their number
        sharpness = float(np.std(c.time[log.contact])) / USUAL**2
        return SpliceTrains((), round(_as_many(sharpness, max(2.0 * np.log(_as_many(sharpness, 4 * np.pi)), 1.0))))
    if not (c.belt[log.contact] != 0).any() or not len(steps) or np.median(steps) <= 0:  # a belt that stands knocks nowhere
        return SpliceTrains((), 1)
    y = _scores(problem, fit)
    size = _sizes(problem, fit)
    found = list[tuple[float, Scanned, float]]()
    clocks = [(0.0, c.time)] + ([(1.0, c.clock)] if "clock_s" in c.given and len(np.unique(c.run)) > 1 else [])
    clocks = [(clocked, time) for clocked, time in clocks if np.ptp(time) <= (FAR - 1) * np.median(steps)]
    for clocked, time in clocks:
        rates, S = _spectrum(time, y, float(np.median(steps)), float(np.ptp(time)))
        spread = len(clocks) * float(np.std(time[log.contact]))
        for hz, turn, length in _first_look(rates, S, size):
            gain, best = _exact(problem, fit, y, {"hz": hz, "turn": turn, "length": length, "clocked": clocked})
            found.append((gain, best, spread / best["length"] ** 2))
    if not found:
        return SpliceTrains((), 1)
    found.sort(key=lambda one: -one[0])
    gain, best, sharpness = found[0]
    offered = (*(scanned for _, scanned, _ in found[: rules.TRAINS_OFFERED]), *_around(best))
    among = _as_many(sharpness, gain) * (len(offered) - rules.TRAINS_OFFERED + 1)
    picked = len(found[: rules.TRAINS_OFFERED]) * (float(chdtri(1, min(2.0 / _as_many(sharpness, 2 * np.pi), 1.0))) - 1.0)
    return SpliceTrains(offered, max(round(among), len(offered)), picked)


def _as_many(sharpness: float, gain: float) -> float:
    """Trains of a gain that fit into all rates, places and lengths: the volume of these over the posterior's (Laplace; a train
    moved by x lengths, or with a length exp(x) times as long, keeps 1 - x^2 / 2 of the gain). sharpness: standard deviation of
    the readings' times over the length's square, s."""
    return (RATES[1] - RATES[0]) * float(np.log(LENGTHS[1] / LENGTHS[0])) * sharpness * (gain / (4 * np.pi)) ** 1.5


def _scores(problem: ForceProblem, fit: EffectFit) -> Array:
    """What a train in the normal reading is multiplied with (n,)."""
    mask = problem.log.contact * (problem.scene.conditions.belt != 0)
    return np.asarray(fit.whiteners[0].back(fit.residual[: len(mask), None])[:, 0] * mask)


def _sizes(problem: ForceProblem, fit: EffectFit) -> tuple[Array, Array]:
    """Frequencies (k,) 1/s and mean squared whitened lengths (k,) of a unit wave in all of the log."""
    log, c = problem.log, problem.scene.conditions
    mask = (log.contact * (c.belt != 0)).astype(float)
    step = float(np.median(np.diff(log.time)[np.diff(log.run) == 0]))
    probes = np.linspace(0.0, 0.5 / step, PROBES)
    return probes, _lengths(fit, mask, probes, c.time).sum(axis=1)


def _spectrum(time: Array, y: Array, step: float, span: float) -> tuple[Array, Array]:
    """Rates (k,) 1/s, a quarter of a line's width apart at the highest harmonic that counts, and S (k, WAVES + 1) there; instants
    are taken to the nearest sampling step."""
    place = np.round((time - time.min()) / step).astype(np.int64)
    points = int(min(2 ** np.ceil(np.log2(8 * (span / step + 1))), FAR))
    points = max(points, int(place.max()) + 1)  # at most FAR
    half = np.fft.rfft(np.bincount(place, weights=y, minlength=points)[:points])
    transform = np.concatenate([half, np.conj(half[(points - 1) // 2 : 0 : -1])])
    first, last = (int(np.ceil(f * points * step)) for f in RATES)
    k = np.arange(first, last + 1)
    S = transform[np.outer(k, np.arange(WAVES + 1)) % points]  # beyond half the sampling rate a harmonic is seen at its image
    if time.min() != 0:
        S *= np.exp(-2j * np.pi * np.outer(k / (points * step), np.arange(WAVES + 1)) * time.min())
    return k / (points * step), S


def _first_look(rates: Array, S: Array, size: tuple[Array, Array]) -> Iterator[tuple[float, float, float]]:
    """Rate, place and length of the best trains, no two of one rate."""
    m = np.arange(WAVES + 1)
    places = np.arange(PLACES) / PLACES
    turn = np.exp(2j * np.pi * np.outer(m, places))
    best = np.full(len(rates), -np.inf)
    where = np.zeros((len(rates), 2), np.int64)
    highest = size[0][-1]
    folded = np.abs(np.outer(rates, m) - 2 * highest * np.round(np.outer(rates, m) / (2 * highest)))
    lengths = np.interp(folded, *size)
    # A first look in single precision: half the time, and `_exact` comes after it. Real parts of products with a turn.
    S, turn = np.hstack([S.real, S.imag]).astype(np.float32), np.vstack([turn.real, -turn.imag]).astype(np.float32)
    for b, w in enumerate(BELLS):
        c = np.sqrt(2 * np.pi) * w * np.exp(-2 * (np.pi * m * w) ** 2) * np.where(m > 0, 2.0, 1.0)
        norm = lengths @ (c**2 * np.where(m > 0, 1.0, 2.0))
        for rows in np.array_split(np.arange(len(rates)), int(np.ceil(len(rates) / LOOKED))):
            part = slice(rows[0], rows[-1] + 1)
            score = S[part] @ (np.tile(c, 2)[:, None] * turn).astype(np.float32)
            top = score.argmax(axis=1)
            value = np.maximum(score[np.arange(len(rows)), top], 0.0) ** 2 / norm[part]
            better = value > best[part]
            best[part][better], where[part][better] = value[better], np.column_stack([top, np.full(len(rows), b)])[better]
    spacing = 8  # rates of one line
    for _ in range(KEPT):
        k = int(np.argmax(best))
        yield float(rates[k]), float(places[where[k, 0]]), float(BELLS[where[k, 1]])
        best[max(0, k - spacing) : k + spacing + 1] = -np.inf


def _exact(problem: ForceProblem, fit: EffectFit, y: Array, scanned: Scanned) -> tuple[float, Scanned]:
    """Gain of a train, its rate, place and length moved to where it is largest."""
    c = problem.scene.conditions
    time = c.clock if scanned["clocked"] else c.time
    middle = float(time[problem.log.contact].mean())
    span = max(float(np.ptp(time)), 1e-6)
    steps = {"hz": 0.06 / span, "turn": 0.5 / PLACES, "length": 0.25}
    best: dict[str, Any] = dict(scanned)
    level = _gains(problem, fit, y, time, [scanned])[0]
    # Until a step is within what the readings tell of the place: what is left of a strong train lies about its knocks.
    while steps["turn"] > min(0.5 / PLACES / 2**SHARP, 0.5 * best["length"] * np.sqrt(2.0 / max(level, 1.0))):
        moves = []
        for sign in (-1.0, 1.0):
            hz = best["hz"] + sign * steps["hz"]
            # About the middle of the log, so that a knock there stays where it is.
            moves.append(best | {"hz": hz, "turn": (best["turn"] + sign * steps["hz"] * middle) % 1.0})
            moves.append(best | {"turn": (best["turn"] + sign * steps["turn"]) % 1.0})
            moves.append(best | {"length": float(np.clip(best["length"] * (1.0 + sign * steps["length"]), *LENGTHS))})
        gains = _gains(problem, fit, y, time, moves)
        k = int(np.argmax(gains))
        if gains[k] > level + min(1e-3 * level, rules.SHARPER_GAIN):
            best, level = moves[k], gains[k]
        else:
            steps = {key: 0.5 * step for key, step in steps.items()}
    return float(level), best


def _gains(problem: ForceProblem, fit: EffectFit, y: Array, time: Array, scans: Sequence[Scanned]) -> Array:
    """Squares (v,) that trains take from the residual, by their own columns."""
    mask = (problem.log.contact * (problem.scene.conditions.belt != 0)).astype(float)
    turns = [time * s["hz"] - s["turn"] for s in scans]
    away = np.column_stack([t - np.floor(t + 0.5) for t in turns]) / np.array([s["length"] for s in scans])
    trains = mask[:, None] * np.exp(-0.5 * away**2)
    size = np.sum(fit.whiteners[0].whole(trains) ** 2, axis=0)
    return np.asarray(np.maximum(y @ trains, 0.0) ** 2 / np.maximum(size, 1e-12))


def _around(best: Scanned) -> Iterator[Scanned]:
    """Neighbours of a train: what a sharper place or length would look like is kept of the log too."""
    for sign in (-1.0, 1.0):
        yield {**best, "turn": (best["turn"] + sign * 0.3 * best["length"]) % 1.0}
        yield {**best, "length": float(np.clip(best["length"] * (1.0 + 0.3 * sign), *LENGTHS))}
