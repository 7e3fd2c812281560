"""The patch of what has no name: fitted beside the written names, promised like an effect, predicted with its fading.

New conditions may lie beyond what was measured. There the patch is gone and what it stands for is not: in the promise the truth
goes on as it was at the edge of the range, in a prediction's sigma it is as wide as the prior of the patch's features.
"""

from collections.abc import Iterator, Sequence
from contextlib import suppress
from dataclasses import replace
from typing import Any

import numpy as np

from ocp.diagnose.engine.channel_system import Channel, Sealed
from ocp.diagnose.engine.findings import Alternative, Diagnosis, summing_to
from ocp.diagnose.engine.kernels import conditions_by_name
from ocp.diagnose.foresee.anticipated import anticipated_shrinkage, kinds_beyond, promise_by_kind, remaining, told_by_readings
from ocp.diagnose.foresee.planned_tracker import channel_about
from ocp.diagnose.rules import CARRIED_PATCH, LEADS
from ocp.diagnose.tracker.channel import TrackerChannel
from ocp.diagnose.tracker.refit import usual_noise
from ocp.diagnose.verdict.answer import Followed, Patched
from ocp.diagnose.verdict.diagnosis import errors_of_folds
from ocp.diagnose.verdict.patching import read_beside, unfaded, with_further
from ocp.diagnose.verdict.shrinkage import ANOTHER_DAY, Shrinkage
from ocp.effects.effect import Active, effects_key
from ocp.effects.engine.readings import displaced, has_columns, motion
from ocp.effects.patch import is_patch, lengths_outside
from robots.calibration.residuals import points
from robots.errors import Infeasible
from robots.pose import Array, Mask


def unnamed(diagnosis: Diagnosis, written: Sequence[Active]) -> Followed | None:
    """What is there under no name; None: nothing, or nothing that a patch can hold."""
    if not diagnosis.patches or diagnosis.p_unknown <= LEADS:
        return None
    first = diagnosis.patches[0].active
    before = next(c for c in diagnosis.baseline if c.name == first[0].scanned["signal"])
    try:
        after = with_further(_as_seen(before, tuple(written), first))
    except Infeasible:  # no fit with it comes to rest
        return None
    return Followed(before, after, _others(diagnosis, tuple(written), after))


def _as_seen(before: Channel, written: tuple[Active, ...], patches: tuple[Active, ...]) -> Channel:
    """The channel with written names and patches. A force along the normal shows in the tangential reading too, as friction has
    it; where that is measured and fits without it better, the patches are of the normal reading alone."""
    after = before.with_active((*written, *patches))
    if isinstance(before, TrackerChannel) or any(one.scanned["source"] != "force" for one in patches):
        return after
    from ocp.diagnose.force.channel import ForceChannel  # blade and contact: only for those who measured force

    if not isinstance(after, ForceChannel) or after.log.ft is None:
        return after
    with suppress(Infeasible):  # no fit with it comes to rest
        beside = before.with_active((*written, *(read_beside(one) for one in patches)))
        assert isinstance(beside, ForceChannel)
        return min((after, beside), key=lambda one: one.squares(after.fit.whiteners))
    return after


def patched(found: Followed, named: Shrinkage | None, sealed: Any = None) -> Patched | None:
    """The patch that does no harm and promises more than the written names alone (`named`: what they promise). None: the low end
    of its promise is not above zero; or it is asked for beyond what was measured, and readings left out as far beyond do not say
    that it helps: in the promise the truth goes on as at the edge, which what settles, or warms up anew, does not. Where left-out
    readings promise, evidence, which chose its kernels, is worth little: there it is to help on another day, and whatever kind of
    condition was left out (a patch of ur10_two_series over all that it holds: 11 % promised, 23 % worse)."""
    held, chosen = errors_of_folds([found.after], found.after.active)[found.after.name], told_by_readings(found.after)
    promise, asked = anticipated_shrinkage(found, held, 1.0, CARRIED_PATCH, sealed)
    if promise is None or promise.low <= 0.0 or (named is not None and promise.predicted <= named.predicted):
        return None
    kinds = promise_by_kind(found.after, held, promise)
    judged = kinds if chosen else kinds_beyond(found.after, held, sealed) if asked else ()
    if any(k in kinds and kinds[k].predicted <= 0.0 for k in judged) or (chosen and kinds[ANOTHER_DAY].low <= 0.0):
        return None
    return Patched(found.after, promise, found.others[1:], asked, kinds)


def _others(diagnosis: Diagnosis, written: tuple[Active, ...], after: Channel) -> tuple[Alternative, ...]:
    """What may be true: the patches as they stand beyond the range as well, other kernels in their place, or names without any.
    The first is what is written: as patches fade, it is true nowhere; the last is nothing beside the written names."""
    likeliest, *others = summing_to(diagnosis.p_unknown, diagnosis.patches)
    beside = any(is_patch(a.effect) and a.scanned["source"] == "sensor" for a in after.active)

    def seen(patches: Sequence[Active]) -> tuple[Active, ...]:
        forces = [beside and one.scanned["source"] == "force" for one in patches]
        return tuple(read_beside(one) if force else one for one, force in zip(patches, forces, strict=True))

    first = replace(likeliest, active=unfaded(after.active))
    rest = [replace(one, active=unfaded((*written, *seen(one.active)))) for one in others]
    known = 1.0 - diagnosis.p_unknown
    names = [Alternative(known * one.probability, one.active) for one in diagnosis.instead if one.active]
    nothing = Alternative(known * sum(one.probability for one in diagnosis.instead if not one.active), written)
    return (Alternative(0.0, after.active), first, *rest, *names, nothing)


def beyond(channel: Channel, patches: Sequence[Active], sealed: Any) -> tuple[Array, Mask]:
    """Variance (n, k) SI^2 of what the patches leave open where they fade, and whether (n,) every condition of theirs lies in its
    measured range; `sealed`: conditions. Where these lack a column the usual size of a patch is in the predictions' sigma."""
    told = list((_of_points if isinstance(channel, TrackerChannel) else _of_forces)(channel, patches, sealed))
    open_, inside = np.zeros((len(sealed), 1)), np.full(len(sealed), len(told) == len(patches))
    for outside, usual in told:
        open_ = open_ + (1.0 - np.exp(-(outside**2)))[:, None] * usual
        inside &= np.asarray(outside == 0.0)
    return open_, inside


def _of_points(channel: Channel, patches: Sequence[Active], sealed: Any) -> Iterator[tuple[Array, Array]]:
    """Of every patch that the conditions tell: how far (n,) they lie outside, in the lengths of its features, and the variance
    (n, 3) m^2 of its prior there."""
    assert isinstance(channel, TrackerChannel)
    c = channel.task.campaign
    new = replace(sealed, turn=None, sigma_turn=None)
    about = channel_about(channel, replace(new, point=points(c.robot, new, c.instrument, channel.fit.state)))
    for one in unfaded(patches):
        if has_columns(one.effect, sealed):
            middle = one.scanned.get("about", (0.0,))[0]
            columns = displaced(motion(one.effect, one.joint, [one.scanned], about.seen), about.fit.linear.d_joints)[0]
            usual = np.sum((columns * np.asarray(one.effect.prior_sd)) ** 2, axis=2)
            yield lengths_outside(one, conditions_by_name(about.conditions, channel.task.reference, middle)), usual


def _of_forces(channel: Channel, patches: Sequence[Active], sealed: Any) -> Iterator[tuple[Array, Array]]:
    """The same of a force log, the variance (n, 1) N^2 as it is in the log on average."""
    from ocp.diagnose.force.channel import ForceChannel, logged_conditions  # blade and contact: only for those who measured force

    assert isinstance(channel, ForceChannel)
    asked, named = channel.asked(sealed), {one.key for one in patches}
    reference = channel.problem.scene.cell.tables.reference_temperature_C
    conditions = conditions_by_name(logged_conditions(channel.problem, sealed, asked.there.conditions), reference)
    usual, place = np.mean(channel.fit.normal[channel.log.contact] ** 2, axis=0), sum(channel.problem.sizes)
    for one in channel.active:
        here, place = slice(place, place + one.effect.size), place + one.effect.size
        if one.key in named and asked.says(one.effect):
            shown = sealed.contact | (one.scanned["source"] == "sensor")  # which reads in the air too
            yield lengths_outside(unfaded([one])[0], conditions), shown[:, None] * float(usual[here].sum())


def beside_unknown(told: Sealed, found: Followed, sealed: Any, known: Sequence[Alternative]) -> Sealed:
    """Predictions by the written names, sigma with what is there under no name, or under names that are not in it yet (`known`:
    alternatives that are)."""
    variance, counted = told.sigma**2, {effects_key(one.active): one.probability for one in known}
    shares = [(one.probability - counted.get(effects_key(one.active), 0.0), one.active) for one in found.others]
    for share, other in predictions(found.after, sealed, [Alternative(share, active) for share, active in shares if share > 0]):
        more = np.maximum(other.sigma**2 - told.sigma**2, 0.0)  # what the conditions lack for it
        variance = variance + share * ((other.corrected - told.corrected) ** 2 + more)
    return replace(told, sigma=np.sqrt(variance))


def predictions(channel: Channel, sealed: Any, listed: Sequence[Alternative]) -> Iterator[tuple[float, Sealed]]:
    """By the alternatives with which a fit comes to rest, with their probabilities."""
    for one in listed:
        with suppress(Infeasible):
            yield one.probability, channel.predict(sealed, one.active)


def _stays(channel: Channel) -> float:
    """Mean square (SI^2, of the reading's size) that surely stays above the noise; of tracker readings as far as noise of joints
    beyond the usual stands for it: of an instrument worse than stated nothing is there in what is noise-free."""
    square = remaining(channel, ()).above_noise ** 2
    if not isinstance(channel, TrackerChannel):
        return square
    more = channel.fit.noise.joints**2 - usual_noise(channel.task.repeats)[0] ** 2
    return min(square, max(more, 0.0) * float(np.mean(np.sum(channel.fit.linear.d_joints**2, axis=(1, 2)))))


def with_patch(told: Sealed, found: Patched, sealed: Any) -> Sealed:
    """Predictions with those of the patch beside them; sigma holds what may stand in its place, what it leaves open, and is on
    average at least what surely stays above the noise of the readings that the patch was fitted to: it follows the unknown no
    closer elsewhere. Of that the joints' errors that last, which sigma has already, are a part."""
    main = found.channel.predict(sealed, found.channel.active)
    variance = main.sigma**2
    for probability, other in predictions(found.channel, sealed, found.others):
        variance = variance + probability * (other.corrected - main.corrected) ** 2
    open_, inside = beyond(found.channel, found.patches, sealed)
    variance = variance + open_
    variance = variance + max(_stays(found.channel) / main.sigma.shape[1] - float(np.mean(variance)), 0.0)
    lacking = (*told.lacking, *(one.effect.title for one in found.patches if one.effect.name in main.lacking))
    return replace(told, lacking=lacking, patched=main.corrected, patched_sigma=np.sqrt(variance), inside=inside)
