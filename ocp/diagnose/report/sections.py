"""The report of a diagnosis as sections: pictures first, evidence after them."""

from ocp.diagnose.report.bars import budget_plot, probabilities_plot, shrinkage_plot
from ocp.diagnose.report.maps import blade_plot, hysteresis_plot, log_plot, vectors_plot
from ocp.diagnose.report.spectrum import spectrum_plot
from ocp.diagnose.report.tables import (
    explanations_table,
    folds_table,
    gaps_table,
    kernels_table,
    next_table,
    ranking_table,
    screened_table,
    springs_table,
)
from ocp.diagnose.report.words import SHORT, effect_words
from ocp.diagnose.tracker.channel import TrackerChannel
from ocp.diagnose.verdict.answer import Answer, SignalGap
from ocp.diagnose.verdict.shrinkage import NONE
from ocp.report.parts import Points, made_from
from ocp.report.section import Part, Section


def diagnosis_sections(answer: Answer, hashes: dict[str, str]) -> list[Section]:
    """All sections after the headline."""
    found = [_what(answer), _better(answer), _where(answer)]
    if answer.next:
        found.append(Section("What to measure next", (_next_words(), next_table(answer))))
    found.append(_not_seen(answer))
    return [*found, _evidence(answer), made_from(hashes)]


def _what(answer: Answer) -> Section:
    d = answer.diagnosis
    parts: list[Part | str] = [probabilities_plot(answer)]
    groups = [" = ".join(effect_words(name) for name in group) for group in d.classes]
    if groups:
        parts += ["These data cannot tell apart the members of each of these classes:", Points(tuple(groups))]
    if d.impostors:
        words = tuple(f"{effect_words(name)}: {why}" for name, why in d.impostors)
        parts += [
            "Impostors: they help where readings are left out at random and do harm where a condition is new.",
            Points(words),
        ]
    if d.unknown_reasons:
        parts += ["What speaks for an effect outside the catalogue:", Points(tuple(d.unknown_reasons))]
    return Section("Which effect", tuple(parts))


def _better(answer: Answer) -> Section:
    parts: list[Part | str] = [
        "Sizes of the readings' errors, outliers apart; 'before' is the believed cell with its parameters refitted, as a good "
        "calibration leaves it.",
        gaps_table(answer),
    ]
    if answer.diagnosis.active:
        parts += [shrinkage_plot(gap) for gap in answer.gaps if gap.shrinkage not in (None, NONE)]
    return Section("How far the gap shrinks", tuple(parts))


def _where(answer: Answer) -> Section:
    d = answer.diagnosis
    joint = d.location.joint if d.location else 0
    parts: list[Part | str] = [budget_plot(answer)] if d.budget else []
    for gap in answer.gaps:
        parts += _pictures(gap, joint)
    if d.spectrum:
        parts.append(spectrum_plot(d.spectrum))
    return Section("Where it lies", tuple(parts))


def _pictures(gap: SignalGap, joint: int) -> list[Part | str]:
    """Figures of one signal."""
    c = gap.baseline.conditions
    parts: list[Part | str] = []
    if isinstance(gap.baseline, TrackerChannel):
        parts.append(vectors_plot(gap))
    elif gap.name == "force":
        parts.append(blade_plot(gap))
    else:
        parts.append(log_plot(gap))
    if c.d_joints is not None and gap.name != "force":
        parts.append(hysteresis_plot(gap, joint))
    return parts


def _next_words() -> str:
    return (
        "In order of what a minute of it brings. The probability is the one that the true explanation is expected to have "
        "against its rival once the experiment was made; tracker measurements are simulated with this campaign's own noise."
    )


def _not_seen(answer: Answer) -> Section:
    parts: list[Part | str] = [Points(answer.blind)] if answer.blind else ["Every effect of the catalogue could be tested."]
    if answer.notices:
        parts += ["Notices", Points(answer.notices)]
    return Section("What these data cannot show", tuple(parts))


def _evidence(answer: Answer) -> Section:
    d = answer.diagnosis
    parts: list[Part | str] = [
        "Detectability is the energy of an effect's signature over the noise once everything else was refitted; above about 30 a "
        "name can be trusted. Log evidence is natural, over the data without the effect.",
        ranking_table(answer), explanations_table(answer),
    ]  # fmt: skip
    if d.kernels:
        parts.append(kernels_table(answer, left_over=False))
    if d.left_over:
        parts.append(kernels_table(answer, left_over=True))
    parts += [folds_table(answer, gap) for gap in answer.gaps if d.held_out.get(gap.name)]
    parts += [found for found in map(springs_table, answer.gaps) if found is not None]
    if d.screened:
        parts.append(screened_table(answer))
    parts.append(f"Noise: {_noise(answer)}.")
    return Section("Evidence", tuple(parts))


def _noise(answer: Answer) -> str:
    words = [f"{SHORT[gap.name]} {gap.noise_floor:.3g} {gap.unit} rms of a reading" for gap in answer.gaps]
    return "; ".join(words)
