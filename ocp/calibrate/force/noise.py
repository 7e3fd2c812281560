"""Noise of force readings: white scatter plus an exponentially correlated part, whitened run by run by its Kalman filter.

docs/force_registration.md, eq. 4 to 6. Rows of different runs are independent; samples need not be evenly spaced. Rows in
contact and rows in the air have their own noise (`ReadingNoise`), and every row a weight of Student's t.

The filter is linear and forgets at the start of a run, so on a stretch of n rows it is a lower triangular matrix. Kept as such,
with averages over short blocks that stand for its rows, thousands of columns of effects are whitened and averaged at the price of
a product (docs/diagnosis_force.md, "Rows").
"""

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from functools import cached_property, lru_cache
from itertools import pairwise
from typing import Any

import casadi as ca
import numpy as np
from scipy.optimize import minimize
from scipy.special import gammaln

from ocp.calibrate.force.log import ForceLog, Index
from robots.calibration.student_t import tail_weights
from robots.pose import Array

DEGREE = 3  # of the polynomial in time that a run's residual may follow while its scatter is measured
ENOUGH = 20  # rows of a run from which such a polynomial, and not its mean alone, is taken out
STRETCH = 500  # rows; longer runs are filtered in stretches of about this, side by side
MOST = 8000  # rows that the estimate looks at
FILTERED = 16  # columns up to which samples one after the other cost less than arrays of stretches side by side
FEW = 20  # rows of a kind from which its noise is estimated
# Logit of the correlated share and logarithm of tau in samples, as they usually are: what few rows cannot tell stays there.
USUAL: Array = np.array([0.0, np.log(4.0)])
USUAL_SD: Array = np.array([1.5, 0.8])
GROSS = 0.1  # weight of Student's t up to which a reading is gross, of no gap
FREEDOMS = (4.0, 6.0, 10.0, 20.0, 60.0)  # of Student's t; 60 is as good as a normal law


@dataclass(frozen=True)
class CorrelatedNoise:
    """sigma N (or a factor on given sigmas); share (0..1) of its variance that is correlated, over the time tau s; freedom of
    Student's t, of which sigma is the scale; usual: variance of what is not gross over sigma^2."""

    sigma: float
    share: float
    tau: float
    freedom: float = 60.0
    usual: float = 1.0

    def information(self) -> float:
        """Share of a normal law's information that a sample of Student's t with the same scale carries."""
        return (self.freedom + 1.0) / (self.freedom + 3.0)

    def far(self) -> float:
        """Weight of a sample sqrt(2 freedom) scales off. Scores, weight times residual, have fallen off there from where they are
        largest, at sqrt(freedom)."""
        return (self.freedom + 1.0) / (3.0 * self.freedom)

    def samples_each(self, step: float) -> float:
        """How many samples `step` s apart count as one independent sample for a mean over a long time."""
        decay = np.exp(-step / self.tau)
        return float(1.0 + 2.0 * self.share * decay / (1.0 - decay))


@dataclass(frozen=True)
class Runs:
    """Rows of each stretch of a run side by side: index (stretches, longest) into the rows, -1 where one has ended; step
    (stretches, longest) s since the sample before, inf at the start."""

    index: Index
    step: Array

    @staticmethod
    def of(run: Index, time: Array) -> "Runs":
        """Rows grouped by `run` (n,), in the order in which they stand, `time` (n,) s; what a cut between two stretches of a
        run leaves out is the correlation of two samples."""
        whole = [np.flatnonzero(run == i) for i in np.unique(run)]
        rows = [part for r in whole for part in np.array_split(r, int(np.ceil(len(r) / STRETCH)))]
        index = np.full((len(rows), max(len(r) for r in rows)), -1)
        step = np.full(index.shape, np.inf)
        for i, r in enumerate(rows):
            index[i, : len(r)] = r
            step[i, 1 : len(r)] = np.diff(time[r])
        return Runs(index, step)


def whiten(runs: Runs, noise: CorrelatedNoise, weight: Array, columns: Array) -> tuple[Array, Array]:
    """Innovations (n, m) of `columns` (n, m), each over its own standard deviation, and those deviations (n,).

    One linear map for all columns. weight (n,) divides a sample's variance: small for an outlier.
    """
    if columns.shape[1] <= FILTERED:
        return _whiten_few(runs, noise, weight, columns)
    order = np.argsort(-(runs.index >= 0).sum(axis=1), kind="stable")  # longest first: those under way are always the first ones
    index = runs.index[order].T
    under_way = (index >= 0).sum(axis=1).tolist()
    decay, gain, total = _gains(runs.step[order].T, index, noise, weight)
    out, scale = np.empty_like(columns, dtype=float), np.ones(len(columns))
    state, rows = np.zeros((index.shape[1], columns.shape[1])), np.asarray(columns[index], float)
    for row, d, g, c in zip(rows, decay[..., None], gain[..., None], under_way, strict=True):
        guess = d[:c] * state[:c]
        row[:c] -= guess
        state[:c] = guess + g[:c] * row[:c]
    inside = index >= 0
    out[index[inside]] = rows[inside]
    scale[index[inside]] = np.sqrt(total[inside])
    out /= scale[:, None]
    return out, scale


def _whiten_few(runs: Runs, noise: CorrelatedNoise, weight: Array, columns: Array) -> tuple[Array, Array]:
    """`whiten` of few columns, sample by sample in CasADi's machine and with the same bits: a stretch begins where nothing of
    the sample before is left."""
    inside = runs.index >= 0
    order, decay = runs.index[inside], np.exp(-runs.step[inside] / noise.tau)
    n, m = columns.shape
    correlated = noise.share * noise.sigma**2
    given = np.empty((n, 6 + m))
    given[:, 0], given[:, 1], given[:, 2] = decay, decay**2, (1.0 - decay**2) * correlated
    given[:, 3], given[:, 4:6], given[:, 6:] = weight[order], (noise.sigma**2, correlated), columns[order]
    start, states, found = np.zeros(1 + m), np.empty((n, 1 + m)), np.empty((n, m + 1))
    buffer: Any
    buffer, run = _filter(n, m).buffer()
    buffer.set_arg(0, start.data)
    buffer.set_arg(1, given.data)
    buffer.set_res(0, states.data)
    buffer.set_res(1, found.data)
    run()
    out, scale = np.empty((n, m)), np.empty(n)
    out[order], scale[order] = found[:, :m], np.sqrt(found[:, m])
    out /= scale[:, None]
    return out, scale


@lru_cache(maxsize=64)
def _filter(n: int, m: int) -> ca.Function:
    """The filter over n samples of m columns. State: variance of the correlated part, its estimates (m); of a sample: decay, its
    square, what is fresh of the variance, weight, variance, correlated variance, columns (m); out: innovations (m), variance."""
    state, sample = ca.SX.sym("state", 1 + m), ca.SX.sym("sample", 6 + m)
    decay, kept, fresh, weight, variance, correlated = ca.vertsplit(sample[:6])
    ahead = kept * state[0] + fresh
    total = (ahead + variance - correlated) / weight
    gain = ca.fmin(ahead / total, 1.0)
    guess = decay * state[1:]
    innovation = sample[6:] - guess
    after = ca.vertcat(ahead * (1.0 - gain), guess + gain * innovation)
    return ca.Function("step", [state, sample], [after, ca.vertcat(innovation, total)]).mapaccum("noise_filter", n)


def _gains(step: Array, index: Index, noise: CorrelatedNoise, weight: Array) -> tuple[Array, Array, Array]:
    """Decay of the correlated part since the sample before, the filter's gain and the variance (k, stretches) of what it does not
    foresee, sample by sample; they do not depend on the readings."""
    variance, correlated = noise.sigma**2, noise.share * noise.sigma**2
    decay = np.exp(-step / noise.tau)
    kept, fresh = decay**2, (1.0 - decay**2) * correlated
    weights = np.where(index >= 0, weight[index], 1.0)
    gain, total = np.empty(step.shape), np.empty(step.shape)
    spread = np.full(step.shape[1], correlated)
    for k in range(len(step)):
        ahead = kept[k] * spread + fresh[k]
        total[k] = (ahead + variance - correlated) / weights[k]
        gain[k] = np.minimum(ahead / total[k], 1.0)
        spread = ahead * (1.0 - gain[k])
    return decay, gain, total


def estimate_noise(run: Index, time: Array, residual: Array, before: CorrelatedNoise | None = None) -> CorrelatedNoise:
    """Noise of residuals (n,) whose slow course in each run is not noise: restricted maximum likelihood (eq. 5).

    Slow means a cubic in time; what is slower than that is for the fit to explain. `before`: an estimate to start from.
    """
    runs = Runs.of(run, time)
    if len(run) > MOST:
        chosen = runs.index[:: int(np.ceil(len(run) / MOST))]
        keep = np.sort(chosen[chosen >= 0])
        run, time, residual = run[keep], time[keep], residual[keep]
        runs = Runs.of(run, time)
    columns = np.column_stack([residual, _slow_course(runs, time)])
    rest = _detrended(runs, columns)
    spread = 1.4826 * float(np.median(np.abs(rest - np.median(rest)))) or 1e-6
    step = float(np.median(runs.step[np.isfinite(runs.step)])) if len(rest) > len(runs.index) else 1.0
    weight = tail_weights((rest / spread) ** 2, 1, 6.0)
    # Without gross readings, and all others alike: weights that follow the residuals know where the correlated part lies, and
    # short runs would be given a slow one of any size that they do not have.
    good = weight > GROSS
    part = Runs.of(run[good], time[good])
    own, alike = np.column_stack([residual[good], _slow_course(part, time[good])]), np.ones(np.count_nonzero(good))

    def cost(x: Array) -> float:
        unlikely = np.sum(((x[1:] - USUAL) / USUAL_SD) ** 2)
        return _restricted(part, _noise(x, step), alike, own) + float(unlikely)

    if before is None:
        start, reach = np.array([np.log(spread), 0.0, np.log(3.0)]), 1.0
    else:
        logit = float(np.log(before.share / (1.0 - before.share))) if 0.0 < before.share < 1.0 else -6.0
        start, reach = np.array([np.log(before.sigma), logit, np.log(before.tau / max(step, 1e-9))]), 0.3
    simplex = np.vstack([start, start + reach * np.diag([0.3, 1.0, 0.7])])
    options = {"maxfev": 100, "xatol": 0.03, "fatol": 0.2, "initial_simplex": simplex}
    found = minimize(cost, start, method="Nelder-Mead", options=options)
    noise = _noise(found.x, step)
    white, _ = whiten(runs, noise, np.ones(len(rest)), rest[:, None])
    noise = _with_freedom(noise, white[:, 0])
    return replace(noise, usual=_usual(runs, noise, columns, weight))


def student_weights(runs: Runs, noise: CorrelatedNoise, residual: Array, weight: Array) -> Array:
    """Weights (n,) of Student's t at the innovations that the filter sees with the weights before."""
    white, _ = whiten(runs, noise, weight, residual[:, None])
    return tail_weights((white[:, 0] / np.sqrt(weight)) ** 2, 1, noise.freedom)


def _noise(x: Array, step: float) -> CorrelatedNoise:
    """Noise of unbounded numbers: logarithm of sigma, logit of the share, logarithm of tau in samples."""
    share = 1.0 / (1.0 + np.exp(-np.clip(x[1], -6.0, 4.0)))
    return CorrelatedNoise(float(np.exp(x[0])), float(share), float(max(step, 1e-9) * np.exp(np.clip(x[2], -1.0, 5.0))))


def _slow_course(runs: Runs, time: Array) -> Array:
    """Polynomials in time (n, DEGREE + 1), -1..1 over each run; in short runs the mean alone."""
    out = np.zeros((len(time), DEGREE + 1))
    for row in runs.index:
        at = row[row >= 0]
        span = np.ptp(time[at]) or 1.0
        u = 2.0 * (time[at] - time[at[0]]) / span - 1.0
        degree = DEGREE if len(at) >= ENOUGH else 0
        out[at, : degree + 1] = np.polynomial.legendre.legvander(u, degree)
    return out


def _detrended(runs: Runs, columns: Array, weight: Array | None = None) -> Array:
    rest, root = columns[:, 0].copy(), np.sqrt(np.ones(len(columns)) if weight is None else weight)[:, None]
    for row in runs.index:
        at = row[row >= 0]
        own = columns[at] * root[at]
        rest[at] -= columns[at, 1:] @ np.linalg.lstsq(own[:, 1:], own[:, 0], rcond=None)[0]
    return rest


def _usual(runs: Runs, noise: CorrelatedNoise, columns: Array, weight: Array) -> float:
    """Variance over sigma^2 of what is not gross, about a slow course that gross readings do not pull, in a filter that they do
    not enter."""
    rest = _detrended(runs, columns, weight)
    for _ in range(2):
        weight = student_weights(runs, noise, rest, weight)
    white, _ = whiten(runs, noise, weight, rest[:, None])
    kept, slow = weight > GROSS, np.count_nonzero([(columns[row[row >= 0], 1:] != 0).any(axis=0) for row in runs.index])
    return float(np.sum(white[kept, 0] ** 2 / weight[kept]) / max(np.count_nonzero(kept) - slow, 1))


def _restricted(runs: Runs, noise: CorrelatedNoise, weight: Array, columns: Array) -> float:
    """Minus twice the restricted log likelihood: the slow courses are integrated out."""
    white, scale = whiten(runs, noise, weight, columns)
    length, m = runs.index.shape[1], columns.shape[1]
    inside = (runs.index >= 0)[..., None]
    stretches = np.zeros((len(runs.index), max(length, m), m))  # stretches side by side, rows that are none zero
    stretches[:, :length] = np.where(inside, white[runs.index], 0.0)
    there = np.where(inside, columns[runs.index, 1:] != 0, False).any(axis=1)
    # The residual last: below the courses stands what they leave of it.
    R = np.asarray(np.linalg.qr(np.roll(stretches, -1, axis=2), mode="r"), float)
    size = np.abs(np.diagonal(R, axis1=1, axis2=2))[:, :-1]
    left = np.sum(R[:, :-1, -1] ** 2 * ~there) + np.sum(R[:, -1, -1] ** 2)
    return 2.0 * float(np.log(scale).sum()) + float(left) + 2.0 * float(np.log(np.maximum(size, 1e-12))[there].sum())


def _with_freedom(noise: CorrelatedNoise, white: Array) -> CorrelatedNoise:
    """The freedom and scale of Student's t that fit the innovations best."""
    best = None
    for freedom in FREEDOMS:
        s = 1.0
        for _ in range(30):
            s = float(np.sqrt(np.mean(tail_weights((white / s) ** 2, 1, freedom) * white**2)))
        # Of independent samples of Student's t; scipy.stats has it too, and takes half a second to import.
        constant = gammaln((freedom + 1.0) / 2.0) - gammaln(freedom / 2.0) - 0.5 * np.log(freedom * np.pi)
        spread = 0.5 * (freedom + 1.0) * np.log1p((white / s) ** 2 / freedom).sum()
        score = float(len(white) * constant - spread) - len(white) * float(np.log(s))
        if best is None or score > best[0] + 1.0:
            best = (score, freedom, s)
    assert best is not None
    return CorrelatedNoise(noise.sigma * best[2], noise.share, noise.tau, best[1])


@dataclass(frozen=True)
class Whitened:
    """Innovations of the residuals (n,) and of the sensitivities (n, k), each of unit variance (eq. 6)."""

    residual: Array
    sensitivity: Array


@dataclass(frozen=True)
class NoiseGroup:
    """Rows of one kind (contact or air): their places, their stretches, their noise as a factor on `ReadingNoise.base`."""

    rows: Index
    runs: Runs
    noise: CorrelatedNoise


@dataclass(frozen=True)
class ReadingNoise:
    """base (n,) N: the sensor's own sigma, 1 where it gives none; weight (n,) of Student's t; kinds by contact (True) and air."""

    base: Array
    weight: Array
    kinds: dict[bool, NoiseGroup]

    def reweighted(self, residual: Array) -> "ReadingNoise":
        """Weights for residuals (n,) N, outliers low."""
        weight = self.weight.copy()
        for kind in self.kinds.values():
            at = kind.rows
            weight[at] = student_weights(kind.runs, kind.noise, residual[at] / self.base[at], weight[at])
        return replace(self, weight=weight)

    def whitened(self, residual: Array, sensitivity: Array) -> Whitened:
        """Residuals (n,) and sensitivities (n, k), in N, through the filter."""
        columns = np.column_stack([residual, sensitivity]) / self.base[:, None]
        out = np.zeros_like(columns)
        for kind in self.kinds.values():
            out[kind.rows] = whiten(kind.runs, kind.noise, self.weight[kind.rows], columns[kind.rows])[0]
        return Whitened(out[:, 0], out[:, 1:])

    def information(self, sensitivity: Array) -> Array:
        """What whitened sensitivities (n, k) tell about the k unknowns, (k, k) (eq. 10)."""
        return np.asarray(sum(k.noise.information() * sensitivity[k.rows].T @ sensitivity[k.rows] for k in self.kinds.values()))

    def even(self) -> "ReadingNoise":
        """One weight, what a sample tells (Fisher), for all rows but those far off, which keep their own: they would score the
        less the farther they are.

        Whitened residuals times sqrt(weight / even weight) are scores of unit variance that change by what is added to the
        readings as residuals with these weights do. With their own they would change by less: what adds to noise of its own sign
        has the smaller weights (docs/diagnosis_force.md, eq. 10)."""
        weight = self.weight.copy()
        for kind in self.kinds.values():
            own, noise = weight[kind.rows], kind.noise
            weight[kind.rows] = np.where(own >= noise.far(), noise.information(), own)
        return replace(self, weight=weight)

    def sigma(self) -> Array:
        """One standard deviation (n,) N of each reading, gross ones apart."""
        out = self.base.copy()
        for kind in self.kinds.values():
            out[kind.rows] *= kind.noise.sigma * np.sqrt(kind.noise.usual)
        return out

    def independent(self, contact: bool = True) -> float:
        """How many independent readings the rows in contact, or in the air, are worth for their mean."""
        kind = self.kinds[contact]
        steps = kind.runs.step[np.isfinite(kind.runs.step) & (kind.runs.step > 0)]
        return len(kind.rows) / (kind.noise.samples_each(float(np.median(steps))) if len(steps) else 1.0)


def channel_of(log: ForceLog, residual: Array, before: ReadingNoise | None = None) -> ReadingNoise:
    """Noise of a log from the scatter of its residuals (n,) N, at least the sensor's own sigma where it gives one.

    `before`: an earlier estimate of the same log to start from.
    """
    base = np.ones(len(log)) if log.sigma_fn is None else log.sigma_fn
    kinds: dict[bool, NoiseGroup] = {}
    for contact in (True, False):
        rows = np.flatnonzero(log.contact == contact)
        if not len(rows):
            continue
        run, time = log.run[rows], log.time[rows]
        if len(rows) >= FEW:
            noise = estimate_noise(run, time, residual[rows] / base[rows], before.kinds[contact].noise if before else None)
        elif kinds:
            noise = kinds[True].noise
        else:
            noise = CorrelatedNoise(float(np.std(residual[rows] / base[rows])) or 1.0, 0.0, 1.0)
        if log.sigma_fn is not None and noise.sigma < 1.0:
            noise = replace(noise, sigma=1.0, usual=1.0)
        kinds[contact] = NoiseGroup(rows, Runs.of(run, time), noise)
    return ReadingNoise(base, before.weight if before else np.ones(len(log)), kinds)


SETTLED = 0.05  # change of a weight below which the filter stands
FIRST = (1, 1, 2, 4)  # rows of the first blocks of a run: its first samples tell most of its mean


@dataclass(frozen=True)
class Stretch:
    """Rows (k,) of one stretch of a run, the filter W (k, k), blocks (b, k) with orthonormal rows, place (b,): the row in the
    middle of each block."""

    rows: Index
    W: Array = field(repr=False)
    blocks: Array = field(repr=False)
    place: Index

    @cached_property
    def short(self) -> Array:
        """Filter and averages together (b, k)."""
        return np.asarray(self.blocks @ self.W)


@dataclass(frozen=True)
class Whitener:
    """One signal's noise with its filter. Columns of n rows of the log come out whitened, or whitened and averaged."""

    noise: ReadingNoise
    stretches: tuple[Stretch, ...]
    blocks: int

    @staticmethod
    def of(noise: ReadingNoise, blocks: int) -> "Whitener":
        """The filter for this noise, these weights, with about so many blocks."""
        count = sum(len(kind.rows) for kind in noise.kinds.values())
        length = max(1, round(count / blocks))
        found = []
        for kind in noise.kinds.values():
            index = kind.runs.index
            unit = np.zeros((len(kind.rows), index.shape[1]))
            at, column = np.nonzero(index >= 0)
            unit[index[at, column], column] = 1.0
            filtered = whiten(kind.runs, kind.noise, noise.weight[kind.rows], unit)[0]
            for stretch in index:
                inside = stretch[stretch >= 0]
                rows = kind.rows[inside]
                W = filtered[inside, : len(inside)] / noise.base[rows]
                average, middle = _averages(len(rows), length)
                found.append(Stretch(rows, W, average, rows[middle]))
        return Whitener(noise, tuple(found), blocks)

    def whole(self, columns: Array) -> Array:
        """Columns (n, m) whitened row by row."""
        return self._by_stretch(columns, lambda s, rows: s.W @ rows)

    def short(self, columns: Array) -> Array:
        """Columns (n, m) whitened and averaged, (b, m)."""
        return np.concatenate([s.short @ columns[s.rows] for s in self.stretches])

    def even(self) -> "Whitener":
        """The filter for the noise's even weights."""
        return Whitener.of(self.noise.even(), self.blocks)

    def back(self, whitened: Array) -> Array:
        """The transpose of `whole` on columns (n, m): scores of unwhitened columns are their products with it."""
        return self._by_stretch(whitened, lambda s, rows: s.W.T @ rows)

    def lost(self, whitened: Array) -> Array:
        """What the averages lose of whitened columns (n, m)."""
        return self._by_stretch(whitened, lambda s, rows: rows - s.blocks.T @ (s.blocks @ rows))

    def _by_stretch(self, columns: Array, changed: Callable[[Stretch, Array], Array]) -> Array:
        out = np.zeros_like(columns, dtype=float)
        for s in self.stretches:
            out[s.rows] = changed(s, columns[s.rows])
        return out

    @property
    def place(self) -> Index:
        """The row of the log (b,) that each average stands for."""
        return np.concatenate([s.place for s in self.stretches])

    def reweighted(self, residual: Array) -> "Whitener":
        """Weights of Student's t for residuals (n,) N."""
        return self.with_noise(self.noise.reweighted(residual))

    def with_noise(self, noise: ReadingNoise) -> "Whitener":
        """The filter for another noise; this one where only weights differ, and those hardly."""
        same = noise.kinds is self.noise.kinds and float(np.abs(noise.weight - self.noise.weight).max()) < SETTLED
        return self if same else Whitener.of(noise, self.blocks)


def _averages(count: int, length: int) -> tuple[Array, Index]:
    """Averages (b, count) of blocks of about `length` rows, the first ones shorter, and the middle row of each."""
    edges = [0]
    for first in FIRST:
        if first < length and edges[-1] + first < count:
            edges.append(edges[-1] + first)
    rest = count - edges[-1]
    pieces = max(1, round(rest / length))
    edges += [edges[-1] + round(rest * k / pieces) for k in range(1, pieces + 1)]
    steps = np.unique(edges)
    out = np.zeros((len(steps) - 1, count))
    for b, (i, j) in enumerate(pairwise(steps)):
        out[b, i:j] = 1.0 / np.sqrt(j - i)
    return out, np.asarray((steps[:-1] + steps[1:] - 1) // 2, np.int64)
