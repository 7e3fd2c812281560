"""Candidates at one linearisation, pooled by their number of coefficients so that one call weighs them all, and what they say
over members that are given.

A family is an effect at a joint with all its variants; a library-free kernel; or a background line, a ripple of a joint below the
range of what anybody should name (every real machine has some), which explains without being named.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import NamedTuple

import numpy as np
from scipy.linalg.lapack import dpotrf, dtrtri

from ocp.diagnose import rules
from ocp.diagnose.engine.evidence import Projection, Tails, log_evidence
from ocp.diagnose.engine.findings import Name
from ocp.effects.effect import Effect, Scanned
from robots.pose import Array, Index, Mask

PAIRWISE = 3  # columns of a variant up to which its products are taken pair by pair


@dataclass(frozen=True)
class Family:
    """Candidates of one name: variants' scanned values, whitened columns (N, V, m) in units of the priors' upper ends `scale`
    (m,), positive (m,) coefficients that physics holds positive, log prior odds; sizes (T,) of the priors' widths; among: of how
    many variants these are the most telling (0: all). effect None: a kernel of the library-free tests, or background."""

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
    among: int = 0


class Member(NamedTuple):
    """A family in an explanation: its index, variant and prior size (share of the upper end)."""

    family: int
    variant: int
    size: float


@dataclass(frozen=True)
class Best:
    """The best member of a family beside others; mean log evidence of all its variants and sizes; log evidence of the others."""

    member: Member
    mean: float
    others: float


@dataclass(frozen=True)
class _Group:
    """Families of m coefficients: their projected columns (N, V, m) each, G and b, sizes (V, T); positive (V, m); starts: where
    each family begins; families: their indices."""

    m: int
    parts: tuple[Array, ...]
    G: Array
    b: Array
    sizes: Array
    positive: Array
    starts: Index
    families: Index

    @cached_property
    def X(self) -> Array:
        """All columns (N, V m) side by side: a product with them needs no copy."""
        return np.concatenate(self.parts, axis=1)


class _Kept:
    """Columns of all members that were asked for, one below the other, and their products with each other, as far as a set had
    both (nan: not yet), and (r,) with y, which few sets need anew."""

    def __init__(self, rows: int) -> None:
        self.places: dict[tuple[int, int], Index] = {}
        self.beside: dict[int, tuple[Array, Mask]] = {}  # products with a family's columns, and which are known
        self.count = 0
        self.columns, self.G, self.b = np.empty((0, rows)), np.empty((0, 0)), np.empty(0)

    def add(self, key: tuple[int, int], columns: Array, G: Array, b: Array) -> None:
        """Columns (N, m) of a member that is not there yet, their products G (m, m) with each other and b (m,) with y."""
        first, last = self.count, self.count + columns.shape[1]
        if last > len(self.columns):
            more = max(last, 64, len(self.columns))
            self.columns = np.vstack([self.columns, np.empty((more, self.columns.shape[1]))])
            self.G, self.b = np.pad(self.G, (0, more), constant_values=np.nan), np.pad(self.b, (0, more))
        self.columns[first:last], self.G[first:last, first:last], self.b[first:last] = columns.T, G, b
        self.places[key], self.count = np.arange(first, last), last

    def squares(self, at: Index) -> Array:
        """Products (r, r) of kept columns `at` (r,) with each other: few of all pairs ever stand in a set."""
        pairs = at[:, None], at
        if np.isnan(self.G[pairs]).any():
            some = self.columns[at]
            self.G[pairs] = some @ some.T
        return self.G[pairs]


@dataclass(frozen=True)
class CandidatePool:
    """y (N,) white under no effect, freedom of it, families and their groups. Kept because the same few members stand in most
    sets: `crossed`, products of members' columns with all others, `kept`, with each other and with those of one family, and
    `bests`, of families beside others."""

    y: Array
    freedom: int
    families: tuple[Family, ...]
    groups: tuple[_Group, ...]
    place: tuple[tuple[int, int], ...]  # of each family: group, first variant
    tails: tuple[Tails, ...] = ()
    crossed: dict[tuple[int, int], tuple[Array, ...]] = field(default_factory=dict, init=False, repr=False, compare=False)
    bests: dict[tuple[tuple["Member", ...], int], "Best"] = field(default_factory=dict, init=False, repr=False, compare=False)

    @cached_property
    def kept(self) -> _Kept:
        """Columns and products of members."""
        return _Kept(len(self.y))

    def among(self, members: Sequence[Member]) -> tuple[Index, Array, Array, Array]:
        """Where members' columns are kept (r,), their sizes (r,), products (r, r) of columns times sizes with each other, and
        (r,) with y."""
        places, known = [self.held(m) for m in members], self.kept
        at = np.concatenate(places)
        sizes = np.repeat([m.size for m in members], [len(place) for place in places])
        return at, sizes, known.squares(at) * (sizes[:, None] * sizes), sizes * known.b[at]

    def held(self, member: Member) -> Index:
        """Where a member's columns are kept (m,)."""
        key = (member.family, member.variant)
        if key not in self.kept.places:
            group, rows = self.of(member.family)
            k = rows.start + member.variant
            self.kept.add(key, self.columns(member), group.G[k], group.b[k])
        return self.kept.places[key]

    def join(self, there: "Given", member: Member) -> None:
        """Keep the products of a member with what is given, taken before with those of all its family's variants (`products`)."""
        at, m = self.held(member), self.of(member.family)[0].m
        found = self.kept.beside[member.family][0][there.at, member.variant * m : (member.variant + 1) * m]
        self.kept.G[there.at[:, None], at], self.kept.G[at[:, None], there.at] = found, found.T

    @cached_property
    def plain(self) -> float:
        """What tails gain where nothing is there."""
        return sum(t.gain(self.y) for t in self.tails)

    def of(self, family: int) -> tuple[_Group, slice]:
        """The group of a family, and its variants there."""
        group, start = self.place[family]
        return self.groups[group], slice(start, start + self.families[family].columns.shape[1])

    def columns(self, member: Member) -> Array:
        """Projected columns (N, m) of a member in units of the priors' upper ends."""
        return self.families[member.family].columns[:, member.variant]

    def products(self, there: "Given", family: int) -> Array:
        """Products (r, V k) of the columns that are given, times their sizes, with those of all variants of a family."""
        kept, flat = self.kept, _flat(self.families[family].columns)
        found, known = kept.beside.get(family, (np.empty((0, flat.shape[1])), np.empty(0, bool)))
        more = len(kept.columns) - len(known)
        if more:
            found, known = np.vstack([found, np.empty((more, flat.shape[1]))]), np.append(known, np.zeros(more, bool))
            kept.beside[family] = found, known
        if not known[there.at].all():
            group, start = self.place[family]
            own = slice(start * self.groups[group].m, start * self.groups[group].m + flat.shape[1])
            for m in there.members:
                place, ready = kept.places[m.family, m.variant], self.crossed.get((m.family, m.variant))
                found[place] = self.columns(m).T @ flat if ready is None else ready[group][:, own]
                known[place] = True
        return np.asarray(there.sizes[:, None] * found[there.at])

    def look_ahead(self, members: Sequence[Member]) -> None:
        """Take the products of all members that `scan` will ask for at once: the candidates are read from memory only once."""
        new = list({(m.family, m.variant): m for m in members if (m.family, m.variant) not in self.crossed}.values())
        if not new:
            return
        parts = [self.columns(m) for m in new]
        C = np.ascontiguousarray(np.hstack(parts).T)
        ends = np.cumsum([part.shape[1] for part in parts])[:-1]
        for m, *products in zip(new, *(np.split(C @ _flat(g.X), ends) for g in self.groups), strict=True):
            self.crossed[m.family, m.variant] = tuple(products)


@dataclass(frozen=True)
class Given:
    """Members of a pool taken as there, with priors of fixed size; at (r,): where their columns are kept, sizes (r,); with C
    (N, r), the columns times the sizes: turn (r, r), inverse of the lower Cholesky factor of 1 + C^T C; inner (r,): turn C^T y;
    left: what remains of y^T y, log: their joint evidence over the empty set."""

    pool: CandidatePool = field(repr=False)
    members: tuple[Member, ...]
    at: Index
    sizes: Array
    turn: Array
    inner: Array
    left: float
    log: float

    @cached_property
    def C(self) -> Array:
        """Columns (N, r) of all members times their sizes."""
        none = np.zeros((len(self.pool.y), 0))
        return np.hstack([none, *(self.pool.columns(m) * m.size for m in self.members)])

    @cached_property
    def directions(self) -> tuple[Array, Array]:
        """Left singular vectors (N, r) of the columns, and what (r,) of the inverse covariance they take of each."""
        U, s, _ = np.linalg.svd(self.C, full_matrices=False)
        return U, s**2 / (1.0 + s**2)

    @property
    def tailed(self) -> float:
        """What the evidence has over eq. 4, where readings have tails, over nothing given."""
        if not self.pool.tails:
            return 0.0
        rest = self.pool.y - (self.sizes * (self.turn.T @ self.inner)) @ self.pool.kept.columns[self.at]
        return sum(t.gain(rest) for t in self.pool.tails) - self.pool.plain

    def after(self, rows: Array) -> Array:
        """Rows (N,) or (N, m) with what is given projected out too."""
        U, take = self.directions
        return Projection(U, 1.0 - np.sqrt(1.0 - take), 0).apply(rows)


@dataclass(frozen=True)
class Scan:
    """Of every family: log evidence (f,) over what is given, all variants and sizes averaged; best variant (f,) and size (f,)."""

    log: Array
    variant: Index
    size: Array


def make_pool(y: Array, freedom: int, families: Sequence[Family], tails: tuple[Tails, ...] = ()) -> CandidatePool:
    """Pool of families whose columns are projected already."""
    groups: list[_Group] = []
    place = [(-1, -1)] * len(families)
    for m in sorted({f.columns.shape[2] for f in families}):
        chosen = [i for i, f in enumerate(families) if f.columns.shape[2] == m]
        parts = tuple(families[i].columns for i in chosen)
        counts = [part.shape[1] for part in parts]
        starts = np.concatenate([[0], np.cumsum(counts)[:-1]]).astype(np.int64)
        for i, start in zip(chosen, starts, strict=True):
            place[i] = (len(groups), int(start))
        sizes = np.repeat([families[i].sizes for i in chosen], counts, axis=0)
        positive = np.repeat([families[i].positive for i in chosen], counts, axis=0)
        inner = np.concatenate([y @ _flat(part) for part in parts]).reshape(-1, m)
        G = np.concatenate([squares(part) for part in parts])
        groups.append(_Group(m, parts, G, inner, sizes, positive, starts, np.array(chosen)))
    return CandidatePool(y, freedom, tuple(families), tuple(groups), tuple(place), tails)


def _flat(columns: Array) -> Array:
    """Columns (N, V, m) as (N, V m)."""
    return columns.reshape(len(columns), -1)


def most_telling(pool: CandidatePool, held: Sequence[Member]) -> list[Family]:
    """The families with their most telling variants alone, over nothing, over what is held, and over that without each of its
    members, whose place they may take; and with those held: a family of so many fewer columns is weighed so much faster. What
    the others would add is left out of its mean, what they cost is in its odds."""
    best = [{m.variant for m in held if m.family == i} for i in range(len(pool.families))]
    rests = [[one for one in held if one is not out] for out in held]
    for members in [rest for rest in rests if rest] + [held] * bool(held) + [()]:
        there = given(pool, members)
        C = np.ascontiguousarray(there.C.T)
        for g in pool.groups:
            G, b = g.G, g.b
            if members:  # once for all: not worth laying all columns side by side
                G, b = _beside(there, np.hstack([C @ _flat(part) for part in g.parts]), G, b)
            each = np.logaddexp.reduce(log_evidence(G, b, g.sizes, g.positive, there.left, pool.freedom), axis=1)
            for family, start in zip(g.families, g.starts, strict=True):
                own = each[start : start + pool.families[family].columns.shape[1]]
                best[family].update(np.argsort(-own)[: rules.MOST_TELLING].tolist())
    families = []
    for family, chosen in zip(pool.families, best, strict=True):
        count, rows = family.columns.shape[1], sorted(chosen)
        if len(rows) == count:
            families.append(family)
            continue
        odds = family.log_odds + float(np.log(len(rows) / count))
        scans, among = tuple(family.scans[v] for v in rows), max(family.among, count)
        columns = np.ascontiguousarray(family.columns[:, rows])  # picked, they lie by variants
        families.append(replace(family, scans=scans, columns=columns, log_odds=odds, among=among))
    return families


def squares(X: Array) -> Array:
    """X^T X (V, m, m) of every variant of X (N, V, m). Few columns pair by pair, many by a product a variant: whichever is the
    faster by far."""
    V, m = X.shape[1:]
    if m > PAIRWISE:
        turned = np.ascontiguousarray(X.transpose(1, 2, 0))
        return np.asarray(turned @ turned.transpose(0, 2, 1))
    G = np.empty((V, m, m))
    for a in range(m):
        for b in range(a, m):
            G[:, a, b] = G[:, b, a] = np.einsum("nv,nv->v", X[:, :, a], X[:, :, b])
    return G


def given(pool: CandidatePool, members: Sequence[Member]) -> Given:
    """Joint evidence of members at their sizes."""
    left = float(pool.y @ pool.y)
    if not members:
        return Given(pool, (), np.zeros(0, np.int64), np.zeros(0), np.zeros((0, 0)), np.zeros(0), left, 0.0)
    at, sizes, G, b = pool.among(members)
    G[np.diag_indices(len(b))] += 1.0
    turn, failed = dtrtri(dpotrf(G, lower=1, clean=1)[0], lower=1)
    if failed:
        raise np.linalg.LinAlgError("columns of a set are not numbers")
    inner = turn @ b
    after = max(left - float(inner @ inner), 1e-9)
    fit = 0.5 * (pool.freedom + rules.NOISE_TRUST) * np.log((rules.NOISE_TRUST + after) / (rules.NOISE_TRUST + left))
    return Given(pool, tuple(members), at, sizes, turn, inner, after, float(float(np.log(np.diag(turn)).sum()) - fit))


def scan(pool: CandidatePool, there: Given) -> Scan:
    """Evidence of every family over what is given."""
    count = len(pool.families)
    log, variant, size = np.full(count, -np.inf), np.zeros(count, np.int64), np.ones(count)
    pool.look_ahead(there.members)
    crossed = [(pool.crossed[m.family, m.variant], m.size) for m in there.members]
    for k, g in enumerate(pool.groups):
        G, b = g.G, g.b
        if crossed:
            G, b = _beside(there, np.vstack([s * rows[k] for rows, s in crossed]), G, b)
        every = log_evidence(G, b, g.sizes, g.positive, there.left, pool.freedom)
        counts = np.diff(np.append(g.starts, len(every)))
        per = np.logaddexp.reduce(every, axis=1)
        log[g.families] = np.logaddexp.reduceat(per, g.starts) - np.log(counts * every.shape[1])
        tops = np.flatnonzero(per == np.repeat(np.maximum.reduceat(per, g.starts), counts))
        best = tops[np.searchsorted(tops, g.starts)]  # the first of each family that reaches its top
        variant[g.families] = best - g.starts
        size[g.families] = g.sizes[best, np.argmax(every[best], axis=1)]
    return Scan(log, variant, size)


def scan_one(pool: CandidatePool, there: Given, family: int) -> tuple[Array, Array]:
    """Log evidence (V, T) of one family's variants over what is given, and its sizes (T,)."""
    g, rows = pool.of(family)
    G, b = g.G[rows], g.b[rows]
    if there.members:
        G, b = _beside(there, pool.products(there, family), G, b)
    return log_evidence(G, b, g.sizes[rows], g.positive[rows], there.left, pool.freedom), g.sizes[rows.start]


def _beside(there: Given, crossed: Array, G: Array, b: Array) -> tuple[Array, Array]:
    """X^T X (V, m, m) and X^T y (V, m) once the columns that are given have taken their part; crossed (r, V m): C^T X."""
    held = (there.turn @ crossed).reshape(len(crossed), *b.shape)
    return G - squares(held), b - np.einsum("rvi,r->vi", held, there.inner)
