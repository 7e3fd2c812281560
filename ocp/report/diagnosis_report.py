"""The report of `python -m ocp.diagnose`: one page that loads nothing and runs nothing."""

from pathlib import Path

from ocp.diagnosis.answer import Answer
from ocp.report.calibration_report import render_page
from ocp.report.diagnosis_sections import diagnosis_sections
from ocp.report.diagnosis_words import headline

KIND = "Diagnosis of the gap between model and cell"


def write_diagnosis_report(answer: Answer, path: Path, hashes: dict[str, str]) -> None:
    """Write the page; equal answers give equal bytes. hashes: SHA-256 by file name of what was read. Raises OSError."""
    cell, folder = answer.data.setup.tables.name, answer.data.folder.resolve().name
    title = cell if cell == folder else f"{cell}: {folder}"
    page = render_page(title, headline(answer), (), diagnosis_sections(answer, hashes), KIND)
    Path(path).write_bytes(page.encode("utf-8", "replace"))
