"""From a data set to its answer, and the answer to its folder."""

import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from threadpoolctl import threadpool_limits

from ocp.diagnose.channels import channels_of
from ocp.diagnose.corrected import write_corrected_cell
from ocp.diagnose.dataset import blinds, read_data_set, read_sealed_force, read_sealed_tracker
from ocp.diagnose.document import document_of, json_text
from ocp.diagnose.engine.channel_system import Channel, Sealed
from ocp.diagnose.engine.findings import Alternative
from ocp.diagnose.foresee.anticipated import signal_gap
from ocp.diagnose.foresee.next_experiment import next_experiments
from ocp.diagnose.predictions import averaged, write_force_predictions, write_tracker_predictions
from ocp.diagnose.report.verdict_sentence import diagnosis_headline
from ocp.diagnose.reporting import drawn_beside
from ocp.diagnose.rules import FOLLOWED_FORCE
from ocp.diagnose.verdict.answer import Answer
from ocp.diagnose.verdict.diagnosis import diagnose_channels
from ocp.effects.catalogue import library
from ocp.effects.effect import Effect
from ocp.shell.cache import sha256
from ocp.shell.output import check_output, whole_folder
from ocp.shell.progress import Phases
from robots.errors import BadInput, Infeasible

_CANNOT = re.compile(r"(?P<why>.*): (?P<effect>\w+) cannot be seen")
NEVER = frozenset({"speed"})  # no column of readings at rest


def answer_of(folder: Path, phases: Phases, known: dict[str, Effect] | None = None) -> Answer:
    """Diagnose a folder with the effects `known` (default: all). Shrinkage is predicted here, from the folds alone; sealed files
    are not opened. Raises BadInput."""
    known = library() if known is None else known
    with phases.phase("reading"):
        data = read_data_set(folder)
    channels = channels_of(data, phases)
    with phases.phase("diagnosis"):
        found = diagnose_channels(channels, known)
    with phases.phase("next"):
        gaps = tuple(signal_gap(found, b, a) for b, a in zip(found.baseline, found.channels, strict=True))
        experiments = next_experiments(found, known)
    told = [n for channel in channels for n in getattr(getattr(channel, "problem", None), "notices", ())]
    blind = tuple(dict.fromkeys((*(n for n in told if blinds(n)), *data.blind, *grouped(found.blind))))
    notices = tuple(dict.fromkeys((*data.notices, *(n for n in told if not blinds(n)))))
    return Answer(data, found, gaps, experiments, blind, notices, dict(phases.seconds))


def grouped(blind: Sequence[str]) -> list[str]:
    """Sentences 'WHY: EFFECT cannot be seen' with the same reason as one; effects of a signal that was not measured are left
    out, that signal is named already."""
    reasons: dict[str, list[str]] = {}
    for sentence in blind:
        told = _CANNOT.fullmatch(sentence)
        if told and told["why"].rpartition("column ")[2] not in NEVER:
            reasons.setdefault(told["why"], []).append(told["effect"])
    return [f"{why}: {', '.join(names)} cannot be seen" for why, names in reasons.items()]


def predict_sealed(answer: Answer) -> dict[str, Sealed]:
    """Blind predictions by signal, the named effects in the corrected ones, averaged over what else they may be. Raises BadInput:
    sealed conditions malformed."""
    found: dict[str, Sealed] = {}
    data, told = answer.data, answer.diagnosis.alternatives or (Alternative(1.0, answer.diagnosis.active),)
    for signal in data.sealed:
        channel = _of(answer.diagnosis.channels, signal)
        sealed = read_sealed_tracker(data) if signal == "tracker" else read_sealed_force(data)
        least = 0.0 if signal == "tracker" else FOLLOWED_FORCE
        kept = [told[0], *(a for a in told[1:] if a.probability >= least)]
        made = []
        for k, one in enumerate(kept):
            try:
                made.append((one.probability, channel.predict(sealed, one.active)))
            except Infeasible:  # an alternative with which the model comes to no rest predicts nothing
                if k == 0:
                    raise
        found[signal] = averaged(made)
    return found


def left_out(sealed: dict[str, Sealed]) -> list[str]:
    """Sentences on effects that are not in the predictions of sealed conditions."""
    return [
        f"sealed_{signal}.csv lacks a column that {', '.join(told.lacking)} depends on: not in the corrected predictions, its "
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
def write_diagnosis(folder: Path, out: Path, overwrite: bool, phases: Phases) -> DiagnosisResult:
    """Diagnose a data set folder and write the answer's folder.

    Raises BadInput and Infeasible of every part; then `out` is as it was.
    """
    inputs = [p for p in folder.iterdir() if p.is_file()] if folder.is_dir() else []
    check_output(out, overwrite, inputs)
    if out.resolve() == folder.resolve():
        raise BadInput(f"--out {out}: is the data set itself; give another folder")
    with drawn_beside() as draw:
        answer = answer_of(folder, phases)
        page = draw(answer, {p.name: sha256(p) for p in answer.data.inputs})
        with phases.phase("predictions"):
            sealed = predict_sealed(answer)
        with whole_folder(out, overwrite) as made:
            with phases.phase("writing"):
                (made / "diagnosis.json").write_text(json_text(document_of(answer)), encoding="utf-8")
                if "tracker" in sealed:
                    write_tracker_predictions(made / "predictions_tracker.csv", sealed["tracker"])
                if "force" in sealed:
                    write_force_predictions(made / "predictions_force.csv", sealed["force"])
                write_corrected_cell(made, out, answer.data, answer.diagnosis.channels, answer.diagnosis.active)
            with phases.phase("report"):
                (made / "report.html").write_bytes(page())
    return DiagnosisResult(out, answer, sealed, last_line(answer, out))


def last_line(answer: Answer, out: Path) -> str:
    """What was found, and where it stands."""
    head = diagnosis_headline(answer)
    safe = {
        "explained": f"{out / 'corrected_cell.toml'} plans with it",
        "ambiguous": f"{out / 'corrected_cell.toml'} holds the likeliest; measure what the report asks for before relying on it",
        "unexplained": "Do not rely on the believed cell there",
        "no_gap": "The believed cell stands",
    }[answer.diagnosis.verdict]
    return f"{out}: {head.verdict} {head.sentence.rstrip('.')}. {safe}; {out / 'report.html'} shows why."


def _of(channels: Sequence[Channel], signal: str) -> Channel:
    return next(c for c in channels if c.name == signal)
