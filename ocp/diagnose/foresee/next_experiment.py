"""What to measure next: the experiment that per minute makes surest of the explanations that remain.

For two rivals A and B the evidence that new readings bring if A is true is half of what of A's signature B cannot imitate
(`separation`): log odds + (lambda_new - lambda_now) / 2. Measurements with the tracker (`planned_tracker`) and more grinding
(`planned_grinding`) are simulated as rows added to the linear system. What no rows of the log can stand for, and link-side
encoders, are judged by what they bring out (`Lever`).
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, cast

import numpy as np
from scipy.special import expit

from ocp.diagnose import rules
from ocp.diagnose.engine.channel_system import Channel, ReadingRows, shows
from ocp.diagnose.engine.findings import Diagnosis, Experiment, Name
from ocp.diagnose.engine.linearisation import put_back
from ocp.diagnose.foresee.planned_tracker import before_and_after, channel_about, planned_measurements
from ocp.diagnose.foresee.separation import NOTHING, ProposedMeasurement, RivalPair, unlike
from ocp.diagnose.tracker.channel import TrackerChannel
from ocp.effects.effect import Effect

if TYPE_CHECKING:  # a campaign of the tracker alone need not load meshes and contact
    from ocp.diagnose.force.channel import ForceChannel

FORCE = "force"  # name of the channel of a grinding-force log


@dataclass(frozen=True)
class Lever(ProposedMeasurement):
    """An experiment in words; moves: effects whose signature it isolates or turns over (others keep theirs)."""

    moves: str


BY_SIGNAL = {
    "force": (
        Lever(
            "second blade: the same line on a fresh blade of the same kind (session)",
            15.0,
            "material_removal stock_profile blade_stiffness",
        ),
        Lever("tilt: the same contact with the flange's axis turned up and down by 30 deg", 8.0, "flange_gravity sensor_bias"),
    ),
    "joint": (
        Lever("the same motion at half and at double speed", 3.0, "channel_delay joint_compliance friction_windup"),
        Lever(
            "creep: every joint over its range at 1 deg/s and back, so that inertia and delay vanish",
            10.0,
            "channel_delay backlash load_backlash gear_1x gear_2x gear_harmonic motor_harmonic encoder_scale joint_coupling",
        ),
        Lever(
            "the same motion with a known payload",
            12.0,
            "joint_compliance joint_stiffening gravity_compensator friction_windup load_backlash payload_mass",
        ),
    ),
}


FIXED = 3  # reflectors on the floor
BAR_SD = 2.5e-6  # of the scale: 5 um over a bar of two metres
FLOOR = ProposedMeasurement(
    f"fixed reflectors: set {FIXED} reflectors on the floor around the robot and read them at the start, in the middle and at "
    "the end of the next campaign",
    10.0,
)
BAR = ProposedMeasurement("scale bar: read both ends of a calibrated bar of two metres in four places around the tracker", 15.0)


def next_experiments(d: Diagnosis, library: dict[str, Effect]) -> tuple[Experiment, ...]:
    """At most `MOST_EXPERIMENTS`, the one that tells most per minute first; empty where nothing is left to tell apart.

    Where that leaves none, those that would show effects of the contact which a force log leaves unseen at their usual size.
    """
    pairs = rival_pairs(d, library)
    best = _simulated(d, pairs) if pairs else _for_unknown(d)
    force = next((c for c in d.channels if c.name == FORCE), None)
    if best or force is None or d.p_unknown > rules.LEADS:
        return best
    from ocp.diagnose.foresee.planned_grinding import unseen

    return tuple(e for e in _simulated(d, unseen(d, cast("ForceChannel", force), library)) if e.expected > rules.LEADS)


def _simulated(d: Diagnosis, pairs: Sequence[RivalPair]) -> tuple[Experiment, ...]:
    """What tells these pairs apart."""
    found: list[Experiment] = []
    for channel in d.channels:
        others = [c for c in d.channels if c is not channel]
        if isinstance(channel, TrackerChannel):
            found += _by_tracker(channel, pairs, others)
        elif channel.name == FORCE:
            found += _by_grinding(cast("ForceChannel", channel), pairs, others)
        if channel.name in BY_SIGNAL:
            found += _by_levers(channel, pairs)
    return _best(found, {p.names: p.now for p in pairs})


def rival_pairs(d: Diagnosis, library: dict[str, Effect]) -> list[RivalPair]:
    """Pairs that remain: what the best explanation has and another one has instead, members of a class, presence itself."""
    by_name = {r.name: r for r in d.ranking}
    found: dict[tuple[Name, Name | None], RivalPair] = {}

    def add(first: Name, rival: Name | None, now: float) -> None:
        if first in by_name and (first, rival) not in found and (rival is None or rival.effect in library):
            effect = None if rival is None else library[rival.effect]
            found[first, rival] = RivalPair(by_name[first], effect, 0 if rival is None else rival.joint, now)

    if d.explanations:
        best = d.explanations[0]
        for other in d.explanations[1:]:
            if other.probability < rules.RIVAL:
                continue
            now = best.probability / (best.probability + other.probability)
            mine, theirs = (sorted(set(a.names) - set(b.names)) for a, b in ((best, other), (other, best)))
            for own in mine:
                add(own, theirs[0] if theirs else None, now)
            if not mine and theirs and 1.0 - now > rules.ON_TOP:
                add(theirs[0], None, 1.0 - now)
        if rules.RIVAL < d.p_none < 1 - rules.RIVAL and best.names:
            add(best.names[0], None, best.probability / (best.probability + d.p_none))
    accepted = {Name(*a.key) for a in d.active}
    for group in d.classes:
        for name in accepted & set(group):
            for rival in sorted(set(group) - {name}):
                add(name, rival, 0.5)
    return list(found.values())[: rules.MOST_RIVALS]


def _by_tracker(channel: TrackerChannel, pairs: Sequence[RivalPair], others: Sequence[ReadingRows]) -> list[Experiment]:
    joints = tuple(sorted({j for p in pairs for j in (p.first.name.joint, p.joint)} - {0}))[:4]
    seen = [p for p in pairs if shows(channel, p.first.active)]
    if not seen:
        return []
    now = {p.names: unlike([channel], p, others) for p in seen}
    found = []
    for candidate in planned_measurements(channel, joints):
        there = channel_about(channel, candidate.readings)
        found += [_expected(candidate, p, unlike([channel, there], p, others) - now[p.names]) for p in seen]
    return found + [e for p in seen for e in _without_the_robot(channel, p, unlike([channel], p))]


def _by_grinding(channel: "ForceChannel", pairs: Sequence[RivalPair], others: Sequence[ReadingRows]) -> list[Experiment]:
    """More grinding, and tracker readings where there are none."""
    from ocp.diagnose.foresee.planned_grinding import more_grinding, tracker_beside

    own, planned = more_grinding(channel, pairs)
    now = {p.names: unlike([own], p, others) for p in pairs}
    found = [_expected(g, p, unlike([own, there], p, others) - now[p.names]) for g, there in planned for p in pairs]
    if not any(isinstance(c, TrackerChannel) for c in others):
        campaign, arm_known, readings = tracker_beside(own)
        found += [_expected(campaign, p, unlike([arm_known], p, [*others, readings]) - now[p.names]) for p in pairs]
    return found


def _without_the_robot(channel: TrackerChannel, pair: RivalPair, now: float) -> list[Experiment]:
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
        start, end = np.split(put_back([channel_about(channel, before_and_after(channel.readings))], [pair.first.active]), 2)
        gained = 0.5 * float(np.sum((end - start)[: 3 * FIXED] ** 2))
    return [_expected(BAR if scale else FLOOR, pair, gained)]


def _expected(candidate: ProposedMeasurement, pair: RivalPair, gained: float) -> Experiment:
    """The pair's odds after lambda has grown by `gained`."""
    odds = np.log(max(pair.now, 1e-6) / max(1.0 - pair.now, 1e-6))
    return Experiment(candidate.do, candidate.minutes, pair.names, float(expit(odds + 0.5 * max(gained, 0.0))))


def _by_levers(channel: Channel, pairs: Sequence[RivalPair]) -> list[Experiment]:
    """Experiments that move one of a pair and not the other are worth EXPERIMENT_REPEATED of what the rows taken so far are."""
    found = []
    for lever in BY_SIGNAL[channel.name]:
        for p in pairs:
            moved = [name.split(":")[0] in lever.moves.split() for name in p.names]
            if (moved[0] != moved[1] or (p.rival is None and moved[0])) and shows(channel, p.first.active):
                found.append(_expected(lever, p, rules.EXPERIMENT_REPEATED * p.first.detectability))
    return found


def _best(found: Sequence[Experiment], now: dict[tuple[str, ...], float]) -> tuple[Experiment, ...]:
    """The experiments by what they bring per minute to all pairs together; those first chosen that add most to what the chosen
    ones bring, then the best of the others."""
    each: dict[str, list[Experiment]] = {}
    for e in found:
        each.setdefault(e.do, []).append(e)

    def worth(do: str, known: dict[tuple[str, ...], float]) -> float:
        gains = [e.expected - known[e.tells_apart] for e in each[do]]
        return sum(g for g in gains if g > rules.EXPERIMENT_GAIN) / each[do][0].minutes

    chosen, known = list[str](), dict(now)
    while len(chosen) < rules.MOST_EXPERIMENTS:
        best = max((do for do in each if do not in chosen), key=lambda do: worth(do, known), default=None)
        if best is None or worth(best, known) == 0:
            break
        chosen.append(best)
        known.update({e.tells_apart: max(e.expected, known[e.tells_apart]) for e in each[best]})
    others = sorted((do for do in each if do not in chosen and worth(do, now) > 0), key=lambda do: -worth(do, now))
    kept = sorted([*chosen, *others[: rules.MOST_EXPERIMENTS - len(chosen)]], key=lambda do: -worth(do, now))
    return tuple(_together(each[do], now) for do in kept)


def _together(same: Sequence[Experiment], now: dict[tuple[str, ...], float]) -> Experiment:
    """One experiment for the pair to which it brings most, with all other rivals of that name that it settles."""
    best = max(same, key=lambda e: e.expected - now[e.tells_apart])
    first = best.tells_apart[0]
    more = [e for e in same if e is not best and e.tells_apart[0] == first and e.expected >= min(rules.SETTLES, best.expected)]
    names = (*best.tells_apart, *(name for e in more for name in e.tells_apart[1:]))
    return replace(best, tells_apart=names, expected=min(e.expected for e in (best, *more)))


def _for_unknown(d: Diagnosis) -> tuple[Experiment, ...]:
    """Where the gap is there and no name fits: look closer where it lies."""
    at = d.location
    if d.p_unknown < rules.UNKNOWN_LOOKED_AT or at is None or at.signal != "tracker" or not at.joint:
        return ()
    channel = next(c for c in d.channels if isinstance(c, TrackerChannel))
    sweep = planned_measurements(channel, (at.joint,))[-1]
    names = ("an effect outside the catalogue", NOTHING)
    return (Experiment(sweep.do, sweep.minutes, names, float(np.clip(d.p_unknown, 0.9, 1.0))),)
