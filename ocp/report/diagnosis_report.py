"""The report of `python -m ocp.diagnose`: one page that loads nothing and runs nothing."""

from ocp.diagnosis.answer import Answer
from ocp.report.diagnosis_sections import diagnosis_sections
from ocp.report.diagnosis_words import headline
from ocp.report.sections_page import render_page

KIND = "Diagnosis of the gap between model and cell"


def diagnosis_page(answer: Answer, hashes: dict[str, str]) -> bytes:
    """The page, UTF-8; equal answers give equal bytes. hashes: SHA-256 by file name of what was read."""
    cell, folder = answer.data.setup.tables.name, answer.data.folder.resolve().name
    title = cell if cell == folder else f"{cell}: {folder}"
    return render_page(title, headline(answer), (), diagnosis_sections(answer, hashes), KIND).encode("utf-8", "replace")
