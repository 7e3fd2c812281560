"""The main entry of the diagnosis: search, accept, refit, linearise anew, until the best explanation stands.

What then hurts where the data are extrapolated is an impostor: it is barred, and the search begins anew without it.

One-shot screening names spurious companions of strong effects (their second order, and a noise level that still holds them), so
one effect at most is accepted between two refits, and what was accepted may be dropped or exchanged at every later one.
"""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from typing import Protocol, runtime_checkable

import numpy as np

from ocp.diagnose.engine.beam import Key, Search, Weighed
from ocp.diagnose.engine.findings import Diagnosis, Name, Options
from ocp.diagnose.engine.freed import freed
from ocp.diagnose.engine.no_rest import NoRest
from ocp.diagnose.engine.problem import Problem, make_problem
from ocp.diagnose.engine.products import without_products
from ocp.diagnose.engine.refine import refined
from ocp.diagnose.engine.structured import earn, restless
from ocp.diagnose.engine.system import Channel, kinds
from ocp.diagnose.rules import IMPOSTOR_ROUNDS, KERNEL_BENEFIT, LEADS, MOST_SEARCHED, SELECTED_ON, SUSPECT, WITHOUT_IMPOSTOR
from ocp.diagnose.verdict.conclusions import findings
from ocp.diagnose.verdict.probabilities import posterior
from ocp.effects.effect import Active, Effect
from robots.errors import Infeasible

USUAL = Options()


@runtime_checkable
class Thinnable(Protocol):
    """A channel that can do with fewer readings."""

    def thinned(self, most: int) -> Channel:
        """The channel with at most so many of its readings, evenly taken; itself where it has no more."""


def diagnose(channels: Sequence[Channel], library: Mapping[str, Effect], options: Options = USUAL) -> Diagnosis:
    """Where the gap of all channels lies, which effects of `library` cause it, none, or none of these."""
    baseline = tuple(c.with_active(()) if c.active else c for c in channels)
    few = tuple(c.thinned(MOST_SEARCHED) if isinstance(c, Thinnable) else c for c in baseline)
    told: list[tuple[Name, str]] = []
    because: list[str] = []
    levels: list[float] = []
    vain = NoRest()
    for _ in range(IMPOSTOR_ROUNDS):
        first = make_problem(few, library, options)
        problem, search = settle(first, library, options, vain)
        if posterior(problem, search).p_unknown > LEADS and restless(problem, search):
            whole = baseline[0]
            earning = earn(whole.thinned(SELECTED_ON) if isinstance(whole, Thinnable) else whole, library, options)
            return findings(baseline, first, earning.problem, earning.search, library, options, earning.refused)
        found = findings(baseline, first, problem, search, library, options)
        levels.append(max(w.log for w in search.seen.values()))
        if not found.impostors:
            break
        told += found.impostors
        because += found.unknown_because
        options = replace(options, barred=(*options.barred, *(n for n, _ in found.impostors)))
    whys = tuple(f"{n}: no fit with it comes to rest" for n in vain.names())
    found = replace(found, unknown_because=tuple(dict.fromkeys((*found.unknown_because, *whys))))
    return _unmasked(found, told, because, levels[-1] > max(levels) - WITHOUT_IMPOSTOR) if told else found


def _unmasked(found: Diagnosis, told: Sequence[tuple[Name, str]], because: Sequence[str], enough: bool) -> Diagnosis:
    """Findings without the impostors that earlier rounds showed: what they fitted so well is there all the same, and most of the
    probability goes to 'none of these' unless what is left is `enough`, as good without them."""
    impostors = tuple(dict(told).items())
    share = 0.0 if found.impostors or enough else SUSPECT  # the last round has moved its own
    moved = share * (1.0 - found.p_none - found.p_unknown)
    kept = tuple(replace(e, probability=(1.0 - share) * e.probability) for e in found.explanations)
    whys = tuple(dict.fromkeys((*because, *found.unknown_because)))
    return replace(found, explanations=kept, p_unknown=found.p_unknown + moved, impostors=impostors, unknown_because=whys)


def settle(first: Problem, library: Mapping[str, Effect], options: Options, vain: NoRest | None = None) -> tuple[Problem, Search]:
    """The last linearisation and its sets: accept, refit and linearise anew until the best set is what is active; vain: what was
    fitted in vain, and will be."""
    problem, vain = first, NoRest() if vain is None else vain
    seeds: list[tuple[Name, ...]] = []
    tried: set[tuple[object, ...]] = set()
    freeing = True
    while True:
        search = Search(problem.pool, options.most, options.beam)
        index = problem.index
        search.run([frozenset(index[n] for n in names if n in index) for names in seeds], pairs=problem is first)
        held = problem.channels[0].active if len(problem.channels) == 1 else _all_active(problem.channels)
        without_products(first, problem, search, held)
        vain.rests(Name(*a.key) for a in held)
        vain.strike(search, problem)
        channels: list[Channel] | None = None
        while channels is None:
            best = choose(search, len(held) + 1)
            chosen = refined(problem, best, problem.values(best))
            if kinds(chosen) in tried | {kinds(held)}:
                channels = freed(problem, held, library, options) if freeing else None
                if channels is None:
                    return problem, search
                freeing = kinds(_all_active(channels)) not in tried  # a set that was tried is not tried for ever
                tried.add(kinds(_all_active(channels)))
                break
            tried.add(kinds(chosen))
            try:
                channels = [c.with_active(chosen) for c in problem.channels]
            except Infeasible:
                vain.add(Name(*a.key) for a in chosen)
                vain.strike(search, problem)
        seeds = [problem.names(k) for k in search.best()]
        problem = make_problem(channels, library, options)


def choose(search: Search, limit: int) -> Weighed:
    """The best set of at most `limit` names, or the best of all where none so small beats having none.

    A name that is nearly as good as a kernel is taken first: once it is fitted the noise level no longer holds it, and both
    compete again. Beside a kernel, too, at most `limit` names are taken at once.
    """
    names = {k: np.count_nonzero(~search.kernel[list(k)] & ~search.background[list(k)]) for k in search.seen}
    known = [k for k in search.seen if not search.kernel[list(k)].any()]
    best = _best(search, [k for k in known if names[k] <= limit])
    if not names[best]:
        best = _best(search, known)
    overall = _best(search, [k for k in search.seen if names[k] <= limit])
    nearly = search.seen[_best(search, known)].log > search.seen[overall].log - KERNEL_BENEFIT
    return search.seen[best if nearly else overall]


def _best(search: Search, keys: Iterable[Key]) -> Key:
    return max(keys, key=lambda k: search.seen[k].log)


def _all_active(channels: Sequence[Channel]) -> tuple[Active, ...]:
    """Effects active in any channel, once each."""
    found = {a.key: a for c in channels for a in c.active}
    return tuple(found.values())
