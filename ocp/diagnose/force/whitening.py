"""Whitening of the two signals of a log as one matrix a run, and the averages over short blocks that stand for its rows.

The filter of `ocp.calibrate.force.noise` is linear and forgets at the start of a run: on a stretch of n rows it is a lower
triangular matrix. Kept as such, thousands of columns of effects are whitened and averaged at the price of a product.
docs/diagnosis_force.md, "Rows".
"""

from dataclasses import dataclass, field, replace
from functools import cached_property
from itertools import pairwise

import numpy as np

from ocp.calibrate.force.log import ForceLog, Index
from ocp.calibrate.force.noise import ReadingNoise, channel_of, whiten
from robots.pose import Array

BLOCKS = (300, 150)  # of a log that are kept of its rows, of fn and ft: whitened rows are averaged to about so many
SETTLED = 0.05  # change of a weight below which the filter stands
FIRST = (1, 1, 2, 4)  # rows of the first blocks of a run: its first samples tell most of its mean
CHANGED = 0.1  # relative change of a signal's scatter from which its noise is estimated anew


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
        out = np.zeros_like(columns, dtype=float)
        for s in self.stretches:
            out[s.rows] = s.W @ columns[s.rows]
        return out

    def short(self, columns: Array) -> Array:
        """Columns (n, m) whitened and averaged, (b, m)."""
        return np.concatenate([s.short @ columns[s.rows] for s in self.stretches])

    def back(self, whitened: Array) -> Array:
        """The transpose of `whole` on columns (n, m): scores of unwhitened columns are their products with it."""
        out = np.zeros_like(whitened)
        for s in self.stretches:
            out[s.rows] = s.W.T @ whitened[s.rows]
        return out

    def lost(self, whitened: Array) -> Array:
        """What the averages lose of whitened columns (n, m): the columns less their averages."""
        out = np.zeros_like(whitened)
        for s in self.stretches:
            part = whitened[s.rows]
            out[s.rows] = part - s.blocks.T @ (s.blocks @ part)
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


def whiteners_of(log: ForceLog, residual: Array, shear: Array | None) -> tuple[Whitener, ...]:
    """Whiteners of fn and, where the log has it, ft, from the scatter of residuals (n,) N about some prediction."""
    out = [Whitener.of(channel_of(log, residual), BLOCKS[0])]
    if shear is not None:
        out.append(Whitener.of(channel_of(as_shear(log), shear), BLOCKS[1]))
    return tuple(out)


def refreshed(log: ForceLog, whitener: Whitener, residual: Array) -> Whitener:
    """The noise estimated about a later prediction: anew where the scatter has changed, else kept with new weights."""
    noise = whitener.noise
    white = whitener.whole(residual[:, None])[:, 0]
    changed = False
    for kind in noise.kinds.values():
        steps = np.diff(white[kind.rows])  # what is slow is not noise
        spread = 1.4826 * np.median(np.abs(steps - np.median(steps))) / np.sqrt(2.0) if len(steps) else 1.0
        changed |= abs(np.log(max(spread, 1e-3))) > CHANGED
    if changed:
        noise = channel_of(log, residual, noise)
    return whitener.with_noise(noise.reweighted(residual))


def as_shear(log: ForceLog) -> ForceLog:
    """The log with the tangential reading in the place of the normal one."""
    assert log.ft is not None
    return replace(log, fn=log.ft, sigma_fn=log.sigma_ft)
