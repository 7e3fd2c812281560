"""The main entry of the diagnosis: search, accept, refit, linearise anew, until the best explanation stands.

One-shot screening names spurious companions of strong effects (their second order, and a noise level that still holds them), so
one effect at most is accepted between two refits, and what was accepted may be dropped or exchanged at every later one.
"""

from collections.abc import Iterable, Mapping, Sequence
from typing import Protocol, runtime_checkable

from ocp.diagnosis.beam import Key, Search, Weighed
from ocp.diagnosis.conclusions import findings
from ocp.diagnosis.findings import Diagnosis, Name, Options
from ocp.diagnosis.problem import Problem, make_problem
from ocp.diagnosis.refine import refined
from ocp.diagnosis.system import Channel, scan_key
from ocp.effects.effect import Active, Effect, Scanned

USUAL = Options()
BENEFIT = 8.0  # log evidence by which a kernel must beat every name to keep it out of the fit
MOST = 1000  # readings that are searched; what is found is fitted to all


@runtime_checkable
class Thinnable(Protocol):
    """A channel that can do with fewer readings."""

    def thinned(self, most: int) -> Channel:
        """The channel with at most so many of its readings, evenly taken; itself where it has no more."""


def diagnose(channels: Sequence[Channel], library: Mapping[str, Effect], options: Options = USUAL) -> Diagnosis:
    """Where the gap of all channels lies, which effects of `library` cause it, none, or none of these."""
    baseline = tuple(c.with_active(()) if c.active else c for c in channels)
    few = tuple(c.thinned(MOST) if isinstance(c, Thinnable) else c for c in baseline)
    first = make_problem(few, library, options)
    problem, search = settle(first, library, options)
    return findings(baseline, first, problem, search, library, options)


def settle(first: Problem, library: Mapping[str, Effect], options: Options) -> tuple[Problem, Search]:
    """The last linearisation and its sets: accept, refit and linearise anew until the best set is what is active."""
    problem = first
    seeds: list[tuple[Name, ...]] = []
    tried: set[tuple[object, ...]] = set()
    while True:
        search = Search(problem.pool, options.most, options.beam)
        index = problem.index
        search.run([frozenset(index[n] for n in names if n in index) for names in seeds], pairs=problem is first)
        held = problem.channels[0].active if len(problem.channels) == 1 else _all_active(problem.channels)
        best = choose(search, len(held) + 1)
        chosen = refined(problem, best, problem.values(best))
        if _same(chosen, held) or _signature(chosen) in tried:
            return problem, search
        tried.add(_signature(chosen))
        seeds = [problem.names(k) for k in search.best()]
        problem = make_problem([c.with_active(chosen) for c in problem.channels], library, options)


def choose(search: Search, limit: int) -> Weighed:
    """The best set of at most `limit` members, or the best of all where none so small beats having none.

    A name that is nearly as good as a kernel is taken first: once it is fitted the noise level no longer holds it, and both
    compete again.
    """
    known = [k for k in search.seen if not search.kernel[list(k)].any()]
    best = _best(search, [k for k in known if len(k) <= limit])
    if not best:
        best = _best(search, known)
    overall = _best(search, search.seen)
    return search.seen[best if search.seen[best].log > search.seen[overall].log - BENEFIT else overall]


def _best(search: Search, keys: Iterable[Key]) -> Key:
    return max(keys, key=lambda k: search.seen[k].log)


def _all_active(channels: Sequence[Channel]) -> tuple[Active, ...]:
    """Effects active in any channel, once each."""
    found = {(a.effect.name, a.joint): a for c in channels for a in c.active}
    return tuple(found.values())


def _signature(active: Sequence[Active]) -> tuple[object, ...]:
    return tuple(sorted((a.effect.name, a.joint, repr(scan_key(_rounded(a.scanned)))) for a in active))


def _rounded(scanned: Scanned) -> Scanned:
    """Scanned values to two digits: finer ones are no other effect."""
    return {k: float(f"{v:.2g}") if isinstance(v, float) else v for k, v in scanned.items()}


def _same(one: Sequence[Active], other: Sequence[Active]) -> bool:
    return _signature(one) == _signature(other)
