"""Names with which the model comes to no rest: nothing is explained by them, and little time is lost on them.

Where something is missing that nobody names, columns of an effect that changes stiffness or contact reach for it, and the fit
runs off to values at which wheel and blade hold no balance. Such a fit is dear. A set of names is fitted in vain once, a name
that no fit ever held twice; then sets with it are struck out, in every later round too.
"""

from collections import Counter
from collections.abc import Iterable
from dataclasses import dataclass, field

from ocp.diagnose.engine.beam import Search
from ocp.diagnose.engine.findings import Name
from ocp.diagnose.engine.problem import Problem
from ocp.diagnose.rules import FAILED_FITS


@dataclass
class NoRest:
    """Sets of names that were fitted in vain, how often each name was new in one, and names that were in a fit that rests."""

    sets: set[frozenset[Name]] = field(default_factory=set)
    count: Counter[Name] = field(default_factory=Counter)
    fitted: set[Name] = field(default_factory=set)

    def add(self, names: Iterable[Name]) -> None:
        """A set that was fitted in vain."""
        found = frozenset(names)
        if found:  # without effects a channel is the one that was fitted
            self.sets.add(found)
            self.count.update(found - self.fitted)

    def rests(self, names: Iterable[Name]) -> None:
        """A set whose fit comes to rest: what holds its names may fail for others' sake."""
        found = frozenset(names)
        self.sets.discard(found)
        self.fitted |= found

    def names(self) -> list[Name]:
        """Names that are given up."""
        return sorted(n for n, k in self.count.items() if k >= FAILED_FITS and n not in self.fitted)

    def strike(self, search: Search, problem: Problem) -> None:
        """Take the sets out of a search that were fitted in vain, or hold a name that is given up."""
        index = problem.index
        gone = {index[n] for n in self.names() if n in index}
        vain = [{index[n] for n in names} for names in self.sets if all(n in index for n in names)]
        kernel = search.kernel | search.background
        for key in list(search.seen):
            if gone & key or {f for f in key if not kernel[f]} in vain:
                del search.seen[key]
