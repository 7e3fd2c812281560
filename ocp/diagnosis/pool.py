"""All candidates at one linearisation, pooled by their number of coefficients so that one call weighs them all.

A family is an effect at a joint with all its variants; a library-free kernel; or a background line, a ripple of a joint below
the range of what anybody should name (every real machine has some), which explains without being named.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from ocp.diagnosis.evidence import TRUST, log_evidence
from ocp.diagnosis.findings import Name
from ocp.effects.effect import Effect, Scanned
from robots.measurements import Index
from robots.pose import Array


@dataclass(frozen=True)
class Family:
    """Candidates of one name: variants' scanned values, whitened columns (N, V, m) in units of the priors' upper ends `scale`
    (m,), positive (m,) coefficients that physics holds positive,
    log prior odds; sizes (T,) of the priors' widths. effect None: a kernel of the library-free tests, or background."""

    name: Name
    effect: Effect | None
    scans: tuple[Scanned, ...]
    columns: Array = field(repr=False)
    scale: Array
    sizes: Array
    positive: Array
    log_odds: float
    where: str = ""
    background: bool = False


@dataclass(frozen=True)
class Member:
    """A family in an explanation: its index, variant and prior size (share of the upper end)."""

    family: int
    variant: int
    size: float


@dataclass(frozen=True)
class _Group:
    """Families of m coefficients: X (N, V, m) projected, G and b, sizes (V, T); positive
    (V, m); starts: where each family begins; families: their indices."""

    m: int
    X: Array
    G: Array
    b: Array
    sizes: Array
    positive: Array
    starts: Index
    families: Index


@dataclass(frozen=True)
class Pool:
    """y (N,) white under no effect, freedom of it, families and their groups."""

    y: Array
    freedom: int
    families: tuple[Family, ...]
    groups: tuple[_Group, ...]
    place: tuple[tuple[int, int], ...]  # of each family: group, first variant

    def columns(self, member: Member) -> Array:
        """Projected columns (N, m) of a member in units of the priors' upper ends."""
        group, start = self.place[member.family]
        return self.groups[group].X[:, start + member.variant]


@dataclass(frozen=True)
class Given:
    """Members taken as there, with priors of fixed size: U (N, r) left vectors of their columns, take (r,) of the covariance's
    inverse, left: what remains of y^T y, log: their joint evidence over the empty set."""

    members: tuple[Member, ...]
    U: Array
    take: Array
    left: float
    log: float


@dataclass(frozen=True)
class Scan:
    """Of every family: log evidence (f,) over what is given, all variants and sizes averaged; best variant (f,) and size (f,)."""

    log: Array
    variant: Index
    size: Array


def make_pool(y: Array, freedom: int, families: Sequence[Family]) -> Pool:
    """Pool of families whose columns are projected already."""
    groups: list[_Group] = []
    place = [(-1, -1)] * len(families)
    for m in sorted({f.columns.shape[2] for f in families}):
        chosen = [i for i, f in enumerate(families) if f.columns.shape[2] == m]
        X = np.ascontiguousarray(np.concatenate([families[i].columns for i in chosen], axis=1))
        counts = [families[i].columns.shape[1] for i in chosen]
        starts = np.concatenate([[0], np.cumsum(counts)[:-1]]).astype(np.int64)
        for i, start in zip(chosen, starts, strict=True):
            place[i] = (len(groups), int(start))
        sizes = np.repeat([families[i].sizes for i in chosen], counts, axis=0)
        positive = np.repeat([families[i].positive for i in chosen], counts, axis=0)
        G = np.empty((X.shape[1], m, m))
        for a in range(m):
            for b in range(a, m):
                G[:, a, b] = G[:, b, a] = np.einsum("nv,nv->v", X[:, :, a], X[:, :, b])
        inner = (y @ X.reshape(len(y), -1)).reshape(-1, m)
        groups.append(_Group(m, X, G, inner, sizes, positive, starts, np.array(chosen)))
    return Pool(y, freedom, tuple(families), tuple(groups), tuple(place))


def given(pool: Pool, members: Sequence[Member]) -> Given:
    """Joint evidence of members at their sizes."""
    left = float(pool.y @ pool.y)
    if not members:
        return Given((), np.zeros((len(pool.y), 0)), np.zeros(0), left, 0.0)
    C = np.hstack([pool.columns(m) * m.size for m in members])
    U, s, _ = np.linalg.svd(C, full_matrices=False)
    take = s**2 / (1.0 + s**2)
    after = max(left - float(take @ (U.T @ pool.y) ** 2), 1e-9)
    log = -0.5 * float(np.log1p(s**2).sum()) - 0.5 * (pool.freedom + TRUST) * np.log((TRUST + after) / (TRUST + left))
    return Given(tuple(members), U, take, after, float(log))


def scan(pool: Pool, there: Given) -> Scan:
    """Evidence of every family over what is given."""
    count = len(pool.families)
    log = np.full(count, -np.inf)
    variant, size = np.zeros(count, np.int64), np.ones(count)
    inner = there.U.T @ pool.y
    for g in pool.groups:
        G, b = g.G, g.b
        if len(there.take):
            P = (there.U.T @ g.X.reshape(len(pool.y), -1)).reshape(len(there.take), -1, g.m)
            held = there.take[:, None, None] * P
            G = G - np.einsum("rvi,rvj->vij", P, held)
            b = b - np.einsum("rvi,r->vi", held, inner)
        every = log_evidence(G, b, g.sizes, g.positive, there.left, pool.freedom)
        _summarise(g, every, (log, variant, size))
    return Scan(log, variant, size)


def scan_one(pool: Pool, there: Given, family: int) -> tuple[Array, Array]:
    """Log evidence (V, T) of one family's variants over what is given, and its sizes (T,)."""
    k, start = pool.place[family]
    g, count = pool.groups[k], pool.families[family].columns.shape[1]
    rows = slice(start, start + count)
    G, b = g.G[rows], g.b[rows]
    if len(there.take):
        P = np.einsum("nr,nvi->rvi", there.U, g.X[:, rows]) if count == 1 else np.tensordot(there.U.T, g.X[:, rows], 1)
        held = there.take[:, None, None] * P
        G = G - np.einsum("rvi,rvj->vij", P, held)
        b = b - np.einsum("rvi,r->vi", held, there.U.T @ pool.y)
    return log_evidence(G, b, g.sizes[rows], g.positive[rows], there.left, pool.freedom), g.sizes[start]


def _summarise(g: _Group, every: Array, out: tuple[Array, Index, Array]) -> None:
    """Per family: mean evidence over variants and sizes, best variant and size, written into `out`."""
    log, variant, size = out
    counts = np.diff(np.append(g.starts, len(every)))
    per = np.logaddexp.reduce(every, axis=1)
    log[g.families] = np.logaddexp.reduceat(per, g.starts) - np.log(counts * every.shape[1])
    for f, start, n in zip(g.families, g.starts, counts, strict=True):
        k = int(np.argmax(per[start : start + n]))
        variant[f] = k
        size[f] = g.sizes[start + k, int(np.argmax(every[start + k]))]
