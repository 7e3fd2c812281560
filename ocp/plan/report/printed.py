"""The report on paper: report.pdf, A4, and its first sheet.

Nothing in the file depends on when or where it was made: no dates, matplotlib's own font, figures without a
display.
"""

import textwrap
from pathlib import Path

import matplotlib
from matplotlib.backends.backend_pdf import PdfPages
from matplotlib.patches import Rectangle

from ocp.plan.report.data import PlanReport
from ocp.plan.report.printed_axes import axes_sheets
from ocp.plan.report.printed_contact import contact_sheet
from ocp.plan.report.printed_force import force_sheets
from ocp.plan.report.printed_maps import map_sheet
from ocp.report.style import (
    A4_HEIGHT,
    A4_WIDTH,
    SOFT,
    STYLE,
    Sheet,
    new_sheet,
    number_sheets,
    printable,
    shorten,
)

_LEFT = 0.7  # inch
_FOOT = A4_HEIGHT - 0.8  # inch from the top: nothing of the first sheet goes below


def write_pdf(report: PlanReport, path: Path) -> None:
    """Write the report of a plan as a PDF; equal reports give equal bytes.

    Raises OSError where the file cannot be written.
    """
    with matplotlib.rc_context(STYLE):
        sheets = [
            summary_sheet(report),
            *force_sheets(report),
            *axes_sheets(report),
            map_sheet(report, "Compliance and force on the unrolled blade", ("compliance_nn", "force_sd", "force")),
            contact_sheet(report),
            map_sheet(report, "Removal, feed and limits on the unrolled blade", ("removal", "feed", "limit_ratio")),
        ]
        number_sheets(sheets, report.title)
        # CreationDate None leaves the date out; it would make every file differ.
        metadata = {"Title": printable(report.title), "Subject": "Grinding plan", "CreationDate": None}
        with PdfPages(path, metadata=metadata) as pages:
            for sheet in sheets:
                pages.savefig(sheet.figure)


def summary_sheet(report: PlanReport) -> Sheet:
    """The first sheet: verdict, summary, notices, inputs with hashes, versions."""
    sheet = new_sheet(shorten(report.title, 60), "Grinding plan")
    y = _verdict(sheet, report, 1.25)
    y = _heading(sheet, "Summary", y)
    for row in report.summary:
        lines = textwrap.wrap(f"{row.value} {row.unit}".strip(), 52) or [""]
        label = textwrap.wrap(row.label, 44) or [""]
        for k in range(max(len(lines), len(label))):
            sheet.text(_LEFT, y, label[k] if k < len(label) else "", color=SOFT)
            sheet.text(3.9, y, lines[k] if k < len(lines) else "")
            y += 0.17
        sheet.rule(y - 0.09)
        y += 0.07
    y = _heading(sheet, "Made from", y + 0.2)
    for item in report.inputs:
        sheet.text(_LEFT, y, shorten(item.role, 18), color=SOFT)
        sheet.text(2.1, y, shorten(item.name, 70))
        sheet.text(2.1, y + 0.16, item.sha256, fontsize=7, color=SOFT, family="DejaVu Sans Mono")
        y += 0.38
    with_what = ", ".join(f"{name} {version}" for name, version in report.versions)
    timed = ", ".join(f"{name} {seconds:.1f} s" for name, seconds in report.phases)
    for words in (f"With {with_what}." if with_what else "", f"Time: {timed}." if timed else ""):
        for line in textwrap.wrap(words, 110):
            sheet.text(_LEFT, y, line, color=SOFT)
            y += 0.17
    _notices(sheet, report.notices, y + 0.25)
    return sheet


def _verdict(sheet: Sheet, report: PlanReport, y: float) -> float:
    colour, ground = ("#12643a", "#eef6f1") if report.safe else ("#9c2f0a", "#fdf1ec")
    lines = textwrap.wrap(report.verdict, 94)
    height = 0.45 + 0.2 * len(lines)
    box = (_LEFT / A4_WIDTH, 1 - (y + height) / A4_HEIGHT)
    for width, fill in ((A4_WIDTH - 2 * _LEFT, ground), (0.06, colour)):
        sheet.figure.add_artist(
            Rectangle(box, width / A4_WIDTH, height / A4_HEIGHT, facecolor=fill, transform=sheet.figure.transFigure)
        )
    words = "✓ Safe to use." if report.safe else "✕ Do not use."
    sheet.text(_LEFT + 0.2, y + 0.27, words, fontsize=11, fontweight="bold", color=colour)
    for k, line in enumerate(lines):
        sheet.text(_LEFT + 0.2, y + 0.5 + 0.2 * k, line, fontsize=9.5)
    return y + height + 0.35


def _heading(sheet: Sheet, words: str, y: float) -> float:
    sheet.text(_LEFT, y, words, fontsize=10, fontweight="bold")
    return y + 0.25


def _notices(sheet: Sheet, notices: tuple[str, ...], y: float) -> None:
    """Notices as far as the sheet goes; the rest is counted and left to the page."""
    y = _heading(sheet, "Notices", y)
    if not notices:
        sheet.text(_LEFT, y, "None.")
    for k, notice in enumerate(notices):
        lines = textwrap.wrap(notice, 105) or [""]
        if y + 0.17 * len(lines) > _FOOT:
            sheet.text(_LEFT, y, f"and {len(notices) - k} more in report.html", color=SOFT)
            return
        sheet.text(_LEFT, y, "•")
        for line in lines:
            sheet.text(_LEFT + 0.15, y, line)
            y += 0.17
        y += 0.04
