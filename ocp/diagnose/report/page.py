"""The report of `python -m ocp.diagnose`: one page that loads nothing and runs nothing."""

from ocp.diagnose.report.sections import diagnosis_sections
from ocp.diagnose.report.words import headline
from ocp.diagnose.verdict.answer import Answer
from ocp.report.report import Report
from ocp.report.svg import inline_svg

KIND = "Diagnosis of the gap between model and cell"


def diagnosis_page(answer: Answer, hashes: dict[str, str]) -> bytes:
    """The page, UTF-8; equal answers give equal bytes. hashes: SHA-256 by file name of what was read."""
    cell, folder = answer.data.setup.tables.name, answer.data.folder.resolve().name
    title = cell if cell == folder else f"{cell}: {folder}"
    report = Report(KIND, title, headline(answer), (), diagnosis_sections(answer, hashes))
    return report.page().encode("utf-8", "replace")


def warm_up() -> None:
    """Draw a plot of nothing: fonts and what else matplotlib reads at the first one are there when the answer comes."""
    inline_svg("nothing", "nothing", 1.0, lambda canvas: canvas.subplots().set_title("nothing"))
