"""What to measure next: the experiment that per minute makes surest of the explanations that remain.

For two rivals A and B the evidence that new readings bring if A is true is half of what of A's signature B cannot imitate,

    lambda(A | B) = min over b of |M (C_A a - C_B b)|^2,    log odds + (lambda_new - lambda_now) / 2,

M the projection of nuisance on old and new readings together, a the value found. Measurements with the tracker are simulated
as rows added to the linear system (`planned`); for force logs and link-side encoders `levers` says what each brings out.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.special import expit

from ocp.diagnosis.findings import Diagnosis, Name, Ranked
from ocp.diagnosis.levers import BY_SIGNAL, Lever
from ocp.diagnosis.planned import Candidate, before_and_after, candidates, foreseen
from ocp.diagnosis.projection import project
from ocp.diagnosis.system import Channel, Variant
from ocp.diagnosis.tracker.channel import TrackerChannel
from ocp.effects.effect import Effect
from robots.pose import Array

RIVAL = 0.05  # probability of an explanation from which it is one to tell apart
LEAST_GAIN = 0.02  # of probability; an experiment that brings less is not worth its time
MOST = 5
MOST_PAIRS = 6
MOST_SCANS = 12  # variants of a rival that are tried
NOTHING = "none"
LEAST_LIKELY = 0.15  # probability from which it is asked whether an effect comes on top of the best explanation


@dataclass(frozen=True)
class Experiment:
    """What to do, minutes, the names it tells apart, and the probability that the true one is expected to have afterwards."""

    do: str
    minutes: float
    tells_apart: tuple[str, ...]
    expected: float


FIXED = 3  # reflectors on the floor
BAR_SD = 2.5e-6  # of the scale: 5 um over a bar of two metres
FLOOR = Experiment(
    f"fixed reflectors: set {FIXED} reflectors on the floor around the robot and read them at the start, in the middle and at "
    "the end of the next campaign", 10.0, (), 0.0,
)  # fmt: skip
BAR = Experiment("scale bar: read both ends of a calibrated bar of two metres in four places around the tracker", 15.0, (), 0.0)


@dataclass(frozen=True)
class Pair:
    """An effect with its value, its rival (None: nothing), and the probability of the first against the second now."""

    first: Ranked
    rival: Effect | None
    joint: int
    now: float

    @property
    def names(self) -> tuple[str, ...]:
        """Of both."""
        return (str(self.first.name), NOTHING if self.rival is None else str(Name(self.rival.name, self.joint)))


def next_experiments(d: Diagnosis, library: dict[str, Effect]) -> tuple[Experiment, ...]:
    """At most `MOST` experiments, the one that tells most per minute first; empty where nothing is left to tell apart."""
    pairs = rivals(d, library)
    if not pairs:
        return _for_unknown(d)
    found: list[Experiment] = []
    for channel in d.channels:
        if isinstance(channel, TrackerChannel):
            found += _by_tracker(channel, pairs)
        else:
            found += _by_levers(channel, pairs)
    return _best(found, {p.names: p.now for p in pairs})


def rivals(d: Diagnosis, library: dict[str, Effect]) -> list[Pair]:
    """Pairs that remain: what the best explanation has and another one has instead, members of a class, presence itself."""
    by_name = {r.name: r for r in d.ranking}
    found: dict[tuple[Name, Name | None], Pair] = {}

    def add(first: Name, rival: Name | None, now: float) -> None:
        if first in by_name and (first, rival) not in found and (rival is None or rival.effect in library):
            effect = None if rival is None else library[rival.effect]
            found[first, rival] = Pair(by_name[first], effect, 0 if rival is None else rival.joint, now)

    if d.explanations:
        best = d.explanations[0]
        for other in d.explanations[1:]:
            if other.probability < RIVAL:
                continue
            now = best.probability / (best.probability + other.probability)
            mine, theirs = (sorted(set(a.names) - set(b.names)) for a, b in ((best, other), (other, best)))
            for own in mine:
                add(own, theirs[0] if theirs else None, now)
            if not mine and theirs and 1.0 - now > LEAST_LIKELY:
                add(theirs[0], None, 1.0 - now)
        if RIVAL < d.p_none < 1 - RIVAL and best.names:
            add(best.names[0], None, best.probability / (best.probability + d.p_none))
    accepted = {Name(a.effect.name, a.joint) for a in d.active}
    for group in d.classes:
        for name in accepted & set(group):
            for rival in sorted(set(group) - {name}):
                add(name, rival, 0.5)
    return list(found.values())[:MOST_PAIRS]


def _by_tracker(channel: TrackerChannel, pairs: Sequence[Pair]) -> list[Experiment]:
    joints = tuple(sorted({p.first.name.joint for p in pairs} | {p.joint for p in pairs} - {0}))[:4]
    seen = [p for p in pairs if _signature(channel, p) is not None]
    if not seen:
        return []
    found = []
    now = {p.names: unlike([channel], p) for p in seen}
    for candidate in candidates(channel, tuple(j for j in joints if j)):
        there = foreseen(channel, candidate.readings)
        found += [_expected(candidate, p, unlike([channel, there], p) - now[p.names]) for p in seen]
    return found + [e for p in seen for e in _without_the_robot(channel, p, now[p.names])]


def _without_the_robot(channel: TrackerChannel, pair: Pair, now: float) -> list[Experiment]:
    """Reflectors on the floor and a scale bar see the tracker alone: with them an effect of the tracker cannot pass for one of
    the arm any more."""
    if pair.rival is None:
        return []
    effect = pair.first.active.effect
    of_tracker = [e.reading is not None and not e.on_arm and e.name != "target_shift" for e in (effect, pair.rival)]
    if of_tracker[0] == of_tracker[1]:
        return []
    scale = "tracker_scale" in (effect.name, pair.rival.name)
    if not of_tracker[0]:
        # The tracker is known to stand still then: the rival has no freedom left.
        gained = unlike([channel], replace(pair, rival=None)) - now
    elif scale:
        gained = float((pair.first.active.a[0] / BAR_SD) ** 2)
    else:
        start, end = np.split(_signature_or_none(foreseen(channel, before_and_after(channel.readings)), pair), 2)
        gained = 0.5 * float(np.sum((end - start)[: 3 * FIXED] ** 2))
    return [_expected(BAR if scale else FLOOR, pair, gained)]


def _expected(candidate: Candidate | Experiment | Lever, pair: Pair, gained: float) -> Experiment:
    odds = np.log(max(pair.now, 1e-6) / max(1.0 - pair.now, 1e-6))
    return Experiment(candidate.do, candidate.minutes, pair.names, float(expit(odds + 0.5 * max(gained, 0.0))))


def unlike(channels: Sequence[Channel], pair: Pair) -> float:
    """lambda(A | B): what of the first's signature the rival and the nuisance, over all channels, cannot imitate."""
    systems = [c.system for c in channels]
    sd = systems[0].prior_sd
    signature = np.concatenate([_signature_or_none(c, pair) for c in channels])
    nuisance = np.concatenate([s.nuisance for s in systems])
    if pair.rival is None:
        return float(np.sum(project(nuisance, sd).apply(signature) ** 2))
    best = np.inf
    for columns in _rival_columns(channels, pair):
        whole = np.hstack([nuisance, columns])
        width = np.concatenate([sd, np.asarray(pair.rival.prior_sd, float)])
        best = min(best, float(np.sum(project(whole, width).apply(signature) ** 2)))
    return best


def _signature(channel: Channel, pair: Pair) -> Array | None:
    one = pair.first.active
    made = channel.variants(one.effect, one.joint, [one.scanned])
    return made[0].columns @ one.a if made else None


def _signature_or_none(channel: Channel, pair: Pair) -> Array:
    found = _signature(channel, pair)
    return np.zeros(len(channel.system.residual)) if found is None else found


def _rival_columns(channels: Sequence[Channel], pair: Pair) -> list[Array]:
    """Stacked columns (N, m) of the rival's variants, a few of them evenly over its scan."""
    assert pair.rival is not None
    scans = [v.scanned for v in channels[0].variants(pair.rival, pair.joint)] or [{}]
    pick = np.unique(np.linspace(0, len(scans) - 1, min(MOST_SCANS, len(scans))).round().astype(int))
    chosen = [scans[k] for k in pick]
    made: list[list[Variant]] = [c.variants(pair.rival, pair.joint, chosen) for c in channels]
    found = []
    for k in range(len(chosen)):
        parts = [
            v[k].columns if v else np.zeros((len(c.system.residual), pair.rival.size))
            for c, v in zip(channels, made, strict=True)
        ]
        found.append(np.concatenate(parts))
    return found


def _by_levers(channel: Channel, pairs: Sequence[Pair]) -> list[Experiment]:
    """Experiments that move one of a pair and not the other are worth as much again as the rows taken so far."""
    found = []
    for lever in BY_SIGNAL.get(channel.name, ()):
        for p in pairs:
            moved = [name.split(":")[0] in lever.moves for name in p.names]
            if (moved[0] != moved[1] or (p.rival is None and moved[0])) and channel.variants(
                p.first.active.effect, p.first.active.joint, [p.first.active.scanned]
            ):
                gained = 0.25 * p.first.detectability
                found.append(_expected(lever, p, gained))
    return found


def _best(found: list[Experiment], now: dict[tuple[str, ...], float]) -> tuple[Experiment, ...]:
    """The experiments by what they bring per minute, for every pair the best two, no experiment twice."""
    worth = [e for e in found if e.expected - now[e.tells_apart] > LEAST_GAIN]
    worth.sort(key=lambda e: -(e.expected - now[e.tells_apart]) / e.minutes)
    kept: list[Experiment] = []
    for e in worth:
        if sum(k.tells_apart == e.tells_apart for k in kept) < 2 and all(k.do != e.do for k in kept):
            kept.append(e)
    return tuple(kept[:MOST])


def _for_unknown(d: Diagnosis) -> tuple[Experiment, ...]:
    """Where the gap is there and no name fits: look closer where it lies."""
    at = d.location
    if d.p_unknown < 0.2 or at is None or at.signal != "tracker" or not at.joint:
        return ()
    channel = next(c for c in d.channels if isinstance(c, TrackerChannel))
    sweep = candidates(channel, (at.joint,))[-1]
    return (Experiment(sweep.do, sweep.minutes, ("an effect outside the catalogue", NOTHING), float(max(d.p_unknown, 0.9))),)
