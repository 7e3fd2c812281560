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
from robots.pose import Array, Index


@dataclass(frozen=True)
class Family:
    """Candidates of one name: variants' scanned values, whitened columns (N, V, m) in units of the priors' upper ends `scale`
    (m,), positive (m,) coefficients that physics holds positive, log prior odds; sizes (T,) of the priors' widths; among: of how
    many variants these are the most telling (0: all); within (V,): log odds of each variant over equal ones. effect None: of the
    library-free tests a kernel, or background."""

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
    within: Array | float = 0.0


Which = tuple[int, int]
"""A member's family and variant."""


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
    """Families of m coefficients: their projected columns (N, V, m) each, G and b, sizes (V, T); positive (V, m); log odds within
    (V, 1); starts: where each family begins; families: their indices."""

    m: int
    parts: tuple[Array, ...]
    G: Array
    b: Array
    sizes: Array
    positive: Array
    within: Array
    starts: Index
    families: Index

    @cached_property
    def X(self) -> Array:
        """All columns (N, V m) side by side: a product with them needs no copy."""
        return np.concatenate(self.parts, axis=1)


@dataclass(frozen=True)
class CandidatePool:
    """y (N,) white under no effect, freedom of it, families and their groups. Kept because the same few members stand in most
    sets: `pairs`, products of members' columns with each other, `crossed`, with all others, `beside`, with those of one family,
    and `bests`, of families beside others; a member's family and variant say which."""

    y: Array
    freedom: int
    families: tuple[Family, ...]
    groups: tuple[_Group, ...]
    place: tuple[tuple[int, int], ...]  # of each family: group, first variant
    tails: tuple[Tails, ...] = ()
    pairs: dict[tuple[Which, Which], Array] = field(default_factory=dict, init=False, repr=False, compare=False)
    crossed: dict[Which, tuple[Array, ...]] = field(default_factory=dict, init=False, repr=False, compare=False)
    beside: dict[tuple[Which, int], Array] = field(default_factory=dict, init=False, repr=False, compare=False)
    bests: dict[tuple[tuple["Member", ...], int], "Best"] = field(default_factory=dict, init=False, repr=False, compare=False)

    def among(self, members: Sequence[Member]) -> tuple[Array, Array, Array]:
        """Sizes (r,) of members' columns, products (r, r) of columns times sizes with each other, and (r,) with y."""
        which, own, counts = [m[:2] for m in members], list[Array](), list[int]()
        for m in members:
            group, rows = self.of(m.family)
            self.pairs.setdefault((m[:2], m[:2]), group.G[rows.start + m.variant])
            own.append(group.b[rows.start + m.variant])
            counts.append(group.m)
        if not all((one, other) in self.pairs for one in which for other in which):
            rows_of, ends = self.rows(members), np.cumsum(counts)[:-1]
            for one, part in zip(which, np.split(rows_of @ rows_of.T, ends), strict=True):
                self.pairs.update(((one, other), G) for other, G in zip(which, np.split(part, ends, axis=1), strict=True))
        G = np.vstack([np.hstack([self.pairs[one, other] for other in which]) for one in which])
        sizes = np.repeat([m.size for m in members], counts)
        return sizes, G * (sizes[:, None] * sizes), sizes * np.concatenate(own)

    def join(self, there: "Given", member: Member) -> None:
        """Keep the products of a member with what is given, taken before with those of all its family's variants (`products`)."""
        m = self.of(member.family)[0].m
        for one in there.members:
            found = self.beside[one[:2], member.family][:, member.variant * m : (member.variant + 1) * m]
            self.pairs[one[:2], member[:2]], self.pairs[member[:2], one[:2]] = found, found.T

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

    def rows(self, members: Sequence[Member]) -> Array:
        """Columns of members, one below the other (r, N)."""
        return np.vstack([np.zeros((0, len(self.y))), *(self.columns(m).T for m in members)])

    def products(self, there: "Given", family: int) -> Array:
        """Products (r, V k) of the columns that are given, times their sizes, with those of all variants of a family."""
        flat, (group, start) = _flat(self.families[family].columns), self.place[family]
        own = slice(start * self.groups[group].m, start * self.groups[group].m + flat.shape[1])
        for m in there.members:
            if (m[:2], family) not in self.beside:
                ready = self.crossed.get(m[:2])
                self.beside[m[:2], family] = self.columns(m).T @ flat if ready is None else ready[group][:, own]
        return np.asarray(there.sizes[:, None] * np.vstack([self.beside[m[:2], family] for m in there.members]))

    def look_ahead(self, members: Sequence[Member]) -> None:
        """Take the products of all members that `scan` will ask for at once: the candidates are read from memory only once."""
        new = list({m[:2]: m for m in members if m[:2] not in self.crossed}.values())
        if not new:
            return
        parts = [self.columns(m) for m in new]
        C = np.ascontiguousarray(np.hstack(parts).T)
        ends = np.cumsum([part.shape[1] for part in parts])[:-1]
        for m, *products in zip(new, *(np.split(C @ _flat(g.X), ends) for g in self.groups), strict=True):
            self.crossed[m[:2]] = tuple(products)


@dataclass(frozen=True)
class Given:
    """Members of a pool taken as there, with priors of fixed size; sizes (r,) of their columns; with C (N, r), the columns times
    the sizes: turn (r, r), inverse of the lower Cholesky factor of 1 + C^T C; inner (r,): turn C^T y;
    left: what remains of y^T y, log: their joint evidence over the empty set."""

    pool: CandidatePool = field(repr=False)
    members: tuple[Member, ...]
    sizes: Array
    turn: Array
    inner: Array
    left: float
    log: float

    @cached_property
    def C(self) -> Array:
        """Columns (N, r) of all members times their sizes."""
        return (self.sizes[:, None] * self.pool.rows(self.members)).T

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
        rest = self.pool.y - (self.sizes * (self.turn.T @ self.inner)) @ self.pool.rows(self.members)
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
        within = np.concatenate([np.broadcast_to(families[i].within, k) for i, k in zip(chosen, counts, strict=True)])
        inner = np.concatenate([y @ _flat(part) for part in parts]).reshape(-1, m)
        G = np.concatenate([squares(part) for part in parts])
        groups.append(_Group(m, parts, G, inner, sizes, positive, within[:, None], starts, np.array(chosen)))
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
        C = there.C.T
        for g in pool.groups:
            G, b = g.G, g.b
            if members:  # once for all: not worth laying all columns side by side
                G, b = _beside(there, np.hstack([C @ _flat(part) for part in g.parts]), G, b)
            each = np.logaddexp.reduce(log_evidence(G, b, g.sizes, g.positive, there.left, pool.freedom) + g.within, axis=1)
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
        within = np.broadcast_to(family.within, count)[rows]
        columns = np.ascontiguousarray(family.columns[:, rows])  # picked, they lie by variants
        families.append(replace(family, scans=scans, columns=columns, log_odds=odds, among=among, within=within))
    return families


def squares(X: Array) -> Array:
    """X^T X (V, m, m) of every variant of X (N, V, m)."""
    turned = np.ascontiguousarray(X.transpose(1, 2, 0))
    return np.asarray(turned @ turned.transpose(0, 2, 1))


def given(pool: CandidatePool, members: Sequence[Member]) -> Given:
    """Joint evidence of members at their sizes."""
    left = float(pool.y @ pool.y)
    if not members:
        return Given(pool, (), np.zeros(0), np.zeros((0, 0)), np.zeros(0), left, 0.0)
    sizes, G, b = pool.among(members)
    G[np.diag_indices(len(b))] += 1.0
    turn, failed = dtrtri(dpotrf(G, lower=1, clean=1)[0], lower=1)
    if failed:
        raise np.linalg.LinAlgError("columns of a set are not numbers")
    inner = turn @ b
    after = max(left - float(inner @ inner), 1e-9)
    fit = 0.5 * (pool.freedom + rules.NOISE_TRUST) * np.log((rules.NOISE_TRUST + after) / (rules.NOISE_TRUST + left))
    return Given(pool, tuple(members), sizes, turn, inner, after, float(float(np.log(np.diag(turn)).sum()) - fit))


def scan(pool: CandidatePool, there: Given) -> Scan:
    """Evidence of every family over what is given."""
    count = len(pool.families)
    log, variant, size = np.full(count, -np.inf), np.zeros(count, np.int64), np.ones(count)
    pool.look_ahead(there.members)
    crossed = [(pool.crossed[m[:2]], m.size) for m in there.members]
    for k, g in enumerate(pool.groups):
        G, b = g.G, g.b
        if crossed:
            G, b = _beside(there, np.vstack([s * rows[k] for rows, s in crossed]), G, b)
        every = log_evidence(G, b, g.sizes, g.positive, there.left, pool.freedom) + g.within
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
    return log_evidence(G, b, g.sizes[rows], g.positive[rows], there.left, pool.freedom) + g.within[rows], g.sizes[rows.start]


def _beside(there: Given, crossed: Array, G: Array, b: Array) -> tuple[Array, Array]:
    """X^T X (V, m, m) and X^T y (V, m) once the columns that are given have taken their part; crossed (r, V m): C^T X."""
    held = (there.turn @ crossed).reshape(len(crossed), *b.shape)
    return G - squares(held), b - np.einsum("rvi,r->vi", held, there.inner)
