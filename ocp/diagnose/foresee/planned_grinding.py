"""Grinding that nobody has logged yet: the channel that a planned log would make, and recordings of a log once more.

The readings are those predicted about the believed contact, or about the fit of a log, so nothing is left of them;
sensitivities, columns and whitening are those of a measured log. Recordings of a log once more under other conditions are
rows of the same model. With them stand tracker readings beside a log, and the effects that a log leaves unseen.
"""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import zip_longest

import numpy as np
from scipy.special import expit

from ocp.calibrate.force.log import ForceLog
from ocp.calibrate.force.model import ForceRows
from ocp.calibrate.force.noise import CorrelatedNoise, NoiseGroup, ReadingNoise, Runs, Whitener
from ocp.calibrate.force.rows import log_conditions, prepare_force
from ocp.diagnose.engine.channel_system import UNSEEN, System, Variants
from ocp.diagnose.engine.evidence import Projection, project
from ocp.diagnose.engine.findings import Diagnosis, Name, Ranked
from ocp.diagnose.engine.linearisation import log_odds
from ocp.diagnose.force.channel import ForceChannel, problem_of
from ocp.diagnose.force.fit import BLOCKS, EffectFit, ForceProblem, linear, signals, units_of
from ocp.diagnose.force.prediction import nuisance_derivatives, predict_forces
from ocp.diagnose.force.prior import NUISANCE, NuisancePrior
from ocp.diagnose.foresee.planned_tracker import PER_READING, SETTLING, arm_expected, default_poses, planned_channel
from ocp.diagnose.foresee.separation import ProposedMeasurement, RivalPair, scans_of
from ocp.diagnose.rules import HIDDEN, NAMED_PRICE
from ocp.diagnose.tracker.channel import TrackerChannel
from ocp.effects.effect import Active, Effect, Scanned, Surroundings
from ocp.model.cell import Cell, read_tracker_setup
from robots.calibration.store import Calibration
from robots.pose import Array, Index, Mask

MOST = 2000  # rows of a plan that are looked at
SIGMA = 0.3  # N, one sigma of a reading where the plan does not say
SHARE, LASTS = 0.5, 0.05  # of its variance that lasts, s for how long: between the virtual cell's sensor and that of others' logs


def planned_force_channel(cell: Cell, log: ForceLog, effects: Iterable[Effect], arm: Calibration | None = None) -> ForceChannel:
    """The channel that the believed contact would make of planned rows; arm: its posterior where readings will place it
    (default: the cell's own).

    A plan with a column ft_N logs the tangential force too. Of more than `MOST` rows every k-th is taken, in the place of k of
    them. Raises BadInput, as `prepare_force`.
    """
    setup = prepare_force(replace(cell, effects=()), [log])
    every = int(np.ceil(len(log) / MOST))
    kept = _place(log) % every == 0
    log = log.take(kept)
    problem = problem_of(setup.take(kept), cell, log, arm, log.contact)
    noise = noise_of_means(CorrelatedNoise(1.0, SHARE, LASTS), every)
    whiteners = tuple(
        _whitener(one, np.full(len(log), SIGMA) if one.sigma_fn is None else one.sigma_fn, {True: noise, False: noise}, blocks)
        for one, blocks in zip(signals(log), BLOCKS, strict=False)
    )
    return ForceChannel(*_unmeasured(problem, np.zeros(problem.sizes[0]), (), whiteners), tuple(effects))


def foreseen_force(channel: ForceChannel, log: ForceLog, rows: ForceRows, effects: Iterable[Effect]) -> ForceChannel:
    """The channel that more rows of `log` would make about the fit of a measured one, with its noise."""
    old, fit = channel.problem, channel.fit
    known = log_conditions(old.scene.cell, log, float(old.scene.conditions.clock.max()))
    problem = ForceProblem(log, old.scene.over(rows, known, log.contact), old.believed)
    whiteners = tuple(
        _whitener(one, np.full(len(log), np.median(w.noise.base)), _noises(w), blocks)
        for one, w, blocks in zip(signals(log), fit.whiteners, BLOCKS, strict=False)
    )
    return ForceChannel(*_unmeasured(problem, fit.z[: old.sizes[0]], fit.active, whiteners), tuple(effects))


@dataclass(frozen=True)
class Shared:
    """A force channel whose nuisance is that of other recordings of the same cell too: columns of `prior.NUISANCE`'s standard
    normal unknowns, what single recordings are off by projected out."""

    channel: ForceChannel

    @cached_property
    def _own(self) -> Projection:
        """Of the recordings' offsets."""
        own = self.channel.problem.offsets
        return project(self._rows((own.normal, own.shear)), np.ones(own.count))

    @cached_property
    def system(self) -> System:
        """Whitened rows without a residual; the nuisance of all recordings."""
        problem, fit = self.channel.problem, self.channel.fit
        both = nuisance_derivatives(problem.scene, fit.at, fit.slopes[0]) @ problem.believed.root
        columns = self._own.apply(self._rows(tuple(both)))
        n, p = columns.shape
        return System(np.zeros(n), columns, np.ones(p), np.zeros(p), reading=np.zeros(n, np.int64))

    def variants(self, effect: Effect, joint: int, scans: Sequence[Scanned] | None = None) -> Variants:
        """As the channel's, in these rows."""
        found, columns = self.channel.variants(effect, joint, scans)
        return (found, np.stack([self._own.apply(columns[:, v]) for v in range(len(found))], axis=1)) if found else UNSEEN

    def _rows(self, both: Sequence[Array]) -> Array:
        averages = self.channel.averages
        return averages.rows(both[: len(averages.whiteners)])


def _unmeasured(
    problem: ForceProblem, z: Array, active: tuple[Active, ...], whiteners: tuple[Whitener, ...]
) -> tuple[ForceProblem, EffectFit]:
    """The problem with readings as predicted at nuisance z and these effects, and the fit that stands there."""
    x = problem.believed.mean + problem.believed.root @ z
    at = predict_forces(problem.scene, x, active)
    log = replace(problem.log, fn=at.fn, ft=None if problem.log.ft is None else at.read[1])
    problem = replace(problem, log=log)
    whole = np.concatenate([z, np.zeros(problem.sizes[1]), units_of(active)])
    made = linear(problem, whole, at, whiteners)
    return problem, EffectFit(**vars(made), z=whole, at=at, whiteners=whiteners, rested=True)


def noise_of_means(noise: CorrelatedNoise, count: int) -> CorrelatedNoise:
    """The noise of means of `count` rows that stand close together: what is white shrinks, what lasts stays."""
    white = (1.0 - noise.share) / count
    whole = noise.share + white
    return replace(noise, sigma=noise.sigma * np.sqrt(whole), share=noise.share / whole)


def _place(log: ForceLog) -> Index:
    """Number (n,) of each row within its recording."""
    out = np.zeros(len(log), np.int64)
    for run in np.unique(log.run):
        at = np.flatnonzero(log.run == run)
        out[at] = np.arange(len(at))
    return out


def _noises(whitener: Whitener) -> dict[bool, CorrelatedNoise]:
    """Noise in contact and in the air; one stands for the other where a log has one of them."""
    known = {contact: kind.noise for contact, kind in whitener.noise.kinds.items()}
    return {contact: known.get(contact, known.get(not contact, CorrelatedNoise(1.0, SHARE, LASTS))) for contact in (True, False)}


def _whitener(log: ForceLog, base: Array, noise: dict[bool, CorrelatedNoise], blocks: int) -> Whitener:
    """The filter of a signal of planned rows; base (n,) N times a noise's sigma is one sigma of a reading."""
    kinds = {}
    for contact, law in noise.items():
        rows = np.flatnonzero(log.contact == contact)
        if len(rows):
            kinds[contact] = NoiseGroup(rows, Runs.of(log.run[rows], log.time[rows]), law)
    return Whitener.of(ReadingNoise(base, np.ones(len(log)), kinds), blocks)


EACH, BEGIN = 0.5, 2.0  # minutes: to begin the next recording; to begin at all
SET = 1.0  # minutes to change a setpoint, the belt or the program's speed
IDLE = 20.0  # minutes after which a wheel has cooled
LADDER = (0.6, 0.8, 1.2, 1.4)  # of the usual setpoint
HELD, STEP = 60.0, 0.1  # s that a point is pressed, s between its readings
LINES = 6  # of the blade that are ground once more, at most
READINGS, SWAP = 60, 10.0  # of a tracker campaign beside a log; minutes for another payload


@dataclass(frozen=True)
class PlannedGrinding(ProposedMeasurement):
    """Recordings that could be made: their log (readings nan) and the model's rows."""

    log: ForceLog
    rows: ForceRows


@dataclass(frozen=True)
class Recording:
    """A recording to make: rows (k,) of the log whose postures it has, contact; setpoint N, belt m/s, feed m/s and times since
    its start (k,) s; idle: minutes before it."""

    rows: Index
    time: Array
    setpoint: float
    belt: float
    feed: float
    contact: bool = True
    idle: float = 0.0


def grindings(channel: ForceChannel) -> list[PlannedGrinding]:
    """Air runs, other setpoints, feeds and belt speeds, the other direction, one point held, lines once more at once and after a
    pause: of one line a side of the blade, or of all lines; none of a log without a recording of two rows in contact."""
    own = usual_recordings(channel)
    if not own:
        return []
    sides, all_of_them = own[:2], own[:LINES]
    told = [_named(channel, one) for one in sides]
    lines, belt, feed = " and ".join(told), sides[0].belt, sides[0].feed
    ladder = _ladder(channel, sides[0].setpoint)
    levels = ", ".join(f"{x:.3g}" for x in ladder)
    pause = [replace(r, idle=IDLE if k == 0 else 0.0) for k, r in enumerate(sides)]
    # What to do, its recordings, minutes of preparing.
    air = f"air run: retract the flange and run {lines} in the air (contact = 0), then grind {told[0]} once"
    idle = f"pause: let the wheel run idle for {IDLE:.0f} minutes, then grind {lines} again (clock_s, wheel_temperature_C)"
    hold = f"hold: press the middle of {told[0]} for a minute against the wheel at rest, lift, press again (belt_m_s = 0)"
    feeds = f"feed ladder: {lines} at {500 * feed:.0f} and {2000 * feed:.0f} mm/s (feed_mm_s)"
    forces = f"force ladder: {lines} at {levels} N (setpoint_N)"
    longer = f"longer log: {len(all_of_them)} lines of the blade once more as before"
    wanted: list[tuple[str, list[Recording], float]] = [
        (air, [*(replace(r, contact=False) for r in sides), sides[0]], 0.0),
        (f"repeat: grind {lines} twice more as before", [r for r in sides for _ in range(2)], 0.0),
        (idle, pause, 0.0),
        (feeds, [_fed(r, factor) for factor in (0.5, 2.0) for r in sides], 2 * SET),
        (f"other direction: {lines} from end to start", [replace(r, rows=r.rows[::-1]) for r in sides], 0.0),
        (hold, [_held(sides[0])] * 2, SET),
        (f"belt reversed: {lines} with belt_m_s = {-belt:g}", [replace(r, belt=-belt) for r in sides if belt], SET),
        (f"wheel speed: {lines} with belt_m_s = {0.5 * belt:g}", [replace(r, belt=0.5 * belt) for r in sides if belt], SET),
        (forces, [replace(r, setpoint=x) for x in ladder for r in sides], SET * len(ladder)),
        (longer, all_of_them if len(own) > len(sides) else [], 0.0),
    ]
    return [_behind(channel, do, recordings, more) for do, recordings, more in wanted if recordings]


def _ladder(channel: ForceChannel, usual_force: float) -> list[float]:
    """Setpoints N that the wheel's law covers; none without a flange, which sets them."""
    scene = channel.problem.scene
    low, high = scene.model.law.limits["force"]
    return [usual_force * share for share in LADDER if scene.cell.flange is not None and low <= usual_force * share <= high]


def usual_recordings(channel: ForceChannel) -> list[Recording]:
    """The recordings in contact as most of the log is, one a line, those of different sides of the blade first."""
    log, c = channel.log, channel.problem.scene.conditions
    firsts: list[tuple[float, Index]] = []
    typical = {"setpoint": _mode(c.setpoint[log.contact]), "belt": _mode(c.belt[log.contact])}
    for run in np.unique(log.run):
        rows = np.flatnonzero((log.run == run) & log.contact)
        if len(rows) > 1:
            odd = sum(float(np.median(getattr(c, k)[rows]) != v) for k, v in typical.items())
            firsts.append((odd, rows.astype(np.int64)))
    sides: tuple[dict[int, Index], dict[int, Index]] = {}, {}
    front = log.n[int(np.argmax(log.contact))]
    for _, rows in sorted(firsts, key=lambda one: one[0]):
        sides[int(log.n[rows[0]] @ front <= 0)].setdefault(int(c.line[rows[0]]), rows)
    order = [rows for both in zip_longest(*(side.values() for side in sides)) for rows in both if rows is not None]
    found = []
    for rows in order:
        setpoint, belt, feed = (float(np.median(values[rows])) for values in (c.setpoint, c.belt, c.feed))
        found.append(Recording(rows, log.time[rows] - log.time[rows[0]], setpoint, belt, max(feed, 1e-3)))
    return found


def _mode(values: Array) -> float:
    kinds, count = np.unique(values, return_counts=True)
    return float(kinds[int(np.argmax(count))])


def _named(channel: ForceChannel, one: Recording) -> str:
    log, row = channel.log, one.rows[0]
    return f"the path of run {log.runs[log.run[row]]}" if log.line is None else f"line {log.line[row]}"


def _fed(one: Recording, factor: float) -> Recording:
    """The same path at another feed, logged as often in time."""
    span, n = float(one.time[-1]), len(one.rows)
    count = max(round((n - 1) / factor) + 1, 2)
    rows = one.rows[np.linspace(0, n - 1, count).round().astype(int)]
    return replace(one, rows=rows, time=np.linspace(0.0, span / factor, count), feed=one.feed * factor)


def _held(one: Recording) -> Recording:
    """Its middle pressed for a while with the wheel at rest."""
    time = np.arange(0.0, HELD, STEP)
    return replace(one, rows=np.full(len(time), one.rows[len(one.rows) // 2]), time=time, belt=0.0)


def _behind(channel: ForceChannel, do: str, wanted: list[Recording], more: float) -> PlannedGrinding:
    """Recordings behind the end of the log, one after the other; more: minutes of preparing beside pauses."""
    log, c = channel.log, channel.problem.scene.conditions
    rows, sizes = np.concatenate([r.rows for r in wanted]), [len(r.rows) for r in wanted]
    starts, minutes = list[float](), BEGIN + more
    for r in wanted:
        minutes += EACH + r.idle
        starts.append(60.0 * minutes)
        minutes += float(r.time[-1]) / 60.0

    def told(values: list[float]) -> Array:
        return np.repeat(np.asarray(values, float), sizes)

    time = np.concatenate([r.time for r in wanted])
    contact, cooled = told([float(r.contact) for r in wanted]) > 0, told(list(np.cumsum([r.idle for r in wanted]))) > 0
    setpoint, belt = told([r.setpoint for r in wanted]), told([r.belt for r in wanted])
    new = replace(
        log.take(rows),
        run=np.repeat(np.arange(len(wanted)), sizes),
        runs=tuple(f"{k + 1}" for k in range(len(wanted))),
        time=time,
        fn=np.full(len(rows), np.nan),
        contact=contact,
        s=c.s[rows],
        setpoint=setpoint,
        setpoint_sd=None,
        feed=told([r.feed for r in wanted]),
        belt=belt,
        clock=None if log.clock is None else float(log.clock.max()) + told(starts) + time,
        ground_before=_ground(log, rows, sizes, contact),
        temperature=_after(log, log.temperature, np.zeros(len(rows), bool)),
        wheel_temperature=_after(log, log.wheel_temperature, cooled),
    )
    made = channel.problem.scene.rows.take(rows)
    return PlannedGrinding(do, minutes, new, replace(made, setpoint=setpoint, belt=np.sign(belt), contact=contact))


def _after(log: ForceLog, values: Array | None, cooled: Mask) -> Array | None:
    """A temperature (n,) after the log: as at its end, as low as it ever was where the wheel has cooled."""
    if values is None:
        return None
    return np.where(cooled, values.min(), values[-1] if log.clock is None else values[int(np.argmax(log.clock))])


def _ground(log: ForceLog, rows: Index, sizes: list[int], contact: Mask) -> Index | None:
    """How often (n,) the line of each new row was ground before."""
    if log.ground_before is None:
        return None
    line = np.zeros(len(log), np.int64) if log.line is None else log.line
    count = {int(k): int(log.ground_before[(line == k) & log.contact].max(initial=-1)) + 1 for k in np.unique(line)}
    out, start = np.zeros(len(rows), np.int64), 0
    for size in sizes:
        k = int(line[rows[start]])
        out[start : start + size] = count[k]
        count[k] += int(contact[start])
        start += size
    return out


def more_grinding(channel: ForceChannel, pairs: Sequence[RivalPair]) -> tuple[Shared, list[tuple[PlannedGrinding, Shared]]]:
    """The log's own rows, and those of every candidate with the nuisance in common."""
    some = _looked_at(channel, pairs)
    own = Shared(replace(channel, effects=some))
    return own, [(g, Shared(foreseen_force(channel, g.log, g.rows, some))) for g in grindings(channel)]


def tracker_beside(own: Shared) -> tuple[ProposedMeasurement, Shared, TrackerChannel]:
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
    return ProposedMeasurement(do, SETTLING + PER_READING * n + SWAP * (len(like.payloads) - 1)), known, planned


def placed_by(believed: NuisancePrior, readings: TrackerChannel) -> NuisancePrior:
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


def _looked_at(channel: ForceChannel, pairs: Sequence[RivalPair]) -> tuple[Effect, ...]:
    """The pairs' effects with the variants that are compared: only their fast patterns are kept."""
    scans: dict[str, tuple[Effect, list[Scanned]]] = {}
    for p in pairs:
        scans.setdefault(p.first.name.effect, (p.first.active.effect, []))[1].append(p.first.active.scanned)
        if p.rival is not None:
            scans.setdefault(p.rival.name, (p.rival, []))[1].extend(scans_of([channel], p.rival, p.joint))
    return tuple(replace(effect, scan=_always(some)) for effect, some in scans.values())


def _always(some: Sequence[Scanned]) -> Callable[[int, Surroundings], Sequence[Scanned]]:
    return lambda joint, seen: some


def unseen(d: Diagnosis, channel: ForceChannel, library: dict[str, Effect]) -> list[RivalPair]:
    """Effects of the contact that this log would not show at their usual size, at that size against nothing; odds are the
    prior's, less what evidence pays for variants and coefficients (docs/diagnosis.md, eq. 4)."""
    smallest = {s.name.effect: s.smallest for s in d.screened}
    known = [e for e in library.values() if e.on_contact and not e.on_arm and smallest.get(e.name, np.inf) > 1.0]
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
            now = float(expit(log_odds(effect, kinds) - price))
            found.append(RivalPair(Ranked(Name(effect.name, joint), now, 0.0, active, 0.0), None, 0, now))
    return found
