"""Effects that the data at hand cannot tell apart.

Effect e with signature d (projected, at its value) and another effect f whose columns C imitate it: what f leaves of it is
lambda (1 - R^2) = |d|^2 - d^T C (C^T C + 1 / prior^2)^-1 C^T d. Below 10.5, 12.7, 14.2 for 1, 2, 3 parameters no test at this
size tells them apart (power 0.9 at one in a thousand), and both names stand for one class. The prior keeps an effect from
imitating another with values it never takes.
"""

from collections.abc import Iterable

import numpy as np

from ocp.diagnosis.beam import Weighed
from ocp.diagnosis.findings import Name
from ocp.diagnosis.pool import Member, Pool, given
from ocp.diagnosis.problem import Problem
from robots.pose import Array

TELLS = (10.5, 12.7, 14.2)  # lambda that is told apart, for 1, 2, 3 parameters
MORE = 1.3  # for each further one
SHARE = 0.5  # of the signature that an imitator takes at least: what is hardly there is imitated by anything


def threshold(parameters: int) -> float:
    """Lambda below which a signature is not told from zero."""
    return TELLS[min(parameters, 3) - 1] + MORE * max(parameters - 3, 0)


def imitated(pool: Pool, signature: Array, family: int) -> tuple[float, int]:
    """The most of a signature's lambda (N,) that a family takes at its prior's upper end, and by which variant."""
    group, start = pool.place[family]
    g = pool.groups[group]
    rows = slice(start, start + pool.families[family].columns.shape[1])
    b = np.einsum("nvi,n->vi", g.X[:, rows], signature)
    taken = np.einsum("vi,vi->v", b, np.linalg.solve(g.G[rows] + np.eye(g.m), b[..., None])[..., 0])
    best = int(np.argmax(taken))
    return float(taken[best]), best


def twins(problem: Problem, weighed: Weighed, member: Member, signature: Array) -> list[Name]:
    """Names that these data cannot tell from a member of a set with this signature (N,), the others of the set as they are."""
    pool = problem.pool
    # Background stays as small as it was found: at an effect's size it would take the effect's place.
    sizes = {m.family: m.size if pool.families[m.family].background else 1.0 for m in weighed.members}
    others = [Member(m.family, m.variant, sizes[m.family]) for m in weighed.members if m.family != member.family]
    there = given(pool, others)
    d = signature - there.U @ ((1.0 - np.sqrt(1.0 - there.take)) * (there.U.T @ signature))
    size = float(d @ d)
    inside = {m.family for m in weighed.members}
    found = []
    for i, family in enumerate(pool.families):
        if family.effect is None or i in inside:
            continue
        taken, _ = imitated(pool, d, i)
        if taken > SHARE * size and size - taken < threshold(len(family.scale)):
            found.append(family.name)
    return found


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
