"""The noise filter of a log as matrices, with averages over short blocks that stand for its rows.

The filter of `noise` beside it is linear and forgets at the start of a run, so on a stretch of n rows it is a lower triangular
matrix. Kept as such, thousands of columns of effects are whitened and averaged at the price of a product
(docs/diagnosis_force.md, "Rows").
"""

from collections.abc import Callable
from dataclasses import dataclass, field
from functools import cached_property
from itertools import pairwise

import numpy as np

from ocp.calibrate.force.log import Index
from ocp.calibrate.force.noise import ReadingNoise, whiten
from robots.pose import Array

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
