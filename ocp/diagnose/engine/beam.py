"""Sets of effects and their posterior weights: singles and pairs exactly, a beam beyond, with add, drop and swap."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np

from ocp.diagnose import rules
from ocp.diagnose.engine.pool import CandidatePool, Given, Member, Scan, given, scan, scan_one
from robots.pose import Array

Key = frozenset[int]


@dataclass(frozen=True)
class Weighed:
    """A set of families: log posterior weight over 'none' (evidence and prior), members at their most probable variant and
    size."""

    log: float
    members: tuple[Member, ...]


NOTHING = Weighed(0.0, ())


def weigh(pool: CandidatePool, families: Sequence[int], near: Sequence[Member] = ()) -> Weighed:
    """Exact weight of a set: joint evidence at the best variants and sizes, each then averaged over its own variants and
    sizes with the others held."""
    known = {m.family: m for m in near}
    members: list[Member] = []
    for f in families:
        if f in known:
            members.append(known[f])
        else:
            members.append(_best(pool, given(pool, members), f)[0])
    if len(members) > 1:
        for i in range(len(members)):
            members[i] = _best(pool, given(pool, members[:i] + members[i + 1 :]), members[i].family)[0]
    joint = given(pool, members)
    total = joint.log
    for i, member in enumerate(members):
        others = given(pool, members[:i] + members[i + 1 :])
        total += _best(pool, others, member.family)[1] - (joint.log - others.log) + pool.families[member.family].log_odds
    return Weighed(float(total), tuple(members))


def _best(pool: CandidatePool, there: Given, family: int) -> tuple[Member, float]:
    """Best variant and size of a family over what is there; mean log evidence of all."""
    every, sizes = scan_one(pool, there, family)
    v, t = np.unravel_index(int(np.argmax(every)), every.shape)
    mean = np.logaddexp.reduce(every, axis=None) - np.log(every.size)
    return Member(family, int(v), float(sizes[t])), float(mean)


class Search:
    """Sets weighed at one linearisation. `sets` by the families in them; the empty set weighs 0."""

    def __init__(self, pool: CandidatePool, most: int, beam: int) -> None:
        self.pool, self.most, self.beam = pool, most, beam
        self.sets: dict[Key, Weighed] = {frozenset(): NOTHING}
        self._scans: dict[Key, Scan] = {}
        self.odds = np.array([f.log_odds for f in pool.families])
        self.kernel = np.array([f.effect is None and not f.background for f in pool.families])
        self.background = np.array([f.background for f in pool.families])

    def run(self, seeds: Iterable[Key] = (), pairs: bool = True) -> None:
        """Singles, pairs, then grow, drop and swap until the best sets stay the same."""
        first = self.scan(NOTHING)
        gain = self._value(first)
        order = np.argsort(-gain)
        for f in order[: rules.EXACT_SINGLES]:
            if not np.isfinite(gain[f]):
                break
            self.add(frozenset([int(f)]))
        if pairs and self.most > 1:
            self._pairs(first, gain)
        for key in seeds:
            self.add(key)
        done: set[Key] = set()
        for _ in range(4 * self.most):
            fresh = [k for k in dict.fromkeys((*self.best(), *self._named())) if k not in done]
            if not fresh:
                break
            for key in fresh:
                done.add(key)
                self._around(key)

    def best(self) -> list[Key]:
        """The beam: best sets by weight."""
        order = sorted(self.sets, key=lambda k: -self.sets[k].log)[: self.beam]
        return [k for k in order if self.sets[k].log > self.sets[order[0]].log - rules.GROWN_WITHIN]

    def _named(self) -> list[Key]:
        """The best sets of names alone."""
        known = [k for k in self.sets if not self.kernel[list(k)].any()]
        return sorted(known, key=lambda k: -self.sets[k].log)[: rules.GROWN_NAMES]

    def scan(self, there: Weighed) -> Scan:
        """Every family over a set."""
        key = frozenset(m.family for m in there.members)
        if key not in self._scans:
            self._scans[key] = scan(self.pool, given(self.pool, there.members))
        return self._scans[key]

    def add(self, key: Key, near: Sequence[Member] = ()) -> None:
        """Weigh a set unless it was, or has two kernels, or too many members."""
        families = sorted(key)
        lines = int(self.background[families].sum())
        if key in self.sets or len(key) - lines > self.most or lines > rules.MOST_BACKGROUND or self.kernel[families].sum() > 1:
            return
        self.sets[key] = weigh(self.pool, families, near)

    def _pairs(self, first: Scan, gain: Array) -> None:
        """All pairs whose first member is among the most telling: weighed roughly, then the best exactly."""
        order = [f for f in np.argsort(-gain)[: rules.PAIR_FIRSTS] if np.isfinite(gain[f])]
        found: dict[Key, float] = {}
        firsts = [Member(int(f), int(first.variant[f]), float(first.size[f])) for f in order]
        self.pool.look_ahead(firsts)
        for one in firsts:
            f = one.family
            value = self._value(scan(self.pool, given(self.pool, [one])), frozenset([f])) + gain[f]
            if self.kernel[f]:
                value[self.kernel] = -np.inf
            for g in np.argsort(-value)[:8]:
                key = frozenset([f, int(g)])
                found[key] = max(found.get(key, -np.inf), float(value[g]))
        for key in sorted(found, key=lambda k: -found[k])[: rules.EXACT_PAIRS]:
            self.add(key)

    def _around(self, key: Key) -> None:
        """Add a family, drop one, put another in a member's place."""
        here = self.sets[key]
        for f in self._promising(here, key):
            self.add(key | {f}, here.members)
        for out in key:
            rest = key - {out}
            near = tuple(m for m in here.members if m.family != out)
            self.add(rest, near)
            if rest in self.sets:
                for f in self._promising(self.sets[rest], rest):
                    self.add(rest | {f}, near)

    def _promising(self, there: Weighed, key: Key) -> list[int]:
        value = self._value(self.scan(there), key)
        if self.kernel[list(key)].any():
            value[self.kernel] = -np.inf  # one unknown effect is enough
        return [int(f) for f in np.argsort(-value)[: rules.GROWN] if np.isfinite(value[f])]

    def _value(self, found: Scan, key: Key = frozenset()) -> Array:
        """Log weight that each family would add, background lines only where they are telling."""
        value = found.log + self.odds
        value[list(key)] = -np.inf
        return np.where(self.background & (value < rules.BACKGROUND_GAIN), -np.inf, value)
