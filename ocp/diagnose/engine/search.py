"""The search: accept, refit, linearise anew, until the best explanation stands.

One-shot screening names spurious companions of strong effects (their second order, and a noise level that still holds them),
so one effect at most is accepted between two refits, and what was accepted may be dropped or exchanged at every later one.

Fits that diverge are taken out (`Diverged`): where something is missing that nobody names, columns of an effect that changes
stiffness or contact reach for it, and the fit runs off to values at which wheel and blade hold no balance.

Scanned values (levers, rests, instants) are made sharper between those that were scanned: a grid of 40 instants or a few
levers leaves a residue of a strong effect that other names would explain. A pattern search (Hooke and Jeeves 1961) on the
evidence of the set, halving its steps, one effect and key at a time (`refined`); once more at the noise that they leave
(`_sharpened`): a balancer between the levers scanned (lambda 851) has the joint's second harmonic beside it without that.

What nobody counts needs no effect: a nest that moves before the last few readings is taken for so many gross readings; so is
a small step once the noise has fallen with the names accepted before it. So where several readings are set aside, all are
counted once more, what then explains them best is fitted beside what was accepted, and the fit decides
(`outliers_rechecked`): readings with one cause in common are rather that than each of them one of the two in a hundred that
are grossly wrong. Without it other_hand_11 (springs that stiffen, lambda 3458) has no name (docs/diagnosis.md, Measured).
"""

from collections import Counter
from collections.abc import Callable, Iterable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace

import numpy as np

from ocp.diagnose import rules
from ocp.diagnose.engine.beam import NOTHING, Key, Search, Weighed, weigh
from ocp.diagnose.engine.channel_system import Channel, WeighedReadings, is_outlier
from ocp.diagnose.engine.evidence import log_evidence
from ocp.diagnose.engine.findings import Name, Options
from ocp.diagnose.engine.linearisation import Linearisation, linearised, movable, spacing, stacked_columns
from ocp.diagnose.engine.pool import Given, Member, given, squares
from ocp.diagnose.engine.selection import misses_far_more_than_noise
from ocp.effects.effect import Active, Effect, Scanned, effects_key
from robots.errors import Infeasible
from robots.pose import Array, Mask


@dataclass
class Diverged:
    """Sets of names whose fit diverged, how often each name was new in one, names that were in a fit that converged, how many
    fits diverged since, and those of which channels."""

    sets: set[frozenset[Name]] = field(default_factory=set)
    count: Counter[Name] = field(default_factory=Counter)
    fitted: set[Name] = field(default_factory=set)
    since: int = 0
    channels: set[str] = field(default_factory=set)

    def add(self, names: Iterable[Name], channel: str = "") -> None:
        """A set whose fit to a channel diverged."""
        found = frozenset(names)
        if found:  # without effects a channel is the one that was fitted
            self.sets.add(found)
            self.count.update(found - self.fitted)
            self.since += 1
            self.channels.add(channel)

    def converged(self, names: Iterable[Name]) -> None:
        """A set whose fit converged: what holds its names may fail for others' sake."""
        found = frozenset(names)
        self.sets.discard(found)
        self.fitted |= found
        self.since = 0
        self.channels.clear()

    @property
    def hopeless(self) -> bool:
        """Whether so many fits diverged one after another that it is the believed contact, and no name, that fits nothing."""
        return self.since >= rules.HOPELESS_FITS

    def names(self) -> list[Name]:
        """Names that are given up."""
        least = 1 if self.hopeless else rules.FAILED_FITS
        return sorted(n for n, k in self.count.items() if k >= least and n not in self.fitted)

    def strike(self, search: Search, problem: Linearisation) -> None:
        """Take the sets out of a search whose fit diverged, or that hold a name that is given up."""
        index = problem.index
        gone = {index[n] for n in self.names() if n in index}
        failed = [{index[n] for n in names} for names in self.sets if all(n in index for n in names)]
        kernel = search.kernel | search.background
        stays = {index[n] for n in self.fitted if n in index} if self.hopeless else set(index.values())
        for key in list(search.sets):
            names = {f for f in key if not kernel[f]}
            if gone & key or names in failed or not names <= stays:
                del search.sets[key]

    def grown_whole(self, search: Search, problem: Linearisation) -> bool:
        """Grow a search whole, sets whose fit diverged left out; False: it is no longer rough."""
        search.grow()
        self.strike(search, problem)
        return False

    def fitted_with(self, active: tuple[Active, ...], search: Search, problem: Linearisation) -> list[Channel] | None:
        """The channels fitted with effects; None where a fit diverges: such sets are taken out of the search."""
        found = []
        for channel in problem.channels:
            try:
                found.append(channel.with_active(active))
            except Infeasible:
                self.add((Name(*a.key) for a in active), channel.name)
                self.strike(search, problem)
                return None
        return found


def search_and_refit(
    first: Linearisation,
    library: Mapping[str, Effect],
    options: Options,
    diverged: Diverged | None = None,
    in_vain: Callable[[Linearisation, Search], bool] | None = None,
) -> tuple[Linearisation, Search]:
    """The last linearisation and its sets: accept, refit and linearise anew until the best set is what is active, or until, with
    `rules.SEARCHED_IN_VAIN` names accepted, a rough search is `in_vain`. diverged: fits that did so far, added to."""
    problem, diverged = first, Diverged() if diverged is None else diverged
    seeds: list[tuple[Name, ...]] = []
    tried: set[tuple[object, ...]] = set()
    been: dict[tuple[object, ...], Sequence[Channel]] = {}
    freeing, flattered = True, None
    while True:
        search = Search(problem.pool, options.most, options.beam)
        index = problem.index
        search.begin([frozenset(index[n] for n in names if n in index) for names in seeds], pairs=problem is first)
        rough = _grown(problem, search)
        held = _all_active(problem.channels)
        diverged.converged(Name(*a.key) for a in held)
        diverged.strike(search, problem)
        if flattered is not None:
            rough = diverged.grown_whole(search, problem)  # what is put right is whole
            flattered.put_right(search, problem)
            flattered = None
        if rough and in_vain is not None and len(held) >= rules.SEARCHED_IN_VAIN and in_vain(problem, search):
            rough = diverged.grown_whole(search, problem)
            if in_vain(problem, search):
                return problem, search
        channels: Sequence[Channel] | None = None
        while channels is None:
            best = next_set(search, len(held) + 1)
            chosen = refined(problem, best, problem.values(best))
            key = effects_key(chosen, 2)
            if key in tried | {effects_key(held, 2)}:
                channels = outliers_rechecked(problem, held, library, options) if freeing else None
                if channels is None and rough:
                    rough = diverged.grown_whole(search, problem)
                    continue
                if channels is None:
                    (channels, flattered), been[key] = rather(been.get(key, ()), problem, search, library, options), ()
                    if channels:
                        break
                    if flattered is None:
                        return problem, search
                    flattered.put_right(search, problem)
                    channels = flattered = None
                    continue
                key = effects_key(_all_active(channels), 2)
                freeing = key not in tried  # a set that was tried is not tried for ever
                tried.add(key)
                break
            tried.add(key)
            channels = diverged.fitted_with(chosen, search, problem)
        seeds = [problem.names(k) for k in search.best()]
        problem = linearised(channels, library, options)
        if sharper := _sharpened(problem):
            problem = linearised(sharper, library, options)
        been.setdefault(key, problem.channels)  # not twice: a circle ends


@dataclass(frozen=True)
class Flattered:
    """Names in the place of others (none: beside them), and by how much (log) columns about a fit rate them better than columns
    about that fit and about their own do on average."""

    names: set[Name]
    others: set[Name]
    log: float

    def put_right(self, search: Search, problem: Linearisation) -> None:
        """Weigh the sets of a search that have the names and not the others as the average does."""
        names, others = ({problem.index[n] for n in part} for part in (self.names, self.others))
        for key, one in search.sets.items():
            if names <= key and not others & key:
                search.sets[key] = replace(one, log=one.log - self.log)


def rather(
    earlier: Sequence[Channel], problem: Linearisation, search: Search, library: Mapping[str, Effect], options: Options
) -> tuple[Sequence[Channel], Flattered | None]:
    """Of a circle of two fits the better one by the mean of what columns about either say: the channels of the earlier one, or
    none where what is held now is better; and what columns about the better one flatter. Columns about one fit may not hold about
    another: where a run-out moves the flange its friction makes the run-out's pattern, and seems to explain it. Where a line of
    the background has a part in either, fits do not hold all of it, and what was said last stands."""
    now, then = ({Name(*a.key) for a in _all_active(one)} for one in (problem.channels, earlier))
    if not earlier or now == then or any(_with_background(search, problem, names) for names in (now, then)):
        return (), None
    there = linearised(earlier, library, options)
    if not now | then <= {*there.index} & {*problem.index}:
        return (), None
    here, gain = (_weighed(about, then).log - _weighed(about, now).log for about in (problem, there))
    better, worse, kept = (then, now, earlier) if here + gain > 0 else (now, then, ())
    return kept, Flattered(worse - better or worse, better - worse, 0.5 * (here - gain)) if worse else None


def _with_background(search: Search, problem: Linearisation, names: set[Name]) -> bool:
    """Whether the best set with these names has a line of the background, or none has them."""
    families = {problem.index[n] for n in names if n in problem.index}
    own = [k for k in search.sets if {f for f in k if not search.background[f]} == families]
    return not own or bool(search.background[list(_best(search, own))].any())


def _weighed(problem: Linearisation, names: Iterable[Name]) -> Weighed:
    """A set by its names."""
    return weigh(problem.pool, sorted(problem.index[n] for n in names))


def _grown(problem: Linearisation, search: Search) -> bool:
    """Grow a search; whether by the best sets alone: as long as the arm misses far more than noise the next name is all that is
    asked of it. What sets weigh is looked at in the last one, which then grows whole."""
    if misses_far_more_than_noise(problem, search):
        search.grow(leaders=True)
        if misses_far_more_than_noise(problem, search):
            return True
    search.grow()
    return False


def next_set(search: Search, limit: int) -> Weighed:
    """The best set of at most `limit` names, or the best of all where none so small beats having none.

    A name that is nearly as good as a kernel is taken first: once it is fitted the noise level no longer holds it, and both
    compete again. Beside a kernel, too, at most `limit` names are taken at once.
    """
    names = {k: np.count_nonzero(~search.kernel[list(k)] & ~search.background[list(k)]) for k in search.sets}
    known = [k for k in search.sets if not search.kernel[list(k)].any()]
    best = _best(search, [k for k in known if names[k] <= limit])
    if not names[best]:
        best = _best(search, known)
    overall = _best(search, [k for k in search.sets if names[k] <= limit])
    nearly = search.sets[_best(search, known)].log > search.sets[overall].log - rules.KERNEL_BENEFIT
    return search.sets[best if nearly else overall]


def _best(search: Search, keys: Iterable[Key]) -> Key:
    return max(keys, key=lambda k: search.sets[k].log)


def _all_active(channels: Sequence[Channel]) -> tuple[Active, ...]:
    """Effects active in any channel, once each."""
    return tuple({a.key: a for c in channels for a in c.active}.values())


def _sharpened(problem: Linearisation) -> list[Channel]:
    """The channels with what they hold sharper, where it is so at the noise that it leaves; else none. At the noise that still
    held it all scanned values looked alike, and what the wrong ones miss of it another name would get."""
    held = _all_active(problem.channels)
    names = [Name(*a.key) for a in held]
    if names and {*names} <= {*problem.index}:
        there = _weighed(problem, names)
        chosen = refined(problem, there, problem.values(there))
        if effects_key(chosen) != effects_key(held):
            with suppress(Infeasible):
                return [c.with_active(chosen) for c in problem.channels]
    return []


HALVINGS = 4


def refined(problem: Linearisation, weighed: Weighed, active: Sequence[Active]) -> tuple[Active, ...]:
    """The active effects of a set with scanned numbers moved to where the evidence is highest."""
    return tuple(_sharper(problem, weighed, one) for one in active)


def _sharper(problem: Linearisation, weighed: Weighed, one: Active) -> Active:
    family = next(f for n, f in problem.index.items() if (n.effect, n.joint) == one.key)
    keys = movable(problem.pool.families[family])
    if not keys:
        return one
    others = given(problem.pool, [Member(m.family, m.variant, 1.0) for m in weighed.members if m.family != family])
    scans = problem.pool.families[family].scans
    steps = {k: spacing([s[k] for s in scans]) for k in keys}
    # Physics has no place below: a curvature or a time of nothing divides by zero.
    unsigned = [p for p in one.effect.parameters if not p.signed and p.low > 0]
    low = {p.key: min([p.low, *(s[p.key] for s in scans if p.key in s)]) for p in unsigned}
    best, here = dict(one.scanned), one
    level, _ = _evidence(problem, others, one.effect, one.joint, [best])
    for _ in range(HALVINGS):
        moves = [best | {k: max(best[k] + s * steps[k], low.get(k, -np.inf))} for k in keys if steps[k] > 0 for s in (-1.0, 1.0)]
        if not moves:
            break
        values, means = _evidence(problem, others, one.effect, one.joint, moves)
        k = int(np.argmax(values))
        if values[k] > level[0] + rules.SHARPER_GAIN:
            best, level = moves[k], values[k : k + 1]
            here = Active(one.effect, one.joint, means[k], best, one.covariance)
        else:
            steps = {key: 0.5 * step for key, step in steps.items()}
    return here


def _evidence(problem: Linearisation, others: Given, effect: Effect, joint: int, scans: Sequence[Scanned]) -> tuple[Array, Array]:
    """Log evidence (V,) at the prior's upper end and coefficients (V, m) of variants over the rest of the set."""
    columns, _ = stacked_columns(problem.channels, effect, joint, scans)
    n, V, m = columns.shape
    scale = np.asarray(effect.prior_sd, float)
    X = others.after(problem.stack.apply((columns * scale).reshape(n, V * m))).reshape(n, V, m)
    G, b = squares(X), np.einsum("nvi,n->vi", X, others.after(problem.pool.y))
    log = log_evidence(G, b, np.ones((V, 1)), np.zeros((V, m), bool), others.left, problem.pool.freedom)[:, 0]
    means = np.linalg.solve(G + np.eye(m), b[..., None])[..., 0] * scale
    return log, means


def outliers_rechecked(
    problem: Linearisation, held: tuple[Active, ...], library: Mapping[str, Effect], options: Options
) -> list[Channel] | None:
    """The channels fitted with one effect more than is held, where that takes gross readings back; else None."""
    if _count(problem.channels) < rules.OUTLIERS_OF_ONE_CAUSE:
        return None
    whole = linearised([c.opened() if isinstance(c, WeighedReadings) else c for c in problem.channels], library, options)
    search = Search(whole.pool, options.most, options.beam)
    names = {a.key for a in held}
    key = [i for n, i in whole.index.items() if (n.effect, n.joint) in names]
    value = search.scan(weigh(whole.pool, key) if key else NOTHING).log + search.odds
    value[[*key, *np.flatnonzero(search.kernel | search.background)]] = -np.inf
    for f in np.argsort(-value)[: rules.RECHECKED]:
        if value[f] <= 0:
            break
        with suppress(Infeasible):
            found = [c.with_active(whole.values(weigh(whole.pool, [*key, int(f)]))) for c in problem.channels]
            if _count(problem.channels) - _count(found) >= rules.OUTLIERS_OF_ONE_CAUSE:
                return found
    return None


def outliers(channel: Channel) -> Mask:
    """Readings (n,) of a channel that are set aside as gross; none where its fit weighs no single readings, or where most are so
    far off: then the fit is."""
    n = len(channel.gap())
    weight = getattr(getattr(channel, "fit", None), "weight", None)
    if weight is None or np.shape(weight) != (n,):
        return np.zeros(n, bool)
    return is_outlier(weight) & ~is_outlier(np.median(weight))


def _count(channels: Sequence[Channel]) -> int:
    return sum(int(np.count_nonzero(outliers(c))) for c in channels if isinstance(c, WeighedReadings))
