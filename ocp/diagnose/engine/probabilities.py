"""From weighed sets to probabilities of explanations, of 'none' and of 'none of these'."""

from dataclasses import dataclass

import numpy as np

from ocp.diagnose.engine.beam import Key, Search
from ocp.diagnose.engine.findings import Name
from ocp.diagnose.engine.problem import Linearisation
from ocp.diagnose.rules import NAME_BESIDE_UNKNOWN, SURE_BESIDE_UNKNOWN

Names = tuple[Name, ...]


@dataclass(frozen=True)
class Posterior:
    """Probability and log weight (best of its sets) by explanation (names from the library); p_none; p_unknown: sets that need a
    kernel; where: kernels' shares of p_unknown by name; marginal by name (beside a kernel only half, unless sure); gain: best
    log weight with a name less best without it and without what stands for it in the background; best: the key of the best set
    of every explanation."""

    probability: dict[Names, float]
    log: dict[Names, float]
    p_none: float
    p_unknown: float
    where: dict[Name, float]
    marginal: dict[Name, float]
    gain: dict[Name, float]
    best: dict[Names, Key]


def posterior(problem: Linearisation, search: Search) -> Posterior:
    """Background lines are summed over: they explain without being named."""
    keys = list(search.sets)
    log = np.array([search.sets[k].log for k in keys])
    share = np.exp(log - log.max())
    share /= share.sum()
    families = problem.pool.families
    probability: dict[Names, float] = {}
    best: dict[Names, Key] = {}
    weight: dict[Names, float] = {}
    where: dict[Name, float] = {}
    marginal: dict[Name, float] = {}
    p_none = p_unknown = 0.0
    with_name: dict[Name, float] = {}
    strange_share: dict[Name, float] = {}
    for key, p, w in zip(keys, share, log, strict=True):
        named = tuple(sorted(families[f].name for f in key if families[f].effect is not None))
        strange = [families[f].name for f in key if families[f].effect is None and not families[f].background]
        for name in named:
            beside = strange_share if strange else marginal
            beside[name] = beside.get(name, 0.0) + float(p)
            with_name[name] = max(with_name.get(name, -np.inf), float(w))
        if strange:
            p_unknown += float(p)
            where[strange[0]] = where.get(strange[0], 0.0) + float(p)
        elif not named:
            p_none += float(p)
        else:
            probability[named] = probability.get(named, 0.0) + float(p)
            if named not in best or w > weight[named]:
                best[named], weight[named] = key, float(w)
    gain = {name: w - max(_without(name, problem, search), 0.0) for name, w in with_name.items()}
    for name, p in strange_share.items():
        marginal[name] = marginal.get(name, 0.0) + p * (1.0 if gain[name] > SURE_BESIDE_UNKNOWN else NAME_BESIDE_UNKNOWN)
    return Posterior(probability, weight, p_none, p_unknown, where, marginal, gain, best)


def _without(name: Name, problem: Linearisation, search: Search) -> float:
    """Best log weight of the sets that lack a name, and what may stand for it in the background."""
    families = problem.pool.families
    rivals = {problem.index[name]}
    rivals |= {i for i, f in enumerate(families) if f.background and f.name.joint in (0, name.joint)}
    return max((s.log for key, s in search.sets.items() if not key & rivals), default=0.0)
