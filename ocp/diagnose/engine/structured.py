"""Arms whose believed model misses far more than noise: there names are earned on left-out conditions, not by evidence.

Evidence takes for white noise what a set of effects leaves. Where the scatter of the residual is many times what joints of such
robots usually show, that is not so: every gear has its ripples, and with a thousand readings whatever happens to follow them
nearby wins. Then the effects are those that hold in blocks and conditions that were left out (`ocp.diagnose.engine.earned`), and
the kernel that is needed beside them tells where the rest lies.
"""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Protocol, runtime_checkable

import numpy as np

from ocp.diagnose.engine.beam import NOTHING, Search
from ocp.diagnose.engine.earned import Earned, earned
from ocp.diagnose.engine.families import candidates, put_back
from ocp.diagnose.engine.findings import Name, Options
from ocp.diagnose.engine.problem import Problem, make_problem
from ocp.diagnose.engine.system import Channel
from ocp.diagnose.rules import KERNELS_BESIDE, SELECTED_FIRST
from ocp.effects.effect import Active, Effect


@runtime_checkable
class Restless(Protocol):
    """A channel that can tell whether its residual is far above noise."""

    def restless(self, scale: float) -> bool:
        """Whether `scale` times the noise that its residual asks for is many times the usual."""


@dataclass(frozen=True)
class Earning:
    """Linearisation about the names that were earned, their sets weighed, and what was refused with the fold that did."""

    problem: Problem
    search: Search
    refused: tuple[tuple[Name, str], ...]


def restless(problem: Problem, search: Search) -> bool:
    """Whether names must be earned: the only channel says that noise is far above the usual, even with all that the best set
    of names and kernels explains."""
    channels = problem.channels
    if len(channels) != 1 or not isinstance(channels[0], Restless):
        return False
    left = problem.taken(search.seen[search.best()[0]]).left
    return channels[0].restless(float(np.sqrt(left / problem.pool.freedom)))


def earn(channel: Channel, library: Mapping[str, Effect], options: Options) -> Earning:
    """Names of a channel fitted without effects, by held-out errors; refused ones are barred from the library.

    Twice: what is found first (springs, mostly) leaves the geometry, whose prior is as wide as what it had to follow, narrower.
    """
    first = earned(channel.system, candidates([channel], library, options), channel.folds(), most=SELECTED_FIRST)
    about = channel.with_active(_active(first, library))
    system = replace(about.system, residual=about.system.residual + put_back([about], about.active))
    found = earned(system, candidates([about], library, options), channel.folds())
    refused = tuple((r.name, r.fold) for r in found.refused)
    barred = replace(options, barred=(*options.barred, *(n for n, _ in refused)))
    active = _active(found, library)
    problem = make_problem([channel.with_active(active)], library, barred)
    search = Search(problem.pool, max(options.most, len(active)) + 1, options.beam)
    names = frozenset(problem.index[s.name] for s in found.steps)
    search.add(names)
    for family in names:  # what each is worth beside the others
        search.add(names - {family})
    there = search.seen.get(names, NOTHING)
    gain = np.where(search.kernel, search.scan(there).log + search.odds, -np.inf)
    for k in np.argsort(-gain)[:KERNELS_BESIDE]:
        if np.isfinite(gain[k]):
            search.add(names | {int(k)}, there.members)
            for family in names:
                search.add((names - {family}) | {int(k)}, there.members)
    return Earning(problem, search, refused)


def _active(found: Earned, library: Mapping[str, Effect]) -> tuple[Active, ...]:
    """What was earned, to begin a fit from."""
    return tuple(Active(library[s.name.effect], s.name.joint, s.a, s.scanned, np.eye(len(s.a))) for s in found.steps)
