"""Effects that the data at hand cannot tell apart.

Effect e with signature d (projected, at its value) and another effect f whose columns C imitate it: what f leaves of it is
lambda (1 - R^2) = |d|^2 - d^T C (C^T C + 1 / prior^2)^-1 C^T d. Below 10.5, 12.7, 14.2 for 1, 2, 3 parameters no test at this
size tells them apart (power 0.9 at one in twenty), and both names stand for one class. The prior keeps an effect from
imitating another with values it never takes.
"""

from collections.abc import Iterable, Mapping

import numpy as np

from ocp.diagnose.engine.beam import Key, Weighed
from ocp.diagnose.engine.findings import Name
from ocp.diagnose.engine.pool import CandidatePool, Member, given
from ocp.diagnose.engine.problem import Linearisation
from ocp.diagnose.rules import IMITATED, MISTAKEN_WITHIN, TOLD_APART, TOLD_APART_MORE
from robots.pose import Array


def told_apart(parameters: int) -> float:
    """Lambda below which a signature is not told from zero."""
    return TOLD_APART[min(parameters, 3) - 1] + TOLD_APART_MORE * max(parameters - 3, 0)


def imitated(pool: CandidatePool, signature: Array, family: int) -> tuple[float, int]:
    """The most of a signature's lambda (N,) that a family takes at its prior's upper end, and by which variant."""
    group, start = pool.place[family]
    g = pool.groups[group]
    rows = slice(start, start + pool.families[family].columns.shape[1])
    b = np.einsum("nvi,n->vi", g.X[:, rows], signature)
    taken = np.einsum("vi,vi->v", b, np.linalg.solve(g.G[rows] + np.eye(g.m), b[..., None])[..., 0])
    best = int(np.argmax(taken))
    return float(taken[best]), best


def twins(problem: Linearisation, weighed: Weighed, member: Member, signature: Array, factor: float = 1.0) -> list[Name]:
    """Names that these data cannot tell from a member of a set with this signature (N,), the others of the set as they are;
    factor on the threshold."""
    inside = {m.family for m in weighed.members}
    names = [i for i, f in enumerate(problem.pool.families) if f.effect is not None and i not in inside]
    d = _beside(problem, weighed, member, signature)
    return [problem.pool.families[i].name for i in names if _imitates(problem.pool, d, i, factor)]


def mistaken(problem: Linearisation, seen: Mapping[Key, Weighed], weighed: Weighed, member: Member) -> list[Name]:
    """Names that put in the member's place explain the data nearly as well, and whose signature, were they what is there, the
    member's family would imitate: a ramp for a step, where a log has readings at its two ends."""
    pool, key = problem.pool, frozenset(m.family for m in weighed.members)
    found = []
    for other, its in seen.items():
        new = other - key
        if key - other != {member.family} or len(new) != 1 or its.log < weighed.log - MISTAKEN_WITHIN:
            continue
        one = next(m for m in its.members if m.family in new)
        family = pool.families[one.family]
        if family.effect is None:
            continue
        active = next(a for a in problem.values(its) if a.effect is family.effect and a.joint == family.name.joint)
        d = _beside(problem, its, one, pool.columns(one) @ (active.a / family.scale))
        if _imitates(pool, d, member.family):
            found.append(family.name)
    return found


def _beside(problem: Linearisation, weighed: Weighed, member: Member, signature: Array) -> Array:
    """A member's signature (N,) less what the others of its set would take of it."""
    families = problem.pool.families
    # Background stays as small as it was found: at an effect's size it would take the effect's place.
    sizes = {m.family: m.size if families[m.family].background else 1.0 for m in weighed.members}
    there = given(problem.pool, [Member(m.family, m.variant, sizes[m.family]) for m in weighed.members if m != member])
    return np.asarray(signature - there.U @ ((1.0 - np.sqrt(1.0 - there.take)) * (there.U.T @ signature)))


def _imitates(pool: CandidatePool, d: Array, family: int, factor: float = 1.0) -> bool:
    """Whether a family takes so much of a signature (N,) that what it leaves is not told from zero."""
    size, (taken, _) = float(d @ d), imitated(pool, d, family)
    return taken > IMITATED * size and size - taken < factor * told_apart(len(pool.families[family].scale))


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
