"""More grinding, or tracker readings beside it, as rows added to those of a force log; and effects that the log leaves unseen."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.special import expit

from ocp.diagnose.engine.families import log_odds
from ocp.diagnose.engine.findings import Diagnosis, Name, Options, Ranked
from ocp.diagnose.force.believed import NUISANCE, Believed
from ocp.diagnose.force.channel import ForceChannel
from ocp.diagnose.force.planned import Shared, foreseen_force
from ocp.diagnose.foresee.planned import PER_READING, SETTLING
from ocp.diagnose.foresee.planned_grinding import Grinding, grindings
from ocp.diagnose.foresee.planned_poses import arm_expected, default_poses, planned_channel
from ocp.diagnose.foresee.separation import Pair, scans_of
from ocp.diagnose.rules import HIDDEN, NAMED_PRICE
from ocp.diagnose.tracker.channel import TrackerChannel
from ocp.effects.effect import Active, Effect, Scanned, Surroundings
from ocp.model.measuring_setup import read_tracker_setup

READINGS, SWAP = 60, 10.0  # of a tracker campaign beside a log; minutes for another payload


@dataclass(frozen=True)
class Campaign:
    """Tracker readings that could be taken: what to do, minutes."""

    do: str
    minutes: float


def more_grinding(channel: ForceChannel, pairs: Sequence[Pair]) -> tuple[Shared, list[tuple[Grinding, Shared]]]:
    """The log's own rows, and those of every candidate with the nuisance in common."""
    some = _looked_at(channel, pairs)
    own = Shared(replace(channel, effects=some, store={}, latest={}))
    return own, [(g, Shared(foreseen_force(channel, g.log, g.rows, some))) for g in grindings(channel)]


def tracker_beside(own: Shared) -> tuple[Campaign, Shared, TrackerChannel]:
    """A tracker campaign after the log; the log's rows with the arm as its readings leave it; the readings."""
    channel, scene = own.channel, own.channel.problem.scene
    setup = read_tracker_setup(scene.cell.path)
    like = default_poses(setup, READINGS, full=True)
    n = len(like)
    time = np.asarray(scene.conditions.clock.max() + 60.0 * (SETTLING + PER_READING * np.arange(n)), np.float64)
    planned = planned_channel(setup, replace(like, time=time, temperature=np.full(n, setup.tables.reference_temperature_C)))
    believed = placed_by(channel.problem.believed, planned)
    known = Shared(replace(channel, problem=replace(channel.problem, believed=believed)))
    do = f"tracker campaign: {n} readings with all payloads and both approach directions (ocp.poses)"
    return Campaign(do, SETTLING + PER_READING * n + SWAP * (len(like.payloads) - 1)), known, planned


def placed_by(believed: Believed, readings: TrackerChannel) -> Believed:
    """What is believed of the contact once tracker readings have told of the arm, whose prior they share in nothing else.

    The readings add H = C^-1 - P^-1 to the information on the arm, C their posterior and P its prior there.
    """
    arm, layout = arm_expected(readings), readings.task.layout
    prior = layout.prior_sd[[layout.index(name) for name in arm.names]]
    sd = np.sqrt(np.diag(arm.covariance))
    told = np.linalg.inv(arm.covariance / np.outer(sd, sd)) / np.outer(sd, sd) - np.diag(prior**-2.0)
    root = believed.root[[NUISANCE.index(name) for name in arm.names]]
    values, vectors = np.linalg.eigh(root.T @ told @ root)
    return replace(believed, root=believed.root @ (vectors / np.sqrt(1.0 + np.maximum(values, 0.0))))


def _looked_at(channel: ForceChannel, pairs: Sequence[Pair]) -> tuple[Effect, ...]:
    """The pairs' effects with the variants that are compared: only their fast patterns are kept."""
    scans: dict[str, tuple[Effect, list[Scanned]]] = {}
    for p in pairs:
        scans.setdefault(p.first.name.effect, (p.first.active.effect, []))[1].append(p.first.active.scanned)
        if p.rival is not None:
            scans.setdefault(p.rival.name, (p.rival, []))[1].extend(scans_of([channel], p.rival, p.joint))
    return tuple(_with_scan(effect, some) for effect, some in scans.values())


def _with_scan(effect: Effect, some: Sequence[Scanned]) -> Effect:
    def scan(joint: int, seen: Surroundings) -> Sequence[Scanned]:
        return some

    return replace(effect, scan=scan)


def unseen(d: Diagnosis, channel: ForceChannel, library: dict[str, Effect]) -> list[Pair]:
    """Effects of the contact that this log would not show at their usual size, at that size against nothing; odds are the
    prior's, less what evidence pays for variants and coefficients (docs/diagnosis.md, eq. 4)."""
    smallest = {s.name.effect: s.smallest for s in d.screened}
    known = [e for e in library.values() if e.on_contact and smallest.get(e.name, np.inf) > 1.0]
    known = sorted(known, key=lambda e: smallest.get(e.name, np.inf))[:HIDDEN]
    kinds = max(len(smallest), 1)
    found = []
    for effect in known:
        joint = effect.places[0]
        scans = tuple(effect.scan(joint, channel.surroundings))
        if scans:
            a = np.asarray(effect.prior_sd, float) / np.sqrt(effect.size)
            active = Active(effect, joint, a, scans[len(scans) // 2], np.zeros((effect.size, effect.size)))
            price = NAMED_PRICE * effect.size + float(np.log(len(scans)))
            now = float(expit(log_odds(effect, kinds, Options()) - price))
            found.append(Pair(Ranked(Name(effect.name, joint), now, 0.0, active, 0.0), None, 0, now))
    return found
