"""When a named effect is not believed: values no machine shows, terms that cancel each other, and impostors.

An impostor helps where readings lie among those it was fitted to, and where a condition was left out it hurts and its value is
another. What speaks against a name moves its probability to 'none of these'. So does a set that explains no reading, only why the
registration is not where it was believed to be. `judged` says what stays in the corrected model.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Protocol, runtime_checkable

import numpy as np

from ocp.diagnose import rules
from ocp.diagnose.engine.channel_system import Channel, HeldOut, effects_key
from ocp.diagnose.engine.findings import Name
from ocp.diagnose.engine.linearisation import Linearisation, positive_of
from ocp.effects.effect import Active
from robots.errors import Infeasible
from robots.pose import Array


def implausible(active: Sequence[Active]) -> list[tuple[Name, str]]:
    """Names with values over three times the range, two standard errors sure, with what is wrong."""
    found = []
    for one in active:
        upper = np.asarray(one.effect.prior_sd, float)
        sd = np.sqrt(np.maximum(np.diag(one.covariance), 0.0))
        if (np.abs(one.a) - rules.IMPLAUSIBLE_SD * sd > rules.IMPLAUSIBLE * upper).any():
            found.append((Name(*one.key), "its value is over three times what real cells show"))
        for a, s, positive, key in zip(one.a, sd, positive_of(one.effect), one.effect.coefficients, strict=True):
            if positive and a < -rules.WRONG_SIGN_SD * s:
                name = one.effect.parameters[0].key if key == "share" else key
                found.append((Name(*one.key), f"{name} comes out with the wrong sign"))
        why = one.effect.doubt(one.a, sd, one.scanned) if one.effect.doubt else ""
        if why:
            found.append((Name(*one.key), why))
    return found


def cancelling(names: Sequence[Name], signatures: Sequence[Array]) -> list[tuple[Name, str]]:
    """Pairs of effects whose signatures (N,) all but cancel: each stands for what the other overdoes."""
    found = []
    for i in range(len(names)):
        for k in range(i):
            a, b = signatures[i], signatures[k]
            if np.linalg.norm(a + b) < rules.CANCELS * min(np.linalg.norm(a), np.linalg.norm(b)):
                found.append((names[i], f"it all but cancels {names[k]}"))
    return found


@runtime_checkable
class Registered(Protocol):
    """A channel that knows how far its own registration had to go from what was believed of it."""

    def gained(self) -> tuple[float, float]:
        """Squares that the active effects take from the whitened readings, and from the unknowns of the registration."""


def relieving(channels: Sequence[Channel], active: tuple[Active, ...]) -> list[tuple[Name, str]]:
    """Names of a set that explains hardly any reading and merely brings the registration nearer to what was believed, with what
    is wrong. Readings that a registration meets, but only one nobody believes, are as likely a belief that does not hold, or an
    effect outside the catalogue that acts like one. Not asked where another channel sees the effects too, nor of effects of the
    arm: where the arm is is what they change."""
    found = list[tuple[Name, str]]()
    for channel in channels:
        visible = [a for a in active if not channel.blind(a.effect)]
        elsewhere = any(not other.blind(a.effect) for a in visible for other in channels if other is not channel)
        if not visible or elsewhere or any(a.effect.on_arm for a in visible) or not isinstance(channel, Registered):
            continue
        readings, registration = channel.gained()
        both = readings + registration
        if registration > 0 and both > rules.RELIEF_LEAST and readings < rules.RELIEF * both:
            why = "readings are met hardly better with it, the registration is only nearer to what was believed"
            found += [(Name(*a.key), why) for a in visible]
    return found


def impostors(
    channels: Sequence[Channel], active: tuple[Active, ...], held: Mapping[str, Sequence[HeldOut]]
) -> list[tuple[Name, str]]:
    """Effects without which the readings of a left-out condition are met better, with the fold that says so."""
    found = []
    for channel in channels:
        folds = [h for h in held.get(channel.name, ()) if h.fold.extrapolates]
        for i, one in enumerate(active):
            if channel.blind(one.effect):
                continue
            rest = active[:i] + active[i + 1 :]
            for h in folds:
                try:
                    other = channel.held_out(h.fold, rest) if rest else None
                except Infeasible:  # nothing fits without it: no impostor
                    break
                without = h.before_rows if other is None else other.after_rows
                drifts = not h.drift or h.drift[one.key] > rules.DRIFTS_SD
                if drifts and hurts(h.after_rows, without, h.noise, h.estimation):
                    found.append((Name(*one.key), h.fold.name))
                    break
    return found


def hurts(with_rows: Array, without_rows: Array, noise: float, estimation: float) -> bool:
    """Whether squared errors (r,) are larger with an effect than without, surely, by more than a little of the gap and by more
    than what its value's uncertainty on the rest (estimation) excuses."""
    change = with_rows - without_rows
    error = float(change.std(ddof=1) / np.sqrt(len(change))) if len(change) > 1 else np.inf
    gap = max(float(without_rows.mean()) - noise, rules.NO_GAP**2 * noise)
    return bool(
        change.mean() > rules.HURTS * gap
        and change.mean() > rules.HURTS_SD * (error + estimation)
        and with_rows.mean() > noise * (1 + rules.NO_GAP**2)
    )


Spoken = tuple[tuple[Name, str], ...]  # names with what is wrong


@dataclass(frozen=True)
class Judgement:
    """Effects of the corrected model with the channels and folds that hold them; doubts; impostors with the fold where they hurt;
    hurt: whether some were found here (not refused before); relieved: the set meets no reading better, so no effect remains."""

    remaining: tuple[Active, ...]
    channels: tuple[Channel, ...]
    held_out: dict[str, tuple[HeldOut, ...]]
    doubts: Spoken
    impostors: Spoken
    hurt: bool
    relieved: bool


def judged(
    baseline: tuple[Channel, ...],
    problem: Linearisation,
    channels: tuple[Channel, ...],
    active: tuple[Active, ...],
    signatures: Sequence[Array],
    folds: bool,
    refused: Sequence[tuple[Name, str]] | None,
) -> Judgement:
    """Judge the effects active in `channels`, whose signatures are (N,) each; refused: impostors where names were chosen by
    held-out errors already, so that none are sought."""
    held = errors_of_folds(channels, active) if folds and active else {}
    false = impostors(channels, active, held) if refused is None else []
    relief = relieving(channels, active)
    doubts = (*relief, *implausible(active), *cancelling([Name(*a.key) for a in active], signatures))
    remaining = active
    if relief:  # nothing that was measured would be met better
        remaining, channels, held = (), baseline, {}
    elif false:  # what hurts stays out of the corrected model
        remaining = tuple(a for a in active if Name(*a.key) not in {n for n, _ in false})
        without = refitted(baseline, problem, remaining)
        remaining, channels = ((), baseline) if without is None else (remaining, without)
        held = errors_of_folds(channels, remaining) if remaining else {}
    return Judgement(remaining, channels, held, doubts, tuple(false if refused is None else refused), bool(false), bool(relief))


def refitted(baseline: Sequence[Channel], problem: Linearisation, active: tuple[Active, ...]) -> tuple[Channel, ...] | None:
    """Channels of all readings with the effects active; those of the search where they are that already; None where no fit with
    them comes to rest."""
    found = []
    for whole, searched in zip(baseline, problem.channels, strict=True):
        visible = tuple(a for a in active if not whole.blind(a.effect))
        same = effects_key(searched.active, 2) == effects_key(visible, 2) and len(searched.gap()) == len(whole.gap())
        try:
            found.append(searched if same else whole.with_active(active))
        except Infeasible:
            return None
    return tuple(found)


def errors_of_folds(channels: Sequence[Channel], active: tuple[Active, ...]) -> dict[str, tuple[HeldOut, ...]]:
    """Every fold of every channel that can be judged."""
    judged = {c.name: [c.held_out(fold, active) for fold in c.folds()] for c in channels}
    return {name: tuple(h for h in found if h is not None) for name, found in judged.items()}
