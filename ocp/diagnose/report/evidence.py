"""The section "Evidence": the tables behind the one sentence."""

from collections.abc import Sequence

from ocp.diagnose.engine.channel_system import SCALE
from ocp.diagnose.engine.findings import KernelTest, Name
from ocp.diagnose.joints.channel import JointChannel
from ocp.diagnose.report.verdict_sentence import SHORT, condition_words, effect_words, effects_words, figure, values_words
from ocp.diagnose.verdict.answer import Answer, SignalGap
from ocp.effects.catalogue import library
from ocp.report.parts import Table, table
from ocp.report.section import Part, Section

MOST = 20


def evidence_section(answer: Answer) -> Section:
    """Effects, explanations, tests without the catalogue, folds, springs, screened effects, noise."""
    d = answer.diagnosis
    parts: list[Part | str] = [
        "Detectability is the energy of an effect's signature over the noise once everything else was refitted; above about 30 a "
        "name can be trusted. Log evidence is natural, over the data without the effect.",
        ranking_table(answer),
        explanations_table(answer),
    ]
    told = {"Before: what does the gap vary with?": d.kernels, "After the named effects: does anything still vary?": d.left_over}
    parts += [kernels_table(tests, title) for title, tests in told.items() if tests]
    parts += [folds_table(answer, gap) for gap in answer.gaps if d.held_out.get(gap.name)]
    parts += [found for found in map(refitted_springs_table, answer.gaps) if found is not None]
    if d.screened:
        parts.append(screened_table(answer))
    noise = [f"{SHORT[gap.name]} {gap.noise_floor:.3g} {gap.unit} rms of a reading" for gap in answer.gaps]
    parts.append(f"Noise: {'; '.join(noise)}.")
    return Section("Evidence", tuple(parts))


def ranking_table(answer: Answer) -> Table:
    """Effects by probability with values and detectability."""
    d = answer.diagnosis
    accepted = {Name(*a.key) for a in d.active}
    rows = []
    for r in d.ranking[:MOST]:
        numbers = (f"{r.probability:.3f}", f"{r.log_evidence:+.1f}", f"{r.detectability:.0f}")
        values = values_words(r.active.parameters, r.deviations)
        rows.append((effect_words(r.name), *numbers, values, _plausible(r.active.parameters, r.name)))
    strong = [k for k, r in enumerate(d.ranking[:MOST]) if r.name in accepted]
    columns = ("effect", "probability", "log evidence", "detectability", "value ± one sigma", "against the usual range")
    return table(columns, rows, text=(0, 4, 5), strong=strong, title="Effects, bold where named")


def _plausible(values: dict[str, object], name: Name) -> str:
    """How a value stands against the typical range of the catalogue."""
    words = []
    for p in library()[name.effect].parameters:
        value = values.get(p.key)
        if not isinstance(value, int | float) or p.key in ("phase_rad", "order", "at_s") or p.high <= 0:
            continue
        if not p.signed and value < 0:
            words.append(f"{p.key} has the wrong sign")
        elif abs(value) > 3 * p.high:
            words.append(f"{p.key} is {abs(value) / p.high:.1f} times the usual upper end: hardly plausible")
        elif abs(value) > p.high:
            words.append(f"{p.key} is above the usual {p.low:.1g} to {p.high:.1g}")
        elif abs(value) < p.low:
            words.append(f"{p.key} is below the usual {p.low:.1g} to {p.high:.1g}")
    return "; ".join(words) if words else "usual"


def explanations_table(answer: Answer) -> Table:
    """Sets of effects with probability and evidence."""
    rows = [
        (effects_words(e.names), f"{e.probability:.4f}", f"{e.log_evidence:+.1f}") for e in answer.diagnosis.explanations[:12]
    ]
    rows += [("no name of the catalogue", f"{answer.diagnosis.p_none:.4f}", "0.0")]
    rows += [("something outside the catalogue", f"{answer.diagnosis.p_unknown:.4f}", "")]
    return table(("explanation", "probability", "log evidence over none"), rows, title="Explanations as a whole")


def kernels_table(tests: Sequence[KernelTest], title: str) -> Table:
    """Library-free tests, of the baseline's gap or of what the named effects leave."""
    rows = [
        (SHORT[k.channel], condition_words(k.where), k.source, f"{k.gained:.1f}", f"{k.p_value:.3g}")
        for k in sorted(tests, key=lambda k: k.p_value)[:12]
    ]
    strong = [k for k, row in enumerate(rows) if float(row[4]) < 0.01]
    return table(("signal", "varies with", "enters as", "evidence", "p-value"), rows, text=(0, 1, 2), strong=strong, title=title)


def screened_table(answer: Answer) -> Table:
    """What each effect's score test said before anything was accepted, and the smallest size that would show."""
    rows = []
    for s in sorted(answer.diagnosis.screened, key=lambda s: s.p_value)[:MOST]:
        figures_of = (f"{s.gained:.1f}", f"{s.freedom}", f"{s.variants}", f"{s.p_value:.2g}")
        size = f"{100 * s.smallest:.0f} %" if s.smallest < 10 else "not seen"
        rows.append((str(s.name), *figures_of, size, f"{100 * s.left:.0f} %"))
    tested = ("effect", "lambda gained", "freedom", "tried", "p-value")
    columns = (*tested, "smallest seen, of the usual upper end", "of it left by the refit")
    return table(columns, rows, title="Every effect alone, before any was accepted (those that fit best)")


def folds_table(answer: Answer, gap: SignalGap) -> Table:
    """Every fold: error before and after on what was left out."""
    rows = []
    for h in answer.diagnosis.held_out.get(gap.name, ()):
        values = [SCALE[gap.unit] * v**0.5 for v in h.means]
        better = "" if values[1] <= values[0] else "worse"
        rows.append((h.fold.name, h.fold.kind, str(h.rows.shape[1]), *(figure(v) for v in values), better))
    columns = ("left out", "kind", "readings", f"rms before, {gap.unit}", "after", "noise", "")
    return table(columns, rows, text=(0, 1, 6), title=f"Left out: {SHORT[gap.name]}")


def refitted_springs_table(gap: SignalGap) -> Table | None:
    """Springs that were refitted as part of the believed cell, before and with the effects; None where there are none."""
    before, after = gap.baseline, gap.corrected
    if not (isinstance(before, JointChannel) and isinstance(after, JointChannel)) or not after.problem.springs:
        return None
    at = {name: k for k, name in enumerate(after.problem.nuisance.names)}
    rows = []
    for j, (believed, sd) in after.problem.springs.items():
        values = (believed, sd, *(float(c.theta[at[f"spring {j}"]]) for c in (before, after)))
        rows.append((f"joint {j}", *(f"{v:.3g}" for v in values)))
    columns = ("rad/(N m)", "believed", "one sigma of that", "refitted alone", "refitted with the effects")
    return table(columns, rows, title="Springs of the believed cell")
