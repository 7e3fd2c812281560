"""The gap of each signal: how far it is expected to shrink, what the named effects change where nobody has measured yet, and
what remains of it.

Where conditions are asked for (sealed ones), there: they hold no readings. Else new tracker readings are taken to come after the
campaign, with any of the cell's payloads and at any temperature of the campaign: an effect that the refitted geometry hides among
the payloads measured may show with another one, and then the baseline is worse than on the campaign itself.

What remains after the named effects, above the instrument's own noise, is a posterior predictive check, signal by signal. A fit's
joint noise is learnt from its residual and holds whatever is not modelled, so its size does not stand out. Here the residual is
held against the instrument and the repeatability that repeats show, else the usual one (Rubin 1984, section 5; tail probability
averaged over how well the repeatability is known), its pattern against the kernel that follows it best, the number of kernels
allowed for, and one group's scatter against the others' (`robots.calibration.uneven`). The smallest of these p-values counts as
often as there are tests.
"""

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from scipy.special import chdtrc, fdtrc, ndtri

from ocp.diagnose.engine.channel_system import SCALE, Channel, HeldOut, shows
from ocp.diagnose.engine.evidence import stack
from ocp.diagnose.engine.findings import Alternative, Diagnosis, KernelTest, summing_to
from ocp.diagnose.engine.search import outliers
from ocp.diagnose.foresee.planned_tracker import channel_about
from ocp.diagnose.rules import LATER, LATER_WARMTHS, LEAST_WARMTH, NOISE_TRUST, PLACE_SURE
from ocp.diagnose.tracker.channel import TrackerChannel
from ocp.diagnose.tracker.refit import freedom_used, usual_noise
from ocp.diagnose.verdict.answer import Followed, Remaining, SignalGap
from ocp.diagnose.verdict.patching import seen_by, unfaded
from ocp.diagnose.verdict.shrinkage import (
    ANOTHER_DAY,
    NONE,
    Anticipated,
    NewReadings,
    Shrinkage,
    estimation_variance,
    fold_kind,
    from_folds,
    from_model,
    promised_by_kind,
    promised_later,
    realised,
)
from ocp.effects.engine.readings import has_columns
from robots.calibration.noise import Noise, reading_covariance
from robots.calibration.residuals import points
from robots.pose import Array, Index, Mask
from robots.tracker_readings import Readings

POSTURES, ASKED = 60, 300  # of the campaign, of the conditions asked for, evenly taken
TOGETHER = ([0], [1, 2], [3], [4], [5])  # axes whose angles stay together: the arm stays off the floor
LEVELS = 21  # of the joint noise that are averaged


def signal_gap(diagnosis: Diagnosis, before: Channel, after: Channel, sealed: Any = None) -> SignalGap:
    """The gap of one channel; its shrinkage is predicted from what was fitted, for the conditions `sealed` if there are any."""
    scale = SCALE[before.unit]
    kept = counted(after)
    sizes = [scale * np.linalg.norm(np.atleast_2d(c.gap()), axis=1)[kept] for c in (before, after)]
    held = diagnosis.held_out.get(before.name, ())
    told = tuple((h.fold.name, realised(*h.means) if diagnosis.active else None) for h in held if h.fold.extrapolates)
    shown = tuple(a.key for a in diagnosis.active if shows(after, a))
    shrinkage, asked = _shrinkage(diagnosis, before, after, held, float(np.mean(sizes[0] ** 2)), sealed, bool(shown))
    promise = {} if shrinkage in (None, NONE) else promise_by_kind(after, held, shrinkage)
    left = remaining(after, diagnosis.left_over)
    left = Remaining(scale * left.above_noise, left.p_value)
    figures = before.name, before.unit, after.noise_floor, sizes[0], sizes[1]
    beyond = kinds_beyond(after, held, sealed) if asked else ()
    elsewhere = bool(getattr(after, "surprises", ()))
    return SignalGap(*figures, shrinkage, promise, told, left, before, after, asked, beyond, shown, elsewhere)


def remaining(channel: Channel, tests: Sequence[KernelTest]) -> Remaining:
    """Of a channel with the named effects in it, gross readings apart; tests: kernel tests after the effects."""
    told = [_of_tracker(channel) if isinstance(channel, TrackerChannel) else _of_rows(channel)]
    if isinstance(channel, TrackerChannel):  # a test that found nothing is one too
        one = channel.uneven
        told.append(Remaining(0.0, 1.0) if one is None else Remaining(one.rms * float(np.sqrt(one.share)), one.p_value))
    if own := [t for t in tests if t.channel == channel.name]:
        best = min(own, key=lambda t: t.p_value)
        y, off = channel.system.residual, np.linalg.norm(np.atleast_2d(channel.gap()), axis=1)[counted(channel)]
        follows = float(np.sqrt(np.mean(off**2) * np.clip(best.gained / max(float(y @ y), 1e-300), 0.0, 1.0)))
        told.append(Remaining(follows, min(1.0, best.p_value * len(own))))
    above = max((r.above_noise for r in told if r.p_value < PLACE_SURE), default=0.0)
    return Remaining(above, min(1.0, len(told) * min(r.p_value for r in told)))


def _of_tracker(channel: TrackerChannel) -> Remaining:
    fit, c = channel.fit, channel.task.campaign
    good = ~outliers(channel)
    off, d_joints, readings = fit.linear.residual[good], fit.linear.d_joints[good], c.readings.take(np.flatnonzero(good))
    freedom = max(3.0 * len(off) - freedom_used(channel.task.layout, fit), 1.0)
    usual, sd = usual_noise(channel.task.repeats)
    p = 0.0
    for level in usual * np.exp(sd * ndtri((np.arange(LEVELS) + 0.5) / LEVELS)):
        S = reading_covariance(readings, c.instrument, Noise(float(level)), d_joints)
        squares = float(np.einsum("ni,ni->", off, np.linalg.solve(S, off[..., None])[..., 0]))
        p += float(chdtrc(freedom, squares)) / LEVELS
    square = float(np.mean(np.sum(off**2, axis=1))) * 3.0 * len(off) / freedom
    own = reading_covariance(readings, c.instrument, Noise(usual), d_joints)
    return Remaining(float(np.sqrt(max(square - np.trace(own, axis1=1, axis2=2).mean(), 0.0))), p)


def _of_rows(channel: Channel) -> Remaining:
    """Whitened rows against unit noise, whose scale is known to `NOISE_TRUST` rows."""
    made = stack((channel,), np.zeros(len(channel.system.residual)))
    freedom = max(float(made.freedom), 1.0)
    ratio = float(made.y @ made.y) / freedom
    gap = channel.gap()[~outliers(channel)]
    square = float(np.mean(np.sum(gap.reshape(len(gap), -1) ** 2, axis=1)))
    return Remaining(float(np.sqrt(max(square * (1.0 - 1.0 / max(ratio, 1.0)), 0.0))), float(fdtrc(freedom, NOISE_TRUST, ratio)))


def kinds_beyond(channel: Channel, held: Sequence[HeldOut], sealed: Any) -> tuple[str, ...]:
    """Kinds of new data of which most of the conditions `sealed` are, and those that the same left-out readings stand for: of
    these one alone has a promise."""
    kinds = _beyond_measured(channel, sealed)
    same = {h.fold.held.tobytes() for h in held if fold_kind(h) in kinds}
    return tuple(dict.fromkeys([*kinds, *(fold_kind(h) for h in held if h.fold.held.tobytes() in same)]))


def _beyond_measured(channel: Channel, sealed: Any) -> tuple[str, ...]:
    """Kinds of new data, as folds are called, of which most of the conditions `sealed` are: later, or warmer or colder.
    A log's folds are of the wheel's temperature."""
    known = getattr(channel, "log", getattr(channel, "readings", None))
    columns, found = ("clock", "wheel_temperature") if hasattr(known, "clock") else ("time", "temperature"), list[str]()
    for kind, column in zip(("later", "another temperature"), columns, strict=True):
        was, asked = getattr(known, column, None), getattr(sealed, column, None)
        if was is not None and asked is not None:
            middle = float(np.nanmedian(asked))
            found += [kind] if middle > np.nanmax(was) or (kind != "later" and middle < np.nanmin(was)) else []
    return tuple(found)


def _shrinkage(
    diagnosis: Diagnosis, before: Channel, after: Channel, held: Sequence[HeldOut], square: float, sealed: Any, shown: bool
) -> tuple[Shrinkage | None, bool]:
    """What to expect, and whether under the conditions `sealed`; square: mean square of the gap before in the channel's unit;
    shown: whether anything is named that this signal shows, else nothing changes."""
    if not shown:
        return (NONE if realised(square, 0.0, after.noise_floor**2) is not None else None), False
    others = seen_by(after.name, _what_may_be(diagnosis) if isinstance(after, TrackerChannel) else diagnosis.alternatives)
    return anticipated_shrinkage(Followed(before, after, others), held, diagnosis.p_beside, None, sealed)


def told_by_readings(channel: Channel) -> bool:
    """Whether left-out readings promise: no model says what lasts of an arm's noise far above what is usual, or of encoders'."""
    return channel.name != "force" and (not isinstance(channel, TrackerChannel) or channel.restless(1.0))


def anticipated_shrinkage(
    found: Followed, held: Sequence[HeldOut], unknown: float, carried: tuple[float, float] | None, sealed: Any
) -> tuple[Shrinkage | None, bool]:
    """What is promised, and whether under the conditions `sealed`: where these say all that the alternatives depend on, and hold
    a gap to speak of. held: folds, that say how much is there under no name where, with probability `unknown`, something is;
    carried: as `from_model` has it. None: no gap to speak of."""
    before, after, others = found.before, found.after, found.others
    if told_by_readings(after):
        return from_folds(held, estimation_variance(after)), False
    asked = _asked_of(after, others, sealed)
    for conditions in [None] if asked is None else [asked, None]:
        if isinstance(before, TrackerChannel) and isinstance(after, TrackerChannel):
            noise = (after.noise_floor / SCALE[after.unit]) ** 2
            told = from_model(anticipated(before, after, others, conditions), held, noise, carried)
        else:
            from ocp.diagnose.force.channel import ForceChannel  # blade and contact: only for those who measured force
            from ocp.diagnose.force.shrinkage import anticipated_grinding, from_grinding

            assert isinstance(before, ForceChannel) and isinstance(after, ForceChannel)
            new = anticipated_grinding(before, after, others, None if conditions is None else after.asked(conditions))
            told = None if new is None else from_grinding(new, after.noise_floor**2, held, unknown, carried)
        if told is not None:
            return told, conditions is not None
    return None, False


def _asked_of(channel: Channel, others: Sequence[Alternative], sealed: Any) -> Any:
    """The conditions, where they say all that the alternatives depend on and the channel shows; else None."""
    effects = [a.effect for one in others for a in one.active if not channel.blind(a.effect)]
    if sealed is None or not effects:
        return None
    if isinstance(channel, TrackerChannel):
        return sealed if all(has_columns(e, sealed) for e in effects) else None
    from ocp.diagnose.force.channel import ForceChannel

    assert isinstance(channel, ForceChannel)
    asked = channel.asked(sealed)
    return sealed if len(asked.there.touching) and all(map(asked.says, effects)) else None


def _what_may_be(diagnosis: Diagnosis) -> tuple[Alternative, ...]:
    """The alternatives; with the probability that something is there under no name, the likeliest beside each kernel that may
    stand for it, fitted together: a name that took the unknown's part is another one then, and the rest goes on."""
    if not diagnosis.patches:
        return diagnosis.alternatives
    first, *others = diagnosis.alternatives
    patches = summing_to(first.probability * diagnosis.p_beside, diagnosis.patches)
    beside = [replace(one, active=unfaded((*first.active, *one.active))) for one in patches]
    return (Alternative(first.probability * (1.0 - diagnosis.p_beside), first.active), *beside, *others)


def promise_by_kind(after: Channel, held: Sequence[HeldOut], told: Shrinkage) -> dict[str, Shrinkage]:
    """The promise by kind of new data, that for another day first. Names chosen on held-out errors are held to other sessions
    where there are some: no model says what of such an arm's noise lasts."""
    kinds = promised_by_kind(held)
    chosen = isinstance(after, TrackerChannel) and told_by_readings(after)
    other = kinds.get("another session") if chosen else None
    return {ANOTHER_DAY: promised_later(told, chosen) if other is None else other} | kinds


def counted(channel: Channel) -> Mask:
    """Readings (n,) that are neither outliers, which are no gap of the model, nor air runs, in which nothing was ground."""
    good = ~outliers(channel)
    contact = channel.conditions.contact
    return good if contact is None or not np.any(contact) else good & np.asarray(contact, bool)


def anticipated(
    before: TrackerChannel, after: TrackerChannel, others: Sequence[Alternative] = (), sealed: Readings | None = None
) -> Anticipated:
    """One group for every payload of the cell and every temperature, or for every payload that the conditions `sealed` carry;
    others: alternatives, the accepted one (which `after` is) first."""
    models = [after.fitted_with(o.active) if o.active else before for o in others] or [after]
    if sealed is not None:
        rows = np.unique(np.linspace(0, len(sealed) - 1, min(len(sealed), ASKED)).astype(np.int64))
        asked = replace(sealed.take(rows), turn=None, sigma_turn=None)
        groups = [_group(before, models, asked.take(asked.payload == k)) for k in np.unique(asked.payload)]
    else:
        readings, groups = _later(after.readings), []
        T = after.readings.temperature
        warmths = [None] if T is None or np.ptp(T) < LEAST_WARMTH else [float(t) for t in np.quantile(T, LATER_WARMTHS)]
        for k in range(len(readings.payloads)):
            for warmth in warmths:
                new = replace(readings, payload=np.full(len(readings), k, np.int64))
                new = new if warmth is None else replace(new, temperature=np.full(len(readings), warmth))
                groups.append(_group(before, models, new))
    told = np.array([o.probability for o in others] or [1.0])
    measured = tuple(after.readings.payloads[k] for k in np.unique(after.readings.payload))
    draws = models[0].background.draws
    return Anticipated(tuple(groups), measured, told / told.sum(), models[0].fit.covariance, draws, sealed is not None)


def _group(before: TrackerChannel, models: Sequence[TrackerChannel], new: Readings) -> NewReadings:
    """Readings `new` about all fits."""
    accepted, c = models[0], models[0].task.campaign
    # Effects of the tracker and of the base act on where the reflector is: predicted, as nobody measured it.
    place = points(c.robot, new, c.instrument, accepted.fit.state)
    new = replace(new, point=place)
    first = channel_about(accepted, new).fit
    J = np.concatenate([first.linear.J, first.extra], axis=2)
    there = [first.linear.point, *(_placed(m, new) for m in models[1:])]
    moved = np.stack(there) - _placed(before, new)
    return NewReadings(new.payloads[int(new.payload[0])], moved, J, np.sum(first.linear.d_joints**2, axis=1))


def _placed(channel: TrackerChannel, new: Readings) -> Array:
    """Where a channel's fit predicts the reflectors of readings `new`, (n, 3) m."""
    task = replace(channel.task, campaign=replace(channel.task.campaign, readings=new))
    return task.points(channel.fit.state, channel.fit.active)


def _later(readings: Readings) -> Readings:
    """New postures after the campaign's end, without loads: the angles of its axes in new combinations. On the campaign's own
    postures a refit has hidden more of an effect than it will hide anywhere else."""
    rng = np.random.default_rng(0)
    rows: Index = np.unique(np.linspace(0, len(readings) - 1, min(len(readings), POSTURES)).astype(np.int64))
    like = readings.take(rows)
    q, approach = like.q.copy(), None if like.approach is None else like.approach.copy()
    for axes in TOGETHER:
        order = rng.permutation(len(rows))
        q[:, axes] = like.q[order][:, axes]
        if approach is not None and like.approach is not None:
            approach[:, axes] = like.approach[order][:, axes]
    target = like.target[rng.permutation(len(rows))]
    new = replace(like, q=q, approach=approach, target=target, turn=None, sigma_turn=None, load=np.zeros((len(rows), 6)))
    if readings.time is None:
        return new
    share = (np.arange(len(rows)) + 1.0) / len(rows)
    return replace(new, time=np.asarray(readings.time.max() + LATER * np.ptp(readings.time) * share))
