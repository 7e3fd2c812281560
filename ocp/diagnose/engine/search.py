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

from collections import Counter, defaultdict
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
        return sorted(n for n, k in self.count.items() if (self.hopeless or k >= rules.FAILED_FITS) and n not in self.fitted)

    def strike(self, search: Search, problem: Linearisation) -> None:
        """Take the sets out of a search whose fit diverged, or that hold a name that is given up."""
        gone, strange = {*self.names()}, search.kernel | search.background
        for key in list(search.sets):
            names = frozenset(problem.pool.families[f].name for f in key if not strange[f])
            if gone & names or names in self.sets or (self.hopeless and not names <= self.fitted):
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
    problem, diverged, circles = first, Diverged() if diverged is None else diverged, Circles()
    seeds: list[tuple[Name, ...]] = []
    tried: set[tuple[object, ...]] = set()
    freeing = True
    while True:
        search = Search(problem.pool, options.most, options.beam)
        seeded = [frozenset(problem.index[n] for n in names if n in problem.index) for names in seeds]
        search.begin(seeded, pairs=problem is first)
        rough = _grown(problem, search)
        held = _all_active(problem.channels)
        diverged.converged(_names(problem.channels))
        diverged.strike(search, problem)
        if circles.flattered[_names(problem.channels)]:
            rough = diverged.grown_whole(search, problem)  # what is put right is whole
            circles.put_right(search, problem)
        if rough and in_vain is not None and len(held) >= rules.SEARCHED_IN_VAIN and in_vain(problem, search):
            rough = diverged.grown_whole(search, problem)
            if in_vain(problem, search):
                return problem, search
        channels: Sequence[Channel] | None = None
        while not channels:
            best = next_set(search, len(held) + 1)
            chosen = refined(problem, best, problem.values(best))
            key = effects_key(chosen, 2)
            if key not in tried | {effects_key(held, 2)}:
                tried.add(key)
                channels = diverged.fitted_with(chosen, search, problem)
            elif freeing and (channels := outliers_rechecked(problem, library, options)):
                key = effects_key(_all_active(channels), 2)
                freeing = key not in tried  # a set that was tried is not tried for ever
                tried.add(key)
            elif rough:
                rough = diverged.grown_whole(search, problem)
            else:
                channels = circles.settled(key, problem, search, library, options)
                if channels is None:
                    return problem, search
        seeds = [problem.names(k) for k in search.best()]
        problem = _sharpened(linearised(channels, library, options), library, options)
        circles.fits[key] = problem.channels


@dataclass(frozen=True)
class Flattered:
    """Names in the place of others (none: beside them), and by how much (log) columns about a fit rate them better than columns
    about that fit and about their own do on average."""

    names: frozenset[Name]
    others: frozenset[Name]
    log: float


@dataclass
class Circles:
    """Fits by the key of their effects, pairs of fits, by their names, that were compared, and what columns about the fit of some
    names flatter."""

    fits: dict[tuple[object, ...], Sequence[Channel]] = field(default_factory=dict)
    compared: set[frozenset[frozenset[Name]]] = field(default_factory=set)
    flattered: defaultdict[frozenset[Name], list[Flattered]] = field(default_factory=lambda: defaultdict(list))

    def put_right(self, search: Search, problem: Linearisation) -> None:
        """Weigh the sets of a search that its columns flatter as the average does, by what was found of most."""
        about = self.flattered[_names(problem.channels)]
        for key, names in [(k, {*problem.names(k)}) for k in search.sets]:
            if found := [f.log for f in about if f.names <= names and not f.others & names]:
                search.sets[key] = replace(search.sets[key], log=weigh(problem.pool, sorted(key)).log - max(found))

    def settled(
        self, key: tuple[object, ...], problem: Linearisation, search: Search, library: Mapping[str, Effect], options: Options
    ) -> Sequence[Channel] | None:
        """Where the search would go back to what was fitted: the channels of that fit where it is the better one, by the mean of
        what columns about either say; none where what is held now is, and what its columns flatter is put right; None where no
        more is to be learnt of the two, as where one has in its background what the other names. Columns about one fit may not
        hold about another: where a run-out moves the flange its friction makes the run-out's pattern, and seems to explain it;
        three stiffnesses at the ends of their ranges cancel each other to first order alone."""
        earlier = self.fits.get(key, ())
        now, then = _names(problem.channels), _names(earlier)
        pair = frozenset([now, then])
        if not earlier or now == then or pair in self.compared:
            return None
        self.compared.add(pair)
        there, known = linearised(earlier, library, options), {*problem.index}
        both = [_with_lines(search, problem, names) for names in (now, then)]
        first, second = both if all(both) else (now, then)
        twins = {Name(n.effect.lstrip("~"), n.joint) for n in (first | second) - now - then}
        if twins & (now ^ then) or not now | then | first | second <= known & {*there.index}:
            return None
        here, gain = (_weighed(about, second).log - _weighed(about, first).log for about in (problem, there))
        better, worse, kept = (then, now, earlier) if here + gain > 0 else (now, then, ())
        if worse:
            self.flattered[better].append(Flattered(worse - better or worse, better - worse, 0.5 * (here - gain)))
        self.put_right(search, problem)
        return kept


def _with_lines(search: Search, problem: Linearisation, names: frozenset[Name]) -> frozenset[Name]:
    """The names with the background lines of the best set of exactly these names; none where no set has them."""
    own = [k for k in search.sets if {*problem.names(frozenset(f for f in k if not search.background[f]))} == names]
    return frozenset(problem.names(_best(search, own))) if own else frozenset()


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


def _names(channels: Sequence[Channel]) -> frozenset[Name]:
    """Names active in any channel."""
    return frozenset(Name(*a.key) for a in _all_active(channels))


def _sharpened(problem: Linearisation, library: Mapping[str, Effect], options: Options) -> Linearisation:
    """The problem about what it holds sharper, where it is so at the noise that it leaves. At the noise that still held it all
    scanned values looked alike, and what the wrong ones miss of it another name would get."""
    names = _names(problem.channels)
    if names and names <= {*problem.index}:
        there = _weighed(problem, names)
        chosen = refined(problem, there, problem.values(there))
        if effects_key(chosen) != effects_key(_all_active(problem.channels)):
            with suppress(Infeasible):
                return linearised([c.with_active(chosen) for c in problem.channels], library, options)
    return problem


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


def outliers_rechecked(problem: Linearisation, library: Mapping[str, Effect], options: Options) -> list[Channel] | None:
    """The channels fitted with one effect more than is held, where that takes gross readings back; else None."""
    if _count(problem.channels) < rules.OUTLIERS_OF_ONE_CAUSE:
        return None
    whole = linearised([c.opened() if isinstance(c, WeighedReadings) else c for c in problem.channels], library, options)
    search = Search(whole.pool, options.most, options.beam)
    key = sorted(whole.index[n] for n in _names(problem.channels) if n in whole.index)
    value = search.scan(weigh(whole.pool, key) if key else NOTHING).log + search.odds
    value[[*key, *np.flatnonzero(search.kernel | search.background)]] = -np.inf
    likely = np.argsort(-value)[: rules.RECHECKED]
    for f in likely[value[likely] > 0]:
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
