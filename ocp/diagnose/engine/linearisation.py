"""One linearisation of all channels: library and kernels projected together, with their priors; sets back to effects."""

from collections import Counter
from collections.abc import Mapping, Sequence, Set
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Protocol, runtime_checkable

import numpy as np

from ocp.diagnose import rules
from ocp.diagnose.engine.beam import Key, Weighed
from ocp.diagnose.engine.channel_system import Channel, ReadingRows
from ocp.diagnose.engine.evidence import RANK, SIZES, Rival, Stack, size_grid, stack, visible_lambda
from ocp.diagnose.engine.findings import Name, Options
from ocp.diagnose.engine.kernels import Kernel, kernels
from ocp.diagnose.engine.pool import CandidatePool, Family, Given, Member, given, make_pool, most_telling, scan_one
from ocp.effects.effect import Active, Effect, Scanned, deviations_among, scan_key
from ocp.effects.forms import odds_of_instants
from robots.gauss_newton import linear_step
from robots.pose import Array

FIXED = ("order", "source_joint", "clocked", "unit")  # scanned: whole numbers, and a scale
Ripples = tuple[Array, Array]
"""Sizes (s,) rad of a gear's ripple, and posterior (6, s) of that of each joint from what the other joints show."""


@runtime_checkable
class Geared(Protocol):
    """A channel that shows the ripple of all gears."""

    @property
    def ripples(self) -> Ripples:
        """About the current fit."""


def names_of(library: Mapping[str, Effect], options: Options) -> list[tuple[Effect, int]]:
    """Every effect at every joint it may have, impostors left out."""
    return [(e, j) for e in library.values() for j in e.places if Name(e.name, j) not in options.barred]


@dataclass(frozen=True)
class Candidate:
    """An effect at a joint that the channels can see: scanned values of its variants, whitened columns (N, V, m) per unit
    coefficient; among: of how many variants these are the most telling (0: all)."""

    effect: Effect
    joint: int
    scans: tuple[Scanned, ...]
    columns: Array
    among: int = 0


def candidates(channels: Sequence[Channel], library: Mapping[str, Effect], options: Options) -> list[Candidate]:
    """Everything of the library that any channel can see."""
    found = []
    held = {a.key: a.scanned for c in channels for a in c.active}
    for effect, joint in names_of(library, options):
        columns, scans = stacked_columns(channels, effect, joint, None)
        refined = held.get((effect.name, joint))
        if scans and refined is not None and scan_key(refined) not in {scan_key(s) for s in scans}:
            more, _ = stacked_columns(channels, effect, joint, [refined])
            columns, scans = np.concatenate([columns, more], axis=1), (*scans, refined)
        if scans:
            among = max(c.surroundings.among.get(effect.name, 0) for c in channels)
            found.append(Candidate(effect, joint, scans, columns, among))
    return found


def play(found: Sequence[Candidate], stack: Stack) -> list[Family]:
    """A little play in all joints at once, as one family that stays in the background: its size is one number for the machine, so
    that one joint with much more than the others stands out."""
    parts = [c for c in found if len(c.scans) == 1 and c.effect.size == 1 and "approach" in c.effect.needs and c.joint]
    if len(parts) < 3:  # no population
        return []
    columns = np.hstack([c.columns[:, 0] * c.effect.prior_sd[0] * c.effect.lower_end(c.scans) for c in parts])
    m = columns.shape[1]
    odds, positive = float(np.log(rules.PLAY_ODDS)), np.ones(m, bool)
    projected = stack.apply(columns)[:, None]
    return [Family(Name("~play"), None, ({},), projected, np.ones(m), rules.BACKGROUND_PLAY, positive, odds, background=True)]


def library_families(found: Sequence[Candidate], stack: Stack, options: Options, active: Set[tuple[str, int]]) -> list[Family]:
    """Families with projected columns. active: effects that the channels hold, candidates whether or not the noise of that fit
    still lets their usual size be seen: what was accepted must be weighed, and may be dropped."""
    families = []
    kinds = len({c.effect.name for c in found})
    for c in found:
        n, count, m = c.columns.shape
        scale = np.asarray(c.effect.prior_sd, float)
        projected = stack.apply(c.columns.reshape(n, -1)).reshape(n, count, m)
        projected *= scale
        energy = np.einsum("nvi,nvi->vi", projected, projected).max(axis=1)
        visible = (energy > rules.SEEN_LAMBDA) | ((c.effect.name, c.joint) in active)
        if not visible.any():
            continue
        scans = tuple(s for s, k in zip(c.scans, visible, strict=True) if k)
        odds = log_odds(c.effect, kinds, options.prior_effects) + float(np.log(len(c.scans) / max(c.among, len(c.scans))))
        seen = projected if visible.all() else projected[:, visible]
        name, sizes = Name(c.effect.name, c.joint), widths_of(c.effect, c.joint, scans, float(energy.max()))
        families.append(Family(name, c.effect, scans, seen, scale, sizes, c.effect.positive, odds, among=c.among))
    return families


def ripple_families(families: Sequence[Family], ripples: Ripples | None) -> list[Family]:
    """Of ripples of many orders LINES_A_GEAR twins each that stay in the background, of the size that the other gears show
    (`ripples`): a gear has several lines, and the name of one is not to stand for another."""
    found = []
    for f in families:
        if f.effect is None or not has_twin(f.effect, f.name.joint, f.scans, f.among):
            continue
        sizes, share = usual_ripple(f, ripples)
        odds = float(np.log(share * len(f.scans) / max(f.among, len(f.scans))))
        for k in range(1, rules.LINES_A_GEAR + 1):
            name = Name(k * "~" + f.name.effect, f.name.joint)
            found.append(replace(f, name=name, effect=None, sizes=sizes, log_odds=odds, background=True))
    return found


def usual_ripple(f: Family, ripples: Ripples | None) -> tuple[Array, float]:
    """What a gear may have without being named: sizes (T,) as shares of the upper end, and prior odds. What is usual, unless the
    other gears of this machine are surely (`QUIET`) below it: where they are, one that is not stands out. Where they are above
    it more likely than not, the line of this gear is one of theirs."""
    assert f.effect is not None
    usual = np.full(SIZES, rules.BACKGROUND_RIPPLE * f.effect.lower_end(f.scans))
    if ripples is None:
        return usual, rules.RIPPLE_ODDS
    sizes, weight = ripples[0] / f.scale[0], np.cumsum(ripples[1][f.name.joint - 1])

    def quantile(share: float) -> float:
        return float(sizes[min(int(np.searchsorted(weight, share)), len(sizes) - 1)])

    if quantile(rules.LEADS) > usual[0]:
        parts = [quantile((k + 0.5) / SIZES) for k in range(SIZES)]
        return np.maximum(parts, usual), float(1.0 - weight[0])
    return np.minimum(usual, max(quantile(rules.QUIET), sizes[1])), rules.RIPPLE_ODDS


def rival_of(effect: Effect, joint: int, scans: Sequence[Scanned]) -> Rival | None:
    """What of the background takes an effect's gap: its own twin below the usual range, or play in all joints."""
    if has_twin(effect, joint, scans):
        sizes = np.full(SIZES, rules.BACKGROUND_RIPPLE * effect.lower_end(scans))
        return Rival(sizes, float(np.log(rules.RIPPLE_ODDS / len(scans))), 0)
    if joint and "approach" in effect.needs:
        return Rival(rules.BACKGROUND_PLAY * effect.lower_end(scans), float(np.log(rules.PLAY_ODDS)), 6 - effect.size)
    return None


def widths_of(effect: Effect, joint: int, scans: Sequence[Scanned], energy: float) -> Array:
    """Prior widths (T,) of an effect as shares of the usual range's upper end, at which its columns have this mean square: also
    smaller than usual where that has no rival in the background and these readings show it."""
    least, shown = effect.lower_end(scans), float(np.sqrt(rules.SEEN_LAMBDA / max(energy, 1e-12)))
    return size_grid(least if rival_of(effect, joint, scans) else min(least, max(shown, rules.SMALLER * least)))


def smallest_seen(
    effect: Effect, joint: int, scans: Sequence[Scanned], among: int, odds: float, energy: float, others: Array
) -> float:
    """Share of the usual upper end from which an effect at a joint is named nine times of ten, inf: never; among: of how many
    variants `scans` are the most telling; energy: mean square of its columns at the upper end, others (k,): at its other joints.
    Play of all joints stands against that of one: of the others it pays for what these readings show of them."""
    rival, sizes = rival_of(effect, joint, scans), widths_of(effect, joint, scans, energy)
    beside = others if rival is not None and rival.beside else None
    # What physics holds positive has a half-normal prior, twice as dense where it is.
    each = odds - float(np.log(among)) + int(effect.positive.sum()) * float(np.log(2.0))
    return float(np.sqrt(visible_lambda(energy, effect.size, sizes, each, rival, beside) / max(energy, 1e-12)))


def movable(f: Family) -> tuple[str, ...]:
    """Scanned keys that may have any value, and are moved to the likeliest."""
    if f.effect is None:
        return ()
    return tuple(k for k in f.effect.symbolic if k not in FIXED and all(isinstance(s.get(k), float) for s in f.scans))


def spacing(values: Sequence[float]) -> float:
    """Half the median distance of the values scanned."""
    distinct = np.unique(np.asarray(values, float))
    return 0.5 * float(np.median(np.diff(distinct))) if len(distinct) > 1 else 0.0


def has_twin(effect: Effect, joint: int, scans: Sequence[Scanned], among: int = 0) -> bool:
    """Whether every machine has a little of it: ripples of many orders."""
    return max(len(scans), among) > 1 and joint > 0 and "amplitude_rad" in {p.key for p in effect.parameters}


def log_odds(effect: Effect, kinds: int, expected: float = rules.PRIOR_EFFECTS) -> float:
    """Prior odds of an effect at one joint, `kinds` effects being possible and so many of them expected."""
    return float(np.log(expected / kinds / len(effect.places)))


def stacked_columns(
    channels: Sequence[ReadingRows], effect: Effect, joint: int, scans: Sequence[Scanned] | None
) -> tuple[Array, tuple[Scanned, ...]]:
    """Whitened columns (N, V, m) of all channels one below the other, and the scanned values of each variant; zero where a
    channel cannot see the effect. Without `scans` the union of the channels' own."""
    parts = [c.variants(effect, joint, scans) for c in channels]
    chosen = parts[0][0] if scans is None else tuple(scans)
    if scans is None and len(channels) > 1:
        every = {scan_key(s): s for found, _ in parts for s in found}
        chosen, same = tuple(every.values()), [[*map(scan_key, found)] == [*every] for found, _ in parts]
        parts = [p if there else c.variants(effect, joint, chosen) for c, p, there in zip(channels, parts, same, strict=True)]
    if not any(found for found, _ in parts):
        return np.zeros((0, 0, effect.size)), ()
    size = len(chosen), effect.size
    made = [m if found else np.zeros((len(c.system.residual), *size)) for c, (found, m) in zip(channels, parts, strict=True)]
    return made[0] if len(made) == 1 else np.concatenate(made), chosen


def put_back(channels: Sequence[ReadingRows], active: Sequence[Active]) -> Array:
    """What the active effects add to the whitened predictions (N,)."""
    total = np.zeros(sum(len(c.system.residual) for c in channels))
    for one in active:
        columns, scans = stacked_columns(channels, one.effect, one.joint, [one.scanned])
        if scans:
            total += columns[:, 0] @ one.a
    return total


@dataclass(frozen=True)
class Linearisation:
    """Channels about their current fits, their stack and the pool of candidates (y about zero effects)."""

    channels: tuple[Channel, ...]
    stack: Stack
    pool: CandidatePool

    @cached_property
    def index(self) -> dict[Name, int]:
        """Family by name."""
        return {f.name: i for i, f in enumerate(self.pool.families)}

    def names(self, key: Key) -> tuple[Name, ...]:
        """Names of a set of families, sorted; kernels are named after their condition."""
        return tuple(sorted(self.pool.families[f].name for f in key))

    def named(self, weighed: Weighed) -> list[Member]:
        """Members from the library."""
        return [m for m in weighed.members if self.pool.families[m.family].effect is not None]

    def member(self, weighed: Weighed, name: Name) -> Member:
        """The member of a set that has a name."""
        return next(m for m in weighed.members if self.pool.families[m.family].name == name)

    def best_with(self, sets: Mapping[Key, Weighed], name: Name) -> Weighed:
        """The best of the sets that have a name."""
        return max((s for k, s in sets.items() if self.index[name] in k), key=lambda s: s.log)

    def signature(self, weighed: Weighed, one: Active) -> Array:
        """Projected signature (N,) of an effect of a set at its value."""
        m = self.member(weighed, Name(*one.key))
        return np.asarray(self.pool.columns(m) @ (one.a / self.pool.families[m.family].scale))

    def values(self, weighed: Weighed, free: Name | None = None) -> tuple[Active, ...]:
        """Effects of a set with their values and covariance, everything in the set fitted together, priors at the upper ends;
        in the order of their names. free: the one whose scanned numbers are unknowns too (variable projection's covariance, Golub
        and Pereyra 1973): its values are as unsure as these leave them."""
        if not weighed.members:
            return ()
        families = [self.pool.families[m.family] for m in weighed.members]
        C, scale = np.hstack([self.pool.columns(m) for m in weighed.members]), np.concatenate([f.scale for f in families])
        a = scale * linear_step(self.pool.y, C, np.zeros(len(scale)), np.ones(len(scale)), RANK).change
        blocks = np.split(np.arange(len(scale)), np.cumsum([len(f.scale) for f in families])[:-1])
        rows = list(zip(weighed.members, families, blocks, strict=True))
        every = np.hstack([C, *(self.moving(f, m.variant, a[k]) for m, f, k in rows if f.name == free)])
        spread = np.linalg.inv(np.eye(every.shape[1]) + every.T @ every)[: len(a), : len(a)] * np.outer(scale, scale)
        found = (Active(f.effect, f.name.joint, a[k], f.scans[m.variant], spread[np.ix_(k, k)]) for m, f, k in rows if f.effect)
        return tuple(sorted(found, key=lambda one: one.key))

    def moving(self, f: Family, variant: int, a: Array) -> Array:
        """Projected columns (N, k) of an effect, coefficients a (m,), for its `movable` numbers, per half of their distance where
        they are scanned: farther off another variant stands for them."""
        at, half = f.scans[variant], {key: spacing([s[key] for s in f.scans]) for key in movable(f)}
        ends = [{**at, key: at[key] + side * half[key]} for key in half for side in (rules.MOVED, -rules.MOVED)]
        if f.effect is None or not ends:
            return np.zeros((len(self.pool.y), 0))
        columns, seen = stacked_columns(self.channels, f.effect, f.name.joint, ends)
        changes = self.stack.apply(columns @ a) if seen else np.zeros((len(self.pool.y), len(ends)))
        return np.asarray((changes[:, ::2] - changes[:, 1::2]) / (2.0 * rules.MOVED))

    def variants(self, weighed: Weighed, name: Name) -> tuple[Member, tuple[Member, ...], Array]:
        """The member of a set that has a name, the others, and beside them the log evidence (V,) of its family's variants."""
        m = self.member(weighed, name)
        others = tuple(other for other in weighed.members if other is not m)
        return m, others, np.logaddexp.reduce(scan_one(self.pool, given(self.pool, others), m.family)[0], axis=1)

    def deviations(self, sets: Mapping[Key, Weighed], one: Active) -> dict[str, object]:
        """Standard deviations of an effect's values by key, over all that the readings hardly tell apart: its variants, as a wave
        fits nearly as well with the next order, at another phase; numbers between those scanned, as a balancer's levers; and what
        else these sets hold beside it."""
        name, likely, whole = Name(*one.key), list[tuple[float, Active]](), 0.0
        best = self.best_with(sets, name)
        for weighed in (s for k, s in sets.items() if self.index[name] in k and s.log > best.log + np.log(rules.FOLLOWED)):
            m, others, log = self.variants(weighed, name)
            share = np.exp(log - np.logaddexp.reduce(log) + weighed.log - best.log)
            whole += float(share.sum())
            for v in np.flatnonzero(share > rules.LISTED):
                beside = replace(weighed, members=(*others, m._replace(variant=int(v))))
                found = self.values(beside, name if share[v] > rules.FOLLOWED else None)
                other = next(a for a in found if a.key == one.key)
                if weighed is best and v == m.variant:  # as it was fitted, and what more is open
                    more = other.covariance - next(a for a in self.values(beside) if a.key == one.key).covariance
                    other = replace(one, covariance=one.covariance + more)
                likely.append((float(share[v]), other))
        return deviations_among(one, [(share / whole, other) for share, other in likely])

    def taken(self, weighed: Weighed) -> Given:
        """The set as given, with priors at the upper ends: what a fit of it takes from the data."""
        return given(self.pool, [Member(m.family, m.variant, 1.0) for m in weighed.members])


def linearised(channels: Sequence[Channel], library: Mapping[str, Effect], options: Options) -> Linearisation:
    """Linearise about the channels' current fits."""
    back = np.concatenate([put_back([c], c.active) for c in channels])
    found = candidates(channels, library, options)
    stacked = stack(tuple(channels), back)
    held = {a.key for c in channels for a in c.active}
    ripples = next((c.ripples for c in channels if isinstance(c, Geared)), None)
    families = list[Family]()
    for f in library_families(found, stacked, options, held):  # each signal has a clock of its own
        time = [c.surroundings.time for c in channels if f.effect is not None and not c.blind(f.effect)]
        families.append(replace(f, within=odds_of_instants(f.scans, np.concatenate(time or [np.empty(0)]))))
    families += kernel_families(channels, stacked)
    whole = make_pool(stacked.y, stacked.freedom, families, stacked.tails)
    families = most_telling(whole, _held(families, [a for c in channels for a in c.active]))
    families += ripple_families(families, ripples) + play(found, stacked)
    return Linearisation(tuple(channels), stacked, make_pool(stacked.y, stacked.freedom, families, stacked.tails))


def _held(families: Sequence[Family], active: Sequence[Active]) -> list[Member]:
    """Active effects as members of a set, at their scanned values."""
    at = {a.key: scan_key(a.scanned) for a in active}
    named = [(i, f.scans, at.get((f.name.effect, f.name.joint))) for i, f in enumerate(families)]
    return [Member(i, v, 1.0) for i, scans, key in named if key is not None for v, s in enumerate(scans) if scan_key(s) == key]


def kernel_families(channels: Sequence[Channel], stacked: Stack) -> list[Family]:
    """Library-free kernels of each channel as candidates for an effect outside the catalogue; zero in other channels."""
    parts = zip(channels, stacked.blocks, stacked.projections, strict=True)
    made = [(*part, kernel) for part in parts for kernel in kernels(part[0].conditions)]
    kinds, found = Counter(_kind(kernel) for *_, kernel in made), list[Family]()
    for channel, block, projection, kernel in made:
        changes = kernel.changes
        n, k, V, m = changes.shape
        columns = np.zeros((len(stacked.y), V * m))
        columns[block] = projection.apply(channel.whiten(changes.reshape(n, k, V * m)))
        columns *= kernel.high
        share = rules.PRIOR_UNKNOWN / len(kinds) / kinds[_kind(kernel)]
        share *= rules.BROKEN_ORDER_ODDS if "ripple" in kernel.where else 1.0
        share *= V / max(kernel.among, V)
        name, scale = Name(f"?{channel.name}/{kernel.where}/{kernel.source}", kernel.joint), np.full(m, kernel.high)
        sizes, scans, odds = size_grid(kernel.low / kernel.high), tuple({"kernel": v} for v in range(V)), float(np.log(share))
        whole = columns.reshape(-1, V, m)
        found.append(Family(name, None, scans, whole, scale, sizes, np.zeros(m, bool), odds, kernel.where))
    return found


def _kind(kernel: Kernel) -> str:
    return f"{kernel.source}:{''.join(c for c in kernel.where if not c.isdigit())}"
