"""From weighed sets to probabilities of explanations, of 'none' and of 'none of these'; what data cannot tell apart;
alternatives.

**Classes** are effects that the data at hand cannot tell apart. Effect e with signature d (projected, at its value) and
another effect f whose columns C imitate it: what f leaves of it is lambda (1 - R^2) = |d|^2 - d^T C (C^T C + 1 / prior^2)^-1
C^T d. Below 10.5, 12.7, 14.2 for 1, 2, 3 parameters no test at this size tells them apart (power 0.9 at one in twenty), and
both names stand for one class. The prior keeps an effect from imitating another with values it never takes.

**Alternatives** are what else the data may mean, with its probability: for predictions that do not stake everything on the
likeliest explanation. Explanations that fit the same readings may say different things of conditions nobody measured: a
centre of mass that is wrong for one payload or for all of them, a ripple or an impostor of it. Averaged by their
probabilities, no prediction has a smaller expected squared error (Hoeting et al. 1999, Bayesian model averaging). 'None of
these' in the place of all names, or of one, is what stands for it, its kernels as patches that stay as they are beyond what was
measured: the readings show a gap under it too, and what they show is there again. Where a set lacks an accepted effect only
because its background takes it, the machine has it all the same, under no name: it stays in that alternative.
"""

from collections import defaultdict
from collections.abc import Iterable, Iterator, Sequence
from copy import copy
from dataclasses import dataclass, replace

import numpy as np

from ocp.diagnose import rules
from ocp.diagnose.engine.beam import NOTHING, Key, Search, Weighed
from ocp.diagnose.engine.findings import Alternative, Name, Ranked, summing_to
from ocp.diagnose.engine.linearisation import Linearisation
from ocp.diagnose.engine.pool import Given, Member, given, squares
from ocp.diagnose.verdict.patching import patches_of, unfaded
from ocp.effects.effect import Active, Scanned
from ocp.effects.patch import is_patch
from robots.pose import Array

Names = tuple[Name, ...]


@dataclass(frozen=True)
class Posterior:
    """Probability by explanation (names from the library, kernels summed out); p_none: no name is in; p_unknown: a kernel is in,
    with names or without; beside: shares of it by explanation, of none as well; where: by kernel; marginal by name; gain: best
    log weight with a name less best without it and without what stands for it in the background; best: of the sets of every
    explanation."""

    probability: dict[Names, float]
    p_none: float
    p_unknown: float
    beside: dict[Names, float]
    where: dict[Name, float]
    marginal: dict[Name, float]
    gain: dict[Name, float]
    best: dict[Names, Weighed]


def posterior(problem: Linearisation, search: Search) -> Posterior:
    """Background lines and kernels are summed over: they explain without being named."""
    log = np.array([one.log for one in search.sets.values()])
    share = np.exp(log - log.max())
    share /= share.sum()
    families = problem.pool.families
    probability, beside = defaultdict[Names, float](float), defaultdict[Names, float](float)
    where, marginal = defaultdict[Name, float](float), defaultdict[Name, float](float)
    best, with_name = dict[Names, Weighed](), dict[Name, float]()
    p_unknown = 0.0
    for (key, one), p in zip(search.sets.items(), share.tolist(), strict=True):
        named = _names_in(problem, key)
        strange = [families[f].name for f in key if search.kernel[f]]
        for name in named:
            marginal[name] += p
            with_name[name] = max(with_name.get(name, -np.inf), one.log)
        for name in strange:
            where[name] += p
        if strange:
            p_unknown += p
            beside[named] += p
        probability[named] += p
        if named not in best or one.log > best[named].log:
            best[named] = one
    gain = {name: w - max(_without(name, problem, search), 0.0) for name, w in with_name.items()}
    p_none = min(probability.pop((), 0.0), 1.0)
    return Posterior(probability, p_none, min(p_unknown, 1.0), beside, where, marginal, gain, best)


def _names_in(problem: Linearisation, key: Key) -> Names:
    """The explanation that a set is of."""
    families = problem.pool.families
    return tuple(sorted(families[f].name for f in key if families[f].effect is not None))


def _without(name: Name, problem: Linearisation, search: Search) -> float:
    """Best log weight of the sets that lack a name, and what may stand for it in the background."""
    families = problem.pool.families
    rivals = {problem.index[name]}
    rivals |= {i for i, f in enumerate(families) if f.background and f.name.joint in (0, name.joint)}
    return max((s.log for key, s in search.sets.items() if not key & rivals), default=0.0)


def told_apart(parameters: int) -> float:
    """Lambda below which a signature is not told from zero."""
    return rules.TOLD_APART[min(parameters, 3) - 1] + rules.TOLD_APART_MORE * max(parameters - 3, 0)


def twins(problem: Linearisation, weighed: Weighed, member: Member, signature: Array) -> list[Name]:
    """Names that these data cannot tell from a member of a set with this signature (N,), the others of the set being free."""
    families = problem.pool.families
    inside = {m.family for m in weighed.members}
    # Background stays as small as it was found: at an effect's size it would take the effect's place.
    sizes = {m.family: m.size if families[m.family].background else 1.0 for m in weighed.members}
    there = given(problem.pool, [Member(m.family, m.variant, sizes[m.family]) for m in weighed.members if m != member])
    d = there.after(signature)
    return [f.name for i, f in enumerate(families) if f.effect is not None and i not in inside and _imitates(there, d, i)]


def _imitates(there: Given, d: Array, family: int) -> bool:
    """Whether a family, at its prior's upper end, takes so much of a signature (N,) beside what is given that what it leaves is
    not told from zero."""
    g, rows = there.pool.of(family)
    G, b = g.G[rows], np.einsum("nvi,n->vi", g.X[:, rows], there.after(d))
    if there.members:
        G = G - squares((there.turn @ there.pool.products(there, family)).reshape(-1, *b.shape))
    x = np.linalg.solve(G + np.eye(g.m), b[..., None])[..., 0]
    each, own, size = np.einsum("vi,vi->v", b, x), there.pool.families[family], float(d @ d)
    if own.effect is not None and own.effect.doubt is not None:  # what cannot be so large is no other name for it
        sure = [own.effect.doubt(a * own.scale, np.zeros(g.m), s) for a, s in zip(x, own.scans, strict=True)]
        each = np.where([bool(why) for why in sure], 0.0, each)
    taken = float(each.max())
    return bool(taken > rules.IMITATED * size and size - taken < told_apart(len(own.scale)))


def merged(classes: Iterable[tuple[Name, ...]]) -> tuple[tuple[Name, ...], ...]:
    """Classes that share a name as one."""
    found: list[set[Name]] = []
    for names in classes:
        new = set(names)
        for other in [c for c in found if c & new]:
            new |= other
            found.remove(other)
        if len(new) > 1:
            found.append(new)
    return tuple(tuple(sorted(c)) for c in found)


def classes_of(problem: Linearisation, weighed: Weighed, active: Sequence[Active]) -> tuple[tuple[Name, ...], ...]:
    """Classes of these effects of a set and what cannot be told from them."""
    names = [(Name(*one.key), problem.signature(weighed, one)) for one in active]
    return merged((name, *twins(problem, weighed, problem.member(weighed, name), d)) for name, d in names)


def suspected(problem: Linearisation, search: Search, ranked: Sequence[Ranked]) -> tuple[tuple[Name, ...], ...]:
    """Class of the first name of the ranking, where nothing is accepted: too weak to be sure of, it may still be measured again,
    and that under any name of its class. Without it force world 9 of seed 7 (wheel_frame_shift, lambda 280, "ambiguous") tells no
    class that holds the name."""
    if not ranked or ranked[0].detectability < told_apart(ranked[0].active.effect.size):
        return ()
    return classes_of(problem, problem.best_with(search.sets, ranked[0].name), [ranked[0].active])


def alternatives(
    problem: Linearisation, search: Search, found: Posterior, chosen: tuple[Weighed, Names], active: tuple[Active, ...]
) -> tuple[Alternative, ...]:
    """Sets of effects with probabilities that sum to one, the accepted one first; chosen: its set and names, active: the effects
    with their values."""
    weighed, names = chosen
    signatures = [problem.signature(weighed, one) for one in active]
    if not active:
        return (Alternative(1.0, ()),)
    listed = _variants(problem, weighed, active, found.probability.get(names, 0.0))
    others = sorted(found.probability.items(), key=lambda item: -item[1])[: rules.MOST_FOLLOWED + 1]
    for other, p in [((), found.p_none), *others]:
        if other == names or (other and p < rules.FOLLOWED):
            continue
        sets = {k: s for k, s in search.sets.items() if _names_in(problem, k) == other}
        strange = {k: s for k, s in sets.items() if search.kernel[list(k)].any()}
        unknown = found.beside.get(other, 0.0)
        patches = _patches_beside(problem, search, strange, unknown) if unknown >= rules.FOLLOWED else ()
        kept = sets.keys() - strange.keys() if patches else sets
        plain = max((sets[k] for k in kept), key=lambda s: s.log, default=NOTHING)
        here = [(Alternative(p - (unknown if patches else 0.0), ()), plain)]
        here += [(one, max(strange.values(), key=lambda s: s.log)) for one in patches]
        for one, best in here:
            there = (*problem.values(best), *_nameless(problem, best, active, signatures), *unfaded(one.active))
            listed.append(replace(one, active=there))
    return _summed(listed)


def _patches_beside(problem: Linearisation, search: Search, strange: dict[Key, Weighed], whole: float) -> tuple[Alternative, ...]:
    """Patches of the kernels in these sets, which hold the same names, with probabilities that sum to `whole`; none: no patch can
    hold what does."""
    alone = copy(search)
    alone.sets = strange
    return summing_to(whole, patches_of(problem, alone, posterior(problem, alone).where))


def without_kernels(problem: Linearisation, search: Search) -> tuple[Alternative, ...]:
    """What names say where no kernel is in, the likeliest sets of them, with probabilities that sum to one."""
    plain = copy(search)
    plain.sets = {k: s for k, s in search.sets.items() if not search.kernel[list(k)].any()}
    found = posterior(problem, plain)
    likeliest = sorted(found.probability.items(), key=lambda item: -item[1])[: rules.MOST_FOLLOWED]
    listed = [Alternative(found.p_none, ()), *(Alternative(p, problem.values(found.best[names])) for names, p in likeliest)]
    listed.sort(key=lambda a: -a.probability)
    return summing_to(1.0, [a for k, a in enumerate(listed) if k == 0 or a.probability >= rules.FOLLOWED])


def _nameless(problem: Linearisation, other: Weighed, active: Sequence[Active], signatures: Sequence[Array]) -> list[Active]:
    """Accepted effects, with these signatures (N,), that another set has in its background."""
    names = {problem.pool.families[m.family].name for m in problem.named(other)}
    there = given(problem.pool, [m for m in other.members if problem.pool.families[m.family].background])
    left = [float(np.sum(there.after(d) ** 2)) for d in signatures]
    taken = [rest < (1.0 - rules.IMITATED) * float(d @ d) for rest, d in zip(left, signatures, strict=True)]
    return [a for a, yes in zip(active, taken, strict=True) if yes and Name(*a.key) not in names]


def _variants(problem: Linearisation, weighed: Weighed, active: tuple[Active, ...], whole: float) -> list[Alternative]:
    """The accepted set, its probability shared among the words that its effects may act on, payloads, nests, other joints, and
    among rates of a train of knocks."""
    shares: list[tuple[float, tuple[Active, ...]]] = [(1.0, active)]
    for place, own in enumerate(active):
        listed = [(1.0, own)]
        if _words(own.scanned):
            listed = _by_words(problem, weighed, own)
        elif own.falls_out_of_step:
            listed = [(1.0 / 3.0, one) for one in _by_rate(problem, own)]
        shares = [(s * p, (*a[:place], one, *a[place + 1 :])) for s, a in shares for p, one in listed]
    return [Alternative(whole * s, a) for s, a in shares]


def _by_rate(problem: Linearisation, one: Active) -> Iterator[Active]:
    """A train on the campaign's clock at its rate and one to either side, as far off as the readings leave open, the knocks in
    their middle where they are: long after them nobody knows whether the train still is in step."""
    c, s = next(c.conditions for c in problem.channels if c.name == "force"), one.scanned
    assert c.clock is not None and c.contact is not None
    clock = c.clock[c.contact > 0]
    off = s["length"] * np.sqrt(3.0 * one.covariance[0, 0]) / max(abs(one.a[0]) * float(clock.std()), 1e-12)
    for hz in (0.0, -off, off):
        yield replace(one, scanned={**s, "hz": s["hz"] + hz, "turn": (s["turn"] + hz * float(clock.mean())) % 1.0})


def _by_words(problem: Linearisation, weighed: Weighed, one: Active) -> list[tuple[float, Active]]:
    """Probability of every choice of words of an effect, the rest of its set held, and the effect at its best with them."""
    member, others, per = problem.variants(weighed, Name(*one.key))
    groups: dict[tuple[tuple[str, str], ...], list[int]] = {}
    for v, scanned in enumerate(problem.pool.families[member.family].scans):
        groups.setdefault(_words(scanned), []).append(v)
    own = _words(one.scanned)
    weight = np.array([np.exp(np.logaddexp.reduce(per[rows]) - per.max()) for rows in groups.values()])
    listed = []
    for words, rows, p in zip(groups, groups.values(), weight / weight.sum(), strict=True):
        if words == own:
            listed.append((float(p), one))
        elif p >= rules.FOLLOWED:
            best = Member(member.family, rows[int(np.argmax(per[rows]))], 1.0)
            values = problem.values(Weighed(0.0, (*others, best)))
            listed.append((float(p), next(a for a in values if a.effect is one.effect and a.joint == one.joint)))
    return listed


def _words(scanned: Scanned) -> tuple[tuple[str, str], ...]:
    """What of scanned values is a name, not a number."""
    return tuple(sorted((k, v) for k, v in scanned.items() if isinstance(v, str)))


def gathered(listed: Sequence[Alternative], least: float) -> list[Alternative]:
    """Alternatives by probability; patches of less than `least` are one with the likeliest patch: all show what the readings do,
    and many that are each too unlikely to be followed are together not."""
    ordered = sorted(listed, key=lambda a: -a.probability)
    patched = [a for a in ordered if any(is_patch(one.effect) for one in a.active)]
    small = [a for a in patched[1:] if a.probability < least]
    kept = [a for a in ordered if not any(a is one for one in small)]
    more = sum(a.probability for a in small)
    kept = [replace(a, probability=a.probability + more) if patched and a is patched[0] else a for a in kept]
    return sorted(kept, key=lambda a: -a.probability)


def _summed(listed: Sequence[Alternative]) -> tuple[Alternative, ...]:
    """The first, then the most probable others, probabilities summing to one; no effect at all as one alternative."""
    first, rest = listed[0], gathered([a for a in listed[1:] if a.active], rules.FOLLOWED)[: rules.MOST_FOLLOWED]
    nothing = Alternative(sum(a.probability for a in listed if not a.active), ())
    return summing_to(1.0, [a for a in (first, *rest, nothing) if a is first or a.probability >= rules.FOLLOWED])
