"""What is kept of a set of accepted effects: its fit to all readings, its folds, and what speaks against it."""

from collections.abc import Sequence
from dataclasses import dataclass

from ocp.diagnose.engine.findings import Name
from ocp.diagnose.engine.problem import Problem
from ocp.diagnose.engine.system import Channel, HeldOut, kinds
from ocp.diagnose.verdict.unknown import cancelling, implausible, impostors, relieving
from ocp.effects.effect import Active
from robots.errors import Infeasible
from robots.pose import Array

Spoken = tuple[tuple[Name, str], ...]  # names with what is wrong


@dataclass(frozen=True)
class Judgement:
    """Effects of the corrected model with the channels and folds that hold them; doubts; impostors with the fold where they hurt;
    hurt: whether some were found here (not refused before); relieved: the set meets no reading better, so nothing is kept."""

    kept: tuple[Active, ...]
    channels: tuple[Channel, ...]
    held_out: dict[str, tuple[HeldOut, ...]]
    doubts: Spoken
    impostors: Spoken
    hurt: bool
    relieved: bool


def judged(
    baseline: tuple[Channel, ...],
    problem: Problem,
    channels: tuple[Channel, ...],
    active: tuple[Active, ...],
    signatures: Sequence[Array],
    folds: bool,
    refused: Sequence[tuple[Name, str]] | None,
) -> Judgement:
    """Judge the effects active in `channels`, whose signatures are (N,) each; refused: impostors where names were chosen by
    held-out errors already, so that none are sought."""
    held = held_out(channels, active) if folds and active else {}
    false = impostors(channels, active, held) if refused is None else []
    relief = relieving(channels, active)
    doubts = (*relief, *implausible(active), *cancelling([Name(*a.key) for a in active], signatures))
    kept = active
    if relief:  # nothing that was measured would be met better
        kept, channels, held = (), baseline, {}
    elif false:  # what hurts stays out of the corrected model
        kept = tuple(a for a in active if Name(*a.key) not in {n for n, _ in false})
        without = accepted(baseline, problem, kept)
        kept, channels = ((), baseline) if without is None else (kept, without)
        held = held_out(channels, kept) if kept else {}
    return Judgement(kept, channels, held, doubts, tuple(false if refused is None else refused), bool(false), bool(relief))


def accepted(baseline: Sequence[Channel], problem: Problem, active: tuple[Active, ...]) -> tuple[Channel, ...] | None:
    """Channels of all readings with the effects active; those of the search where they are that already; None where no fit with
    them comes to rest."""
    found = []
    for whole, searched in zip(baseline, problem.channels, strict=True):
        visible = tuple(a for a in active if not whole.blind(a.effect))
        same = kinds(searched.active) == kinds(visible) and len(searched.gap()) == len(whole.gap())
        try:
            found.append(searched if same else whole.with_active(active))
        except Infeasible:
            return None
    return tuple(found)


def held_out(channels: Sequence[Channel], active: tuple[Active, ...]) -> dict[str, tuple[HeldOut, ...]]:
    """Every fold of every channel that can be judged."""
    judged = {c.name: [c.held_out(fold, active) for fold in c.folds()] for c in channels}
    return {name: tuple(h for h in found if h is not None) for name, found in judged.items()}
