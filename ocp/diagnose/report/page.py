"""The report of `python -m ocp.diagnose`: one page that loads nothing and runs nothing; its sections in their order."""

from ocp.diagnose.report.evidence import evidence_section
from ocp.diagnose.report.shrinkage import shrinkage_section
from ocp.diagnose.report.verdict_sentence import diagnosis_headline
from ocp.diagnose.report.where import where_section
from ocp.diagnose.report.which_effect import which_effect_section
from ocp.diagnose.verdict.answer import Answer
from ocp.report.parts import Points, Table, made_from, table
from ocp.report.plotting import inline_svg
from ocp.report.report import Report
from ocp.report.section import Part, Section

KIND = "Diagnosis of the gap between model and cell"


def diagnosis_page(answer: Answer, hashes: dict[str, str]) -> bytes:
    """The page, UTF-8; equal answers give equal bytes. hashes: SHA-256 by file name of what was read."""
    cell, folder = answer.data.setup.tables.name, answer.data.folder.resolve().name
    title = cell if cell == folder else f"{cell}: {folder}"
    report = Report(KIND, title, diagnosis_headline(answer), (), diagnosis_sections(answer, hashes))
    return report.page().encode("utf-8", "replace")


def diagnosis_sections(answer: Answer, hashes: dict[str, str]) -> list[Section]:
    """All sections after the headline."""
    found = [which_effect_section(answer), shrinkage_section(answer), where_section(answer)]
    if answer.next:
        found.append(Section("What to measure next", (_next_words(), next_table(answer))))
    found.append(_not_seen(answer))
    return [*found, evidence_section(answer), made_from(hashes)]


def next_table(answer: Answer) -> Table:
    """Experiments with minutes and what they tell."""
    rows = [(e.do, f"{e.minutes:.0f}", " | ".join(e.tells_apart), f"{e.expected:.2f}") for e in answer.next]
    return table(("experiment", "minutes", "tells apart", "probability expected"), rows, text=(0, 2))


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


def warm_up() -> None:
    """Draw a plot of nothing: fonts and what else matplotlib reads at the first one are there when the answer comes."""
    inline_svg("nothing", "nothing", 1.0, lambda canvas: canvas.subplots().set_title("nothing"))
