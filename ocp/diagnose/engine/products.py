"""Sets that leave out an active effect, judged where nothing is active.

Columns are taken about the accepted fit. There the column of an effect that multiplies (a flange's stiffness, a gain) holds the
accepted effect's own pattern, a wheel's wave or a step, times its size: in large doses, with the constant part gone into the
nuisance, it passes for the accepted effect itself, and a set could do without the latter. Without that effect there is no such
pattern. So a set that leaves an active effect out may lie no nearer to those that hold it than it did at the first linearisation,
which has no products in it.
"""

from dataclasses import replace

from ocp.diagnose.engine.beam import Key, Search, weigh
from ocp.diagnose.engine.problem import Problem
from ocp.diagnose.rules import REWEIGHTED_ROOM, REWEIGHTED_WITHIN
from ocp.effects.effect import Active


def without_products(first: Problem, problem: Problem, search: Search, held: tuple[Active, ...]) -> None:
    """Lower the weight of sets in `search.seen` that look good for a product's sake alone; first: nothing active."""
    if problem is first or not held:
        return
    index = problem.index
    active = {i for n, i in index.items() if any((n.effect, n.joint) == a.key for a in held)}
    whole = [k for k in search.seen if active <= k]
    if not active or not whole:
        return
    best = max(whole, key=lambda k: search.seen[k].log)
    there = _at(first, problem, best)
    top = max(w.log for w in search.seen.values())
    for key, weighed in list(search.seen.items()):
        if active <= key or not key or weighed.log < top - REWEIGHTED_WITHIN:
            continue
        most = search.seen[best].log + _at(first, problem, key) - there + REWEIGHTED_ROOM
        if most < weighed.log:
            search.seen[key] = replace(weighed, log=most)


def _at(first: Problem, problem: Problem, key: Key) -> float:
    """Log weight of the same names at the first linearisation. What was no candidate there could not be seen: it adds nothing."""
    families, index = problem.pool.families, first.index
    known = [index[families[f].name] for f in sorted(key) if families[f].name in index]
    return weigh(first.pool, known).log
