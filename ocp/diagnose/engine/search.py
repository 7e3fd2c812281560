"""The search: accept, refit, linearise anew, until the best explanation stands.

One-shot screening names spurious companions of strong effects (their second order, and a noise level that still holds them), so
one effect at most is accepted between two refits, and what was accepted may be dropped or exchanged at every later one.

Two things keep it honest. Fits that diverge (`Diverged`): where something is missing that nobody names, columns of an effect
that changes stiffness or contact reach for it, and the fit runs off to values at which wheel and blade hold no balance. And sets
that leave an active effect out (`reweighted`): about the accepted fit the column of an effect that multiplies (a flange's
stiffness, a gain) holds the accepted effect's own pattern times its size, and in large doses passes for that effect.
"""

from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from ocp.diagnose import rules
from ocp.diagnose.engine.beam import Key, Search, Weighed, weigh
from ocp.diagnose.engine.channel_system import Channel, effects_key
from ocp.diagnose.engine.findings import Name, Options
from ocp.diagnose.engine.outliers import outliers_rechecked
from ocp.diagnose.engine.problem import Linearisation, linearised
from ocp.diagnose.engine.refine import refined
from ocp.effects.effect import Active, Effect
from robots.errors import Infeasible


@dataclass
class Diverged:
    """Sets of names whose fit diverged, how often each name was new in one, and names that were in a fit that converged."""

    sets: set[frozenset[Name]] = field(default_factory=set)
    count: Counter[Name] = field(default_factory=Counter)
    fitted: set[Name] = field(default_factory=set)

    def add(self, names: Iterable[Name]) -> None:
        """A set whose fit diverged."""
        found = frozenset(names)
        if found:  # without effects a channel is the one that was fitted
            self.sets.add(found)
            self.count.update(found - self.fitted)

    def converged(self, names: Iterable[Name]) -> None:
        """A set whose fit converged: what holds its names may fail for others' sake."""
        found = frozenset(names)
        self.sets.discard(found)
        self.fitted |= found

    def names(self) -> list[Name]:
        """Names that are given up."""
        return sorted(n for n, k in self.count.items() if k >= rules.FAILED_FITS and n not in self.fitted)

    def strike(self, search: Search, problem: Linearisation) -> None:
        """Take the sets out of a search whose fit diverged, or that hold a name that is given up."""
        index = problem.index
        gone = {index[n] for n in self.names() if n in index}
        failed = [{index[n] for n in names} for names in self.sets if all(n in index for n in names)]
        kernel = search.kernel | search.background
        for key in list(search.sets):
            if gone & key or {f for f in key if not kernel[f]} in failed:
                del search.sets[key]


def search_and_refit(
    first: Linearisation, library: Mapping[str, Effect], options: Options, diverged: Diverged | None = None
) -> tuple[Linearisation, Search]:
    """The last linearisation and its sets: accept, refit and linearise anew until the best set is what is active; diverged: fits
    that did so far, and what this search adds."""
    problem, diverged = first, Diverged() if diverged is None else diverged
    seeds: list[tuple[Name, ...]] = []
    tried: set[tuple[object, ...]] = set()
    freeing = True
    while True:
        search = Search(problem.pool, options.most, options.beam)
        index = problem.index
        search.run([frozenset(index[n] for n in names if n in index) for names in seeds], pairs=problem is first)
        held = problem.channels[0].active if len(problem.channels) == 1 else _all_active(problem.channels)
        reweighted(first, problem, search, held)
        diverged.converged(Name(*a.key) for a in held)
        diverged.strike(search, problem)
        channels: list[Channel] | None = None
        while channels is None:
            best = next_set(search, len(held) + 1)
            chosen = refined(problem, best, problem.values(best))
            if effects_key(chosen, 2) in tried | {effects_key(held, 2)}:
                channels = outliers_rechecked(problem, held, library, options) if freeing else None
                if channels is None:
                    return problem, search
                freeing = effects_key(_all_active(channels), 2) not in tried  # a set that was tried is not tried for ever
                tried.add(effects_key(_all_active(channels), 2))
                break
            tried.add(effects_key(chosen, 2))
            try:
                channels = [c.with_active(chosen) for c in problem.channels]
            except Infeasible:
                diverged.add(Name(*a.key) for a in chosen)
                diverged.strike(search, problem)
        seeds = [problem.names(k) for k in search.best()]
        problem = linearised(channels, library, options)


def next_set(search: Search, limit: int) -> Weighed:
    """The best set of at most `limit` names, or the best of all where none so small beats having none.

    A name that is nearly as good as a kernel is taken first: once it is fitted the noise level no longer holds it, and both
    compete again. Beside a kernel, too, at most `limit` names are taken at once.
    """
    names = {k: np.count_nonzero(~search.kernel[list(k)] & ~search.background[list(k)]) for k in search.sets}
    known = [k for k in search.sets if not search.kernel[list(k)].any()]
    best = _best(search, [k for k in known if names[k] <= limit])
    if not names[best]:
        best = _best(search, known)
    overall = _best(search, [k for k in search.sets if names[k] <= limit])
    nearly = search.sets[_best(search, known)].log > search.sets[overall].log - rules.KERNEL_BENEFIT
    return search.sets[best if nearly else overall]


def _best(search: Search, keys: Iterable[Key]) -> Key:
    return max(keys, key=lambda k: search.sets[k].log)


def _all_active(channels: Sequence[Channel]) -> tuple[Active, ...]:
    """Effects active in any channel, once each."""
    found = {a.key: a for c in channels for a in c.active}
    return tuple(found.values())


def reweighted(first: Linearisation, problem: Linearisation, search: Search, held: tuple[Active, ...]) -> None:
    """Lower the weight of sets in `search.sets` that look good for a product's sake alone; first: nothing active."""
    if problem is first or not held:
        return
    index = problem.index
    active = {i for n, i in index.items() if any((n.effect, n.joint) == a.key for a in held)}
    whole = [k for k in search.sets if active <= k]
    if not active or not whole:
        return
    best = max(whole, key=lambda k: search.sets[k].log)
    there = _at(first, problem, best)
    top = max(w.log for w in search.sets.values())
    for key, weighed in list(search.sets.items()):
        if active <= key or not key or weighed.log < top - rules.REWEIGHTED_WITHIN:
            continue
        most = search.sets[best].log + _at(first, problem, key) - there + rules.REWEIGHTED_ROOM
        if most < weighed.log:
            search.sets[key] = replace(weighed, log=most)


def _at(first: Linearisation, problem: Linearisation, key: Key) -> float:
    """Log weight of the same names at the first linearisation. What was no candidate there could not be seen: it adds nothing."""
    families, index = problem.pool.families, first.index
    known = [index[families[f].name] for f in sorted(key) if families[f].name in index]
    return weigh(first.pool, known).log
