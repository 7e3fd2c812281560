"""What else the data may mean, with its probability: for predictions that do not stake everything on the likeliest explanation.

Explanations that fit the same readings may say different things of conditions nobody measured: a centre of mass that is wrong for
one payload or for all of them, a ripple or an impostor of it. Averaged by their probabilities, no prediction has a smaller
expected squared error (Hoeting et al. 1999, Bayesian model averaging). 'None' and 'none of these' count as no effect beyond what
is sure.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from ocp.diagnose.engine.beam import Search, Weighed
from ocp.diagnose.engine.findings import Alternative, Name
from ocp.diagnose.engine.pool import Member, given, scan_one
from ocp.diagnose.engine.probabilities import Names, Posterior
from ocp.diagnose.engine.problem import Linearisation
from ocp.diagnose.rules import FOLLOWED, MOST_FOLLOWED, RIGHT_BESIDE_UNKNOWN
from ocp.effects.effect import Active, Scanned


@dataclass(frozen=True)
class ExplanationWeights:
    """Probabilities of explanations by their names, of none, and of none of these."""

    explanations: Mapping[Names, float]
    none: float
    unknown: float


def alternatives(
    problem: Linearisation,
    search: Search,
    found: Posterior,
    weights: ExplanationWeights,
    chosen: tuple[Weighed, Names],
    active: tuple[Active, ...],
) -> tuple[Alternative, ...]:
    """Sets of effects with probabilities that sum to one, the accepted one first; chosen: its set and names, active: what of it
    stays in the corrected model."""
    weighed, names = chosen
    staying = {Name(*a.key) for a in active}
    dropped = {problem.pool.families[m.family].name for m in problem.named(weighed)} - staying
    listed: list[Alternative] = []
    if not active:
        return (Alternative(1.0, ()),)
    if names:
        whole = weights.explanations.get(names, 0.0)
        listed += _variants(problem, weighed, active, whole)
        listed.append(Alternative(weights.unknown, ()))
    else:  # what is sure beside an effect outside the catalogue, which it may still imitate in part
        listed += _variants(problem, weighed, active, RIGHT_BESIDE_UNKNOWN * weights.unknown)
        listed.append(Alternative((1.0 - RIGHT_BESIDE_UNKNOWN) * weights.unknown, ()))
    listed.append(Alternative(weights.none, ()))
    for other, p in sorted(weights.explanations.items(), key=lambda item: -item[1])[: MOST_FOLLOWED + 1]:
        if other != names and p >= FOLLOWED:
            members = problem.values(search.sets[found.best[other]])
            listed.append(Alternative(p, tuple(a for a in members if Name(*a.key) not in dropped)))
    return _summed(listed)


def _variants(problem: Linearisation, weighed: Weighed, active: tuple[Active, ...], whole: float) -> list[Alternative]:
    """The accepted set, its probability shared among the words that its effects may act on: payloads, nests, other joints."""
    shares: list[tuple[float, tuple[Active, ...]]] = [(1.0, active)]
    for member in problem.named(weighed):
        name = problem.pool.families[member.family].name
        place = next((i for i, a in enumerate(active) if a.key == (name.effect, name.joint)), None)
        if place is None or not _words(active[place].scanned):
            continue
        listed = _by_words(problem, weighed, member, active[place])
        shares = [(s * p, (*a[:place], one, *a[place + 1 :])) for s, a in shares for p, one in listed]
    return [Alternative(whole * s, a) for s, a in shares]


def _by_words(problem: Linearisation, weighed: Weighed, member: Member, one: Active) -> list[tuple[float, Active]]:
    """Probability of every choice of words of an effect, the rest of its set held, and the effect at its best with them."""
    pool, family = problem.pool, problem.pool.families[member.family]
    others = [m for m in weighed.members if m.family != member.family]
    log, _ = scan_one(pool, given(pool, others), member.family)
    per = np.logaddexp.reduce(log, axis=1)
    groups: dict[tuple[tuple[str, str], ...], list[int]] = {}
    for v, scanned in enumerate(family.scans):
        groups.setdefault(_words(scanned), []).append(v)
    own = _words(one.scanned)
    weight = np.array([np.exp(np.logaddexp.reduce(per[rows]) - per.max()) for rows in groups.values()])
    listed = []
    for words, rows, p in zip(groups, groups.values(), weight / weight.sum(), strict=True):
        if words == own:
            listed.append((float(p), one))
        elif p >= FOLLOWED:
            best = Member(member.family, rows[int(np.argmax(per[rows]))], 1.0)
            values = problem.values(Weighed(0.0, (*others, best)))
            listed.append((float(p), next(a for a in values if a.effect is one.effect and a.joint == one.joint)))
    return listed


def _words(scanned: Scanned) -> tuple[tuple[str, str], ...]:
    """What of scanned values is a name, not a number."""
    return tuple(sorted((k, v) for k, v in scanned.items() if isinstance(v, str)))


def _summed(listed: Sequence[Alternative]) -> tuple[Alternative, ...]:
    """The first, then the most probable others, probabilities summing to one; no effect at all as one alternative."""
    first, rest = listed[0], [a for a in listed[1:] if a.active]
    rest = sorted(rest, key=lambda a: -a.probability)[:MOST_FOLLOWED]
    nothing = Alternative(sum(a.probability for a in listed if not a.active), ())
    staying = [a for a in (first, *rest, nothing) if a is first or a.probability >= FOLLOWED]
    total = sum(a.probability for a in staying) or 1.0
    return tuple(Alternative(a.probability / total, a.active) for a in staying)
