"""From a data set to its answer, and the answer to its folder.

One channel for every signal that was measured, the diagnosis, blind predictions of sealed conditions row by row in their
order (FORMATS, "What the software writes"), the report. The latter is drawn by a second process that gets ready while this
one diagnoses: matplotlib takes a second to import and a second to draw, on a second core neither is waited for. With one core
the page is made here, after the rest.
"""

import re
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, cast

import numpy as np
from threadpoolctl import threadpool_limits

from ocp.diagnose.corrected import write_corrected_cell
from ocp.diagnose.dataset import SEALED, DataSet, blinds, read_data_set, read_sealed, told_beyond
from ocp.diagnose.document import document_of, json_text
from ocp.diagnose.engine.channel_system import SCALE, Channel, ReadingConditions, Sealed, needs_motion
from ocp.diagnose.engine.findings import Alternative, Diagnosis
from ocp.diagnose.foresee.anticipated import signal_gap
from ocp.diagnose.foresee.next_experiment import next_experiments
from ocp.diagnose.foresee.patched import beside_unknown, patched, predictions, unnamed, with_patch
from ocp.diagnose.joints.channel import JointChannel, joint_channel
from ocp.diagnose.report.verdict_sentence import diagnosis_headline, not_written, told_as
from ocp.diagnose.rules import LEADS, OFF_AS_CALIBRATED
from ocp.diagnose.tracker.channel import TrackerChannel
from ocp.diagnose.tracker.refit import believed_baseline
from ocp.diagnose.verdict.answer import Answer, SignalGap, known_beside, promised
from ocp.diagnose.verdict.diagnosis import diagnose_channels
from ocp.diagnose.verdict.patching import seen_by
from ocp.effects.catalogue import library
from ocp.effects.effect import Active, Effect, effects_key
from ocp.effects.patch import PATCH
from ocp.model.cell import files_of
from ocp.shell.cache import sha256
from ocp.shell.output import reserved
from ocp.shell.processes import cores, interrupts_held_back, nothing, warmed, workers
from ocp.shell.progress import Phases
from robots.calibration.mistakes import refuse_mistakes
from robots.calibration.solver import Campaign
from robots.errors import BadInput, Infeasible
from robots.inverse import planned_family
from robots.pose import Array


def channels_of(data: DataSet, phases: Phases) -> list[Channel]:
    """Channels in the order tracker, force, joint, the believed cell fitted to each. Raises BadInput of every part."""
    found: list[Channel] = []
    if data.readings is not None:
        with phases.phase("tracker"):
            found.append(tracker_channel(data))
    if data.log is not None:
        with phases.phase("force"):
            from ocp.diagnose.force.channel import force_channel  # blade and contact: only for those who measured force

            assert data.cell is not None
            # Not the readings: what an effect explains in them must leave the arm that the log is fitted with.
            tracker = next((one for one in found if isinstance(one, TrackerChannel)), None)
            found.append(force_channel(data.cell, data.log, tracker))
    if data.joints is not None:
        with phases.phase("joints"):
            stated = data.setup.tables.robot.stiffness_Nm_per_rad is not None  # believed more than a catalogue's
            found.append(joint_channel(data.joints, data.setup.robot, data.setup.hanging, stated, data.believed_by("joint")))
    return found


def tracker_channel(data: DataSet) -> TrackerChannel:
    """The believed arm refitted to the readings. Raises BadInput: readings that are a mistake, or that place nothing."""
    setup, readings = data.setup, data.readings
    assert readings is not None
    campaign = Campaign(setup.robot, readings, setup.payloads, setup.instrument)
    try:
        refuse_mistakes(campaign)
        task, fit = believed_baseline(
            campaign, setup.compliant_joints, setup.tables.reference_temperature_C, data.believed_by("tracker")
        )
    except np.linalg.LinAlgError:
        raise BadInput(
            f"{readings.path}: the readings leave something open that no prior holds, as the tracker's turn; measure more "
            "postures, with all axes moved, and give the nests' places in [tracker.targets]"
        ) from None
    return TrackerChannel(task, fit, known=setup.calibration)


def of_another_arm(channels: Sequence[Channel]) -> Iterator[str]:
    """A sentence where the cell's own calibration misses the readings by far more than it told of those left out of its own."""
    for one in (c for c in channels if isinstance(c, TrackerChannel) and c.one_arm is False):
        yield (
            f"{one.readings.path.name}: the cell's calibration misses these readings by over {OFF_AS_CALIBRATED:g} times what it "
            "missed readings left out of its own by: what is named came since, or the arm is another one, or was mastered anew"
        )


def beside_others(written: Sealed, parts: Sequence[tuple[float, Sealed]]) -> Sealed:
    """Predictions of what is written, sigma with what several alternatives, by their probabilities, differ from it."""
    total = sum(p for p, _ in parts)
    variance = sum(p * (s.sigma**2 + (s.corrected - written.corrected) ** 2) for p, s in parts) / total
    lacking = tuple(dict.fromkeys(name for _, s in parts for name in s.lacking if not name.startswith(PATCH)))
    return replace(written, sigma=np.sqrt(variance), lacking=lacking)


def columns_predicted(answer: Answer, signal: str) -> tuple[tuple[str, ...], float]:
    """Columns of a signal's predictions, and their unit per SI unit."""
    if signal in PREDICTED:
        return PREDICTED[signal]
    channel = next(c for c in answer.diagnosis.channels if isinstance(c, JointChannel))
    return tuple(f"link{j}_deg" for j in channel.problem.noise), float(np.degrees(1.0))


def write_predictions(path: Path, predicted: tuple[tuple[str, ...], float], sealed: Sealed) -> None:
    """Of a signal, x, y, z in mm, fn in N or link sides in degrees: the baseline, the corrected model and its one sigma, the
    same two with the patch (the corrected ones where there is none), whether all that the patch, or a log of link encoders,
    varies with was measured; sealed holds SI. A tangential column of a force channel is left out."""
    columns, factor = predicted
    kinds = {"baseline": sealed.baseline, "corrected": sealed.corrected, "sigma": sealed.sigma}
    kinds["patched"] = sealed.corrected if sealed.patched is None else sealed.patched
    kinds["patched_sigma"] = sealed.sigma if sealed.patched_sigma is None else sealed.patched_sigma
    inside = np.ones(len(sealed.sigma), bool) if sealed.inside is None else sealed.inside
    rows = factor * np.hstack([np.asarray(values).reshape(len(values), -1)[:, : len(columns)] for values in kinds.values()])
    head = ",".join([*(f"{kind}_{c}" for kind in kinds for c in columns), "inside"])
    forms = ["%.5f"] * rows.shape[1] + ["%d"]
    np.savetxt(path, np.column_stack([rows, inside]), forms, ",", header=head, comments="", encoding="utf-8")


PREDICTED = {"tracker": (("x_mm", "y_mm", "z_mm"), 1e3), "force": (("fn_N",), 1.0)}
_CANNOT = re.compile(r"(?P<why>.*): (?P<effect>\w+) cannot be seen")


def answer_of(folder: Path, phases: Phases, known: dict[str, Effect] | None = None, columns: Path | None = None) -> Answer:
    """Diagnose a folder with the effects `known` (default: all); columns: a mapping file. Shrinkage is predicted for the sealed
    conditions, where there are any. Raises BadInput: a file that is malformed."""
    known = library() if known is None else known
    with phases.phase("reading"):
        data = read_data_set(folder, columns)
        asked = {signal: read_sealed(data, signal) for signal in data.sealed}
    channels = channels_of(data, phases)
    with phases.phase("diagnosis"):
        found = diagnose_channels(channels, with_either_sign(known, data.believed))
    with phases.phase("next"):
        gaps = tuple(signal_gap(found, b, a, asked.get(b.name)) for b, a in zip(found.baseline, found.channels, strict=True))
        experiments = next_experiments(found, known)
    told = [n for channel in channels for n in getattr(getattr(channel, "problem", None), "notices", ())]
    told += [n for channel in found.channels for n in getattr(channel, "surprises", ())]
    blind = tuple(dict.fromkeys((*(n for n in told if blinds(n)), *data.blind, *grouped(found.blind))))
    notices = tuple(dict.fromkeys((*data.notices, *of_another_arm(channels), *(n for n in told if not blinds(n)))))
    written, fitted = _at_rest(found, promised(found, gaps))
    patch = None
    with phases.phase("patch"):
        if (unknown := unnamed(found, written)) is not None:
            unknown = replace(unknown, after=_knowing((unknown.after,), found.channels, written)[0])
            gap = next(g for g in gaps if g.name == unknown.after.name)
            if not gap.elsewhere:
                patch = patched(unknown, gap.shrinkage if written else None, asked.get(gap.name))
    return Answer(data, found, gaps, experiments, blind, notices, dict(phases.seconds), asked, written, fitted, unknown, patch)


def _at_rest(found: Diagnosis, written: tuple[Active, ...]) -> tuple[tuple[Active, ...], tuple[Channel, ...]]:
    """The effects that are to be written and the channels with them and no others; where no fit with them comes to rest none."""
    if effects_key(written) == effects_key(found.active):
        return written, _knowing(found.channels, found.channels, written)
    with suppress(Infeasible):
        fitted = tuple(c.with_active(written) if written else c for c in found.baseline)
        return written, _knowing(fitted, fitted, written)
    return (), found.baseline


def _knowing(some: tuple[Channel, ...], channels: Sequence[Channel], written: tuple[Active, ...]) -> tuple[Channel, ...]:
    """Some of the channels, or such with patches, that predict with effects at the sizes that are written, where they see those
    only in part."""
    known = known_beside("force", channels, written)
    return tuple(cast(Channel, replace(cast(Any, c), known=known)) if c.name == "force" else c for c in some)


def with_either_sign(known: dict[str, Effect], believed: Sequence[Active]) -> dict[str, Effect]:
    """Effects with those that the cell believes free in sign: what comes on top of a belief may lessen it."""
    free = {a.effect.name for a in believed} & known.keys()
    return known | {n: replace(known[n], parameters=tuple(replace(p, signed=True) for p in known[n].parameters)) for n in free}


def grouped(blind: Sequence[str]) -> list[str]:
    """Sentences 'WHY: EFFECT cannot be seen' with the same reason as one; effects of a signal that was not measured are left
    out, that signal is named already."""
    reasons: dict[str, list[str]] = {}
    for sentence in blind:
        if (told := _CANNOT.fullmatch(sentence)) and not needs_motion(told["why"]):
            reasons.setdefault(told["why"], []).append(told["effect"])
    return [f"{why}: {', '.join(names)} cannot be seen" for why, names in reasons.items()]


def predict_sealed(answer: Answer) -> dict[str, Sealed]:
    """Blind predictions by signal, the effects that are written in the corrected ones, what else may be true in their sigma.
    Raises BadInput: sealed conditions off the blade."""
    found: dict[str, Sealed] = {}
    told = answer.diagnosis.alternatives or (Alternative(1.0, answer.diagnosis.active),)
    for signal, sealed in answer.asked.items():
        channel = next(c for c in answer.diagnosis.channels if c.name == signal)
        first, *others = seen_by(signal, told)
        # Both as they were fitted, each with the readings that it sets aside: the baseline, and the cell that is written.
        baseline, kept = (
            next(c for c in some if c.name == signal).predict(sealed, active)
            for some, active in ((answer.diagnosis.baseline, ()), (answer.fitted, answer.written))
        )
        same = effects_key(first.active) == effects_key(answer.written)
        likeliest = first.probability, kept if same else channel.predict(sealed, first.active)
        made = [likeliest, *predictions(channel, sealed, others)]
        written = replace(beside_others(kept, made), baseline=baseline.corrected)
        found[signal] = replace(written, named=made[0][1].corrected, beyond=told_beyond(answer.data, signal, sealed))
        if answer.unknown is not None and signal == answer.unknown.after.name:
            found[signal] = beside_unknown(found[signal], answer.unknown, sealed, told)
            if answer.patch is not None:
                found[signal] = with_patch(found[signal], answer.patch, sealed)
        elif answer.unknown is None and signal != "joint" and answer.diagnosis.p_unknown > LEADS:
            found[signal] = as_wide_as_left(found[signal], next(gap for gap in answer.gaps if gap.name == signal))
    return found


def as_wide_as_left(told: Sealed, gap: SignalGap) -> Sealed:
    """Predictions with what no patch can hold, as what differs by run, session or a joint's own state: in the next ones it may be
    as much. Of a tracker's it is there in part, where all joint noise beyond the usual lasts."""
    left = (gap.remaining.above_noise / SCALE[gap.unit]) ** 2 / told.sigma.shape[1]
    more = left - (float(np.mean(told.sigma**2)) if gap.name == "tracker" else 0.0)
    return replace(told, sigma=np.sqrt(told.sigma**2 + max(more, 0.0)))


def left_out(sealed: dict[str, Sealed]) -> list[str]:
    """Sentences on conditions beyond all measured ones, and on effects that are not in the predictions of sealed conditions."""
    return [one for told in sealed.values() for one in told.beyond] + [
        f"{SEALED[signal]} lacks a column that {', '.join(told.lacking)} depends on: not in the corrected predictions, its "
        "usual size is in their sigma"
        for signal, told in sealed.items()
        if told.lacking
    ]


@dataclass(frozen=True)
class DiagnosisResult:
    """A diagnosis that was written: its folder, the answer, blind predictions by signal, and the one line that says what was
    found."""

    folder: Path
    answer: Answer
    sealed: dict[str, Sealed]
    line: str

    @property
    def notices(self) -> tuple[str, ...]:
        """What the user should know of the data, and what they cannot show."""
        return (*self.answer.notices, *self.answer.blind, *left_out(self.sealed))


@threadpool_limits.wrap(limits=1, user_api="blas")  # threads only fight over matrices as small as these
def write_diagnosis(folder: Path, out: Path, overwrite: bool, phases: Phases, columns: Path | None = None) -> DiagnosisResult:
    """Diagnose a data set folder and write the answer's folder; columns: the mapping file of its tables.

    Raises BadInput and Infeasible of every part; then `out` is as it was.
    """
    inputs = [folder, *(files_of(folder / "cell.toml") if (folder / "cell.toml").is_file() else [])]
    inputs += [] if columns is None else [columns]
    with reserved(out, overwrite, inputs) as output, drawn_beside() as draw:
        out = output.named
        answer = answer_of(folder, phases, columns=columns)
        page = draw(answer, {p.name: sha256(p) for p in answer.data.inputs})
        with phases.phase("predictions"):
            sealed = predict_sealed(answer)
        with output.whole() as made:
            with phases.phase("writing"):
                (made / "diagnosis.json").write_text(json_text(document_of(answer)), encoding="utf-8")
                for signal, told in sealed.items():
                    name = SEALED[signal].replace("sealed", "predictions")
                    write_predictions(made / name, columns_predicted(answer, signal), told)
                write_corrected_cell(made, out, answer)
            with phases.phase("report"):
                (made / "report.html").write_bytes(page())
    return DiagnosisResult(out, answer, sealed, last_line(answer, out))


def last_line(answer: Answer, out: Path) -> str:
    """What was found, and where it stands."""
    head, kept = diagnosis_headline(answer), not_written(answer)
    safe = "" if kept and not answer.corrections else f"; {_safe(answer, out)}"
    told = f". {kept.rstrip('.')}{safe}" if kept else f".{safe[1:]}"
    return f"{out}: {head.verdict} {head.sentence.rstrip('.')}{told}; {out / 'report.html'} shows why."


def _safe(answer: Answer, out: Path) -> str:
    """What may be relied on."""
    if answer.patch is not None:
        told = "what is known, and a patch for the rest" if answer.written else "a patch for it"
        return f"{out / 'corrected_cell.toml'} holds {told}, which explains nothing and fades outside what was measured"
    if told_as(answer.diagnosis) == "ambiguous" and not answer.written:
        return f"{out / 'corrected_cell.toml'} corrects nothing of it; measure what the report asks for"
    # What depends on a recording's past is in no plan, and for some arms there is none.
    planned = planned_family(answer.data.setup.robot) is not None and any(one.effect.along is None for one in answer.written)
    return {
        "explained": f"{out / 'corrected_cell.toml'} {'plans with it' if planned else 'holds it, which no plan can act on'}",
        "ambiguous": f"{out / 'corrected_cell.toml'} holds the likeliest; measure what the report asks for before relying on it",
        "partly": f"{out / 'corrected_cell.toml'} holds what is known",
        "unexplained": "Do not rely on the believed cell there",
        "no_gap": f"Fitted to these data the believed cell stands: {out / 'corrected_cell.toml'}",
    }[told_as(answer.diagnosis)]


Page = Callable[[], bytes]
"""Gives the page's bytes, and waits for them where it must."""


@dataclass(frozen=True)
class Shown:
    """What a report shows of a force channel. The channel itself holds blade and contact of every row, 300 MB of a long log, and
    would be handed over for seconds."""

    name: str
    unit: str
    conditions: ReadingConditions
    noise_floor: float
    residual: Array
    active: tuple[Active, ...]

    def gap(self) -> Array:
        """Residuals (n, k) SI."""
        return self.residual


def lean(answer: Answer) -> Answer:
    """An answer with no more of its channels than the report shows."""
    gaps = tuple(replace(gap, baseline=_shown(gap.baseline), corrected=_shown(gap.corrected)) for gap in answer.gaps)
    patch = None if answer.patch is None else replace(answer.patch, channel=_shown(answer.patch.channel))
    found = replace(answer.diagnosis, baseline=tuple(g.baseline for g in gaps), channels=tuple(g.corrected for g in gaps))
    return replace(answer, gaps=gaps, diagnosis=found, asked=dict.fromkeys(answer.asked), fitted=(), unknown=None, patch=patch)


def _shown(channel: Channel) -> Channel:
    if isinstance(channel, TrackerChannel):
        return replace(channel, store={})
    if channel.name != "force":
        return channel
    conditions = replace(channel.conditions, waves=(), pressed=None)
    return cast(Channel, Shown(channel.name, channel.unit, conditions, channel.noise_floor, channel.gap(), channel.active))


@contextmanager
def drawn_beside() -> Iterator[Callable[[Answer, dict[str, str]], Page]]:
    """What begins to draw the page of an answer (hashes: SHA-256 by file name of what was read); where the block ends early the
    second process is ended."""
    if cores() < 2:
        yield lambda answer, hashes: lambda: _page_of(answer, hashes)
        return
    with workers(1, warmed, "ocp.diagnose.report.page") as pool:
        with interrupts_held_back():
            pool.submit(nothing)  # a pool starts its process at the first task
        yield lambda answer, hashes: pool.submit(_page_of, lean(answer), hashes).result


def _page_of(answer: Answer, hashes: dict[str, str]) -> bytes:
    from ocp.diagnose.report.page import diagnosis_page

    return diagnosis_page(answer, hashes)
