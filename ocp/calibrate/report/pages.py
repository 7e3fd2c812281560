"""The report of `python -m ocp.calibrate`: report.html and report.pdf of one calibration.

Both are made from the same sections. Nothing in the files depends on when or where they were made.
"""

from collections.abc import Sequence
from pathlib import Path

import matplotlib
from matplotlib.backends.backend_pdf import PdfPages
from matplotlib.patches import Rectangle

from ocp.calibrate.report.sections import calibration_sections
from ocp.calibrate.report.view import look_at
from ocp.calibrate.report.words import headline
from ocp.calibrate.tracker import TrackerCalibration
from ocp.report.flow import LEFT, Flow, wrapped
from ocp.report.page import render_page
from ocp.report.section import WIDTH, Headline, Points, Section
from ocp.report.style import A4_HEIGHT, A4_WIDTH, STYLE, Sheet, new_sheet, number_sheets, printable, shorten

KIND = "Calibration of a robot"


def write_calibration_report(c: TrackerCalibration, folder: Path, hashes: dict[str, str], extra: Sequence[Section] = ()) -> None:
    """Write report.html and report.pdf into `folder`; equal calibrations give equal bytes.

    hashes: SHA-256 by file name of what it was made from. extra: sections of other measurements, shown before what to measure
    next. Raises OSError where a file cannot be written.
    """
    view = look_at(c)
    head, title = headline(c, view), report_title(c)
    sections = calibration_sections(c, view, hashes, extra)
    page = render_page(title, head, c.notices, sections, KIND)
    (Path(folder) / "report.html").write_bytes(page.encode("utf-8", "replace"))
    write_sheets(title, head, c.notices, sections, Path(folder) / "report.pdf")


def report_title(c: TrackerCalibration) -> str:
    """Robot and file."""
    return f"{c.fit.campaign.robot.title} from {c.fit.campaign.readings.path.name}"


def write_sheets(
    title: str,
    head: Headline,
    notices: Sequence[str],
    sections: Sequence[Section],
    path: Path,
    kind_of: str = KIND,
) -> None:
    """The same on A4."""
    with matplotlib.rc_context(STYLE):
        sheet = new_sheet(shorten(title, 60), kind_of)
        flow = Flow([sheet], _verdict(sheet, head, 1.25))
        for question, answer in head.facts:
            flow.sheets[-1].text(LEFT, flow.y, question, fontweight="bold")
            for line in wrapped(answer, WIDTH - 1.1, 8.0):
                flow.sheets[-1].text(LEFT + 1.1, flow.y, line)
                flow.y += 0.165
            flow.y += 0.06
        if notices:
            flow.sections([Section("Notices", (Points(tuple(notices)),))])
        flow.sections(sections)
        number_sheets(flow.sheets, title)
        # CreationDate None leaves the date out; it would make every file differ.
        metadata = {"Title": printable(title), "Subject": kind_of, "CreationDate": None}
        with PdfPages(path, metadata=metadata) as pages:
            for one in flow.sheets:
                pages.savefig(one.figure)


def _verdict(sheet: Sheet, head: Headline, y: float) -> float:
    """The coloured box with verdict and sentence; returns where the next thing begins."""
    colour, ground = ("#12643a", "#eef6f1") if head.good else ("#9c2f0a", "#fdf1ec")
    lines = wrapped(head.sentence, WIDTH - 0.4, 9.5)
    height = 0.45 + 0.2 * len(lines)
    box = (LEFT / A4_WIDTH, 1 - (y + height) / A4_HEIGHT)
    for width, fill in ((WIDTH, ground), (0.06, colour)):
        sheet.figure.add_artist(
            Rectangle(box, width / A4_WIDTH, height / A4_HEIGHT, facecolor=fill, transform=sheet.figure.transFigure)
        )
    sheet.text(LEFT + 0.2, y + 0.27, head.verdict, fontsize=11, fontweight="bold", color=colour)
    for k, line in enumerate(lines):
        sheet.text(LEFT + 0.2, y + 0.5 + 0.2 * k, line, fontsize=9.5)
    return y + height + 0.3
