"""Hooks of effects as compiled functions of flat rows, evaluated for many rows and many variants at once.

A hook is built once for each effect, joint and set of scanned values that are not symbols; of a row's numbers the function
takes only those that the hook uses, so that 300 orders times 150 readings cost milliseconds.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property, lru_cache
from typing import Any

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from ocp.effects.effect import Effect, Scanned, scan_key
from robots.kinematics import evaluate_into
from robots.pose import Array

_BLOCK = 1 << 16  # pairs of a row and a variant laid out at once


@dataclass(frozen=True)
class RowLayout:
    """Names and sizes of the blocks of a row."""

    sizes: tuple[tuple[str, int], ...]

    @staticmethod
    def of(text: str) -> "RowLayout":
        """From a text such as "q 6, warm 1"."""
        return RowLayout(tuple((name, int(size)) for name, size in (block.split() for block in text.split(","))))

    @property
    def size(self) -> int:
        """Numbers of a row."""
        return sum(size for _, size in self.sizes)

    @cached_property
    def places(self) -> dict[str, slice]:
        """The columns of each block."""
        edges = np.cumsum([0, *(size for _, size in self.sizes)]).tolist()
        return {name: slice(i, j) for (name, _), i, j in zip(self.sizes, edges[:-1], edges[1:], strict=True)}

    def split(self, whole: ca.SX) -> dict[str, ca.SX]:
        """The blocks of a symbolic row by name."""
        return {name: whole[place] for name, place in self.places.items()}

    def stack(self, n: int, blocks: Mapping[str, Any]) -> Array:
        """Rows (n, size) of numeric blocks (n, size_i), (size_i,) or scalars; blocks that are absent or None are nan."""
        parts = []
        for name, size in self.sizes:
            value = blocks.get(name)
            block = np.full((n, size), np.nan) if value is None else np.asarray(value, float)
            parts.append(np.broadcast_to(block.reshape(n, 1) if block.shape == (n,) and size == 1 else block, (n, size)))
        return np.hstack(parts)

    def block(self, rows: Array, name: str) -> Array:
        """The columns (n, size_i) of a block."""
        return rows[:, self.places[name]]


@dataclass(frozen=True)
class Hook:
    """One hook of an effect at a joint, as a function of a row: make(row, scanned) -> (r, m) CasADi expression or {key:
    expression}. `place` tells contexts apart whose constants differ (a robot's numbers, names of payloads)."""

    effect: Effect
    kind: str
    joint: int
    layout: RowLayout
    place: Any  # hashable; has context(row) -> what the hook is given


@dataclass(frozen=True)
class _Compiled:
    """A function of the numbers that count, to the results that are not zero whatever these are."""

    function: ca.Function
    used: NDArray[np.int64]
    keys: tuple[int, ...]  # of a dict of expressions; (-1,) for a single one
    rows: int
    columns: int
    rows_given: tuple[int, ...]  # of all keys' rows, one after the other, those that are not zero


@lru_cache(maxsize=64)
def _row(layout: RowLayout, place: Any) -> tuple[ca.SX, Any]:
    """A symbolic row and what hooks see of it."""
    row = ca.SX.sym("row", layout.size)
    return row, place.context(row)


@lru_cache(maxsize=4096)
def _compiled(hook: Hook, fixed: tuple[tuple[str, Any], ...], symbolic: tuple[str, ...]) -> _Compiled | None:
    row, context = _row(hook.layout, hook.place)
    free = ca.SX.sym("scanned", len(symbolic))
    scanned = dict(fixed) | {key: free[i] for i, key in enumerate(symbolic)}
    value = getattr(hook.effect, hook.kind)(context, hook.joint, scanned)
    found: dict[int, ca.SX] = value if isinstance(value, dict) else {-1: value}
    found = {key: ca.densify(ca.SX(expression)) for key, expression in found.items()}
    if not found:
        return None
    shape = next(iter(found.values())).shape
    stacked = ca.vertcat(*found.values())
    given = tuple(i for i in range(stacked.shape[0]) if not stacked[i, :].is_zero()) or (0,)
    out = ca.vec(stacked[list(given), :].T)
    used = np.flatnonzero(np.asarray(ca.which_depends(out, row, 1, False), bool)) if out.nnz() else np.empty(0, np.int64)
    inputs = [ca.vertcat(*(row[int(i)] for i in used)) if len(used) else ca.SX.sym("none", 0), free]
    function = ca.Function(f"{hook.effect.name.split()[0]}_{hook.kind}", inputs, [ca.cse(out)])
    return _Compiled(function, used, tuple(found), *shape, given)


def evaluated(hook: Hook, rows: Array, scans: Sequence[Scanned]) -> dict[int, Array]:
    """The hook at rows (n, k) for every variant: {key: (variants, n, r, m)}, key -1 where the hook is not a dict."""
    out: dict[int, Array] = {}
    for made, members, result in _evaluated(hook, rows, scans):
        for i, key in enumerate(made.keys):
            given = [(k, row - i * made.rows) for k, row in enumerate(made.rows_given) if 0 <= row - i * made.rows < made.rows]
            if len(members) == len(scans) and len(given) == made.rows:
                out[key] = result[:, :, given[0][0] : given[-1][0] + 1]
                continue
            if key not in out:
                out[key] = np.zeros((len(scans), len(rows), made.rows, made.columns))
            for k, row in given:
                out[key][members, :, row] = result[:, :, k]
    return out


def evaluated_sparsely(hook: Hook, rows: Array, scans: Sequence[Scanned]) -> tuple[NDArray[np.int64], Array]:
    """The same of a hook that is not a dict, without the rows that are zero whatever the row's numbers: which rows of the result
    (g,), and (variants, n, g, m)."""
    found = list(_evaluated(hook, rows, scans))
    given = sorted({row for made, _, _ in found for row in made.rows_given})
    if len(found) == 1 and len(found[0][1]) == len(scans):
        return np.array(given, np.int64), found[0][2]
    out = np.zeros((len(scans), len(rows), len(given), hook.effect.size))
    for made, members, result in found:
        for k, row in enumerate(made.rows_given):
            out[members, :, given.index(row)] = result[:, :, k]
    return np.array(given, np.int64), out


def _evaluated(hook: Hook, rows: Array, scans: Sequence[Scanned]) -> Iterator[tuple[_Compiled, list[int], Array]]:
    """Of variants whose scanned values that are not symbols are the same: the function, which they are, and what it gives (v, n,
    given rows, m)."""
    symbolic = tuple(key for key in hook.effect.symbolic if scans and key in scans[0])
    groups: dict[tuple[tuple[str, Any], ...], list[int]] = {}
    for v, scanned in enumerate(scans):
        fixed = scan_key({key: value for key, value in scanned.items() if key not in symbolic}, digits=17)
        groups.setdefault(fixed, []).append(v)
    for fixed, members in groups.items():
        made = _compiled(hook, fixed, symbolic)
        if made is None:
            continue
        values = np.array([[float(scans[v][key]) for key in symbolic] for v in members]).reshape(len(members), len(symbolic))
        result = _mapped_rows(made, rows[:, made.used], values)
        yield made, members, result.reshape(len(members), len(rows), len(made.rows_given), made.columns)


def _mapped_rows(made: _Compiled, rows: Array, values: Array) -> Array:
    """All pairs of variants (v, k) and rows (n, u): (v n, outputs)."""
    n, v = len(rows), len(values)
    out = np.empty((v * n, made.function.size1_out(0)))
    at_once = max(_BLOCK // max(n, 1), 1)
    for start in range(0, v, at_once):
        part = values[start : start + at_once]
        x = np.ascontiguousarray(np.broadcast_to(rows, (len(part), *rows.shape)).reshape(len(part) * n, rows.shape[1]))
        s = np.repeat(part, n, axis=0)
        evaluate_into(out[start * n : (start + len(part)) * n], made.function, x, s)
    return out
