"""A whole report, written as one HTML page or as A4 sheets in a PDF.

The page opens offline, loads nothing and runs no script but its sections' own: a content security policy names script and
style by their hashes. Neither file depends on when or where it was made: no dates, matplotlib's own font, figures without a
display.
"""

import base64
import hashlib
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import jinja2
import matplotlib
from markupsafe import Markup
from matplotlib.backends.backend_pdf import PdfPages

from ocp.report.parts import Facts, Paragraph, Points, as_part
from ocp.report.plotting import WIDTH, finished
from ocp.report.section import Headline, Section
from ocp.report.sheets import LEFT, Sheet, Sheets, new_sheet, number_sheets, wrapped
from ocp.report.style import STYLE, printable, shorten

TONES = {"safe": ("#12643a", "#eef6f1"), "doubtful": ("#7a5200", "#fcf5e3"), "unsafe": ("#9c2f0a", "#fdf1ec")}
"""Colour and ground of the headline's box; page.css has the same."""

_KIT = Path(__file__).parent


@dataclass(frozen=True)
class Report:
    """`kind` of report, its title, verdict, notices, sections; equal reports give equal bytes."""

    kind: str
    title: str
    head: Headline
    notices: Sequence[str]
    sections: Sequence[Section]

    def page(self) -> str:
        """The page as text."""
        style = "\n".join([(_KIT / "page.css").read_text(encoding="utf-8"), *(s.style for s in self.sections if s.style)])
        script = "\n".join(s.script for s in self.sections if s.script)
        environment = jinja2.Environment(
            loader=jinja2.FileSystemLoader(_KIT),
            autoescape=True,
            undefined=jinja2.StrictUndefined,
            trim_blocks=True,
            lstrip_blocks=True,
        )
        return environment.get_template("page.html").render(
            report=self,
            head=self.head,
            facts=Facts(self.head.facts).on_page() if self.head.facts else "",
            notices=Points(tuple(self.notices)).on_page() if self.notices else "",
            parts=lambda section: [as_part(part).on_page() for part in section.parts],
            style=Markup(style),
            style_hash=_source_hash(style),
            script=Markup(script),
            script_hash=_source_hash(script),
        )

    def write_page(self, path: Path) -> None:
        """Write the page as UTF-8. Raises OSError where the file cannot be written."""
        path.write_bytes(self.page().encode("utf-8", "replace"))

    def write_pdf(self, path: Path) -> None:
        """Write the sheets. Raises OSError where the file cannot be written."""
        with matplotlib.rc_context(STYLE):
            first = new_sheet(shorten(self.title, 60), self.kind)
            sheets = Sheets([first], _verdict_on_sheet(first, self.head, 1.25))
            Facts(self.head.facts).on_sheets(sheets)
            notices = [Section("Notices", (Points(tuple(self.notices)),))] if self.notices else []
            for section in (*notices, *self.sections):
                _section_on_sheets(sheets, section)
            number_sheets(sheets.all, self.title)
            # CreationDate None leaves the date out; it would make every file differ.
            metadata = {"Title": printable(self.title), "Subject": self.kind, "CreationDate": None}
            with PdfPages(path, metadata=metadata) as pages:
                for sheet in sheets.all:
                    pages.savefig(finished(sheet.figure))


def _source_hash(source: str) -> str:
    """As a content security policy names a script or a style."""
    return "sha256-" + base64.b64encode(hashlib.sha256(source.encode()).digest()).decode("ascii")


def _verdict_on_sheet(sheet: Sheet, head: Headline, y: float) -> float:
    """The coloured box with verdict and sentence; returns where the next thing begins."""
    colour, ground = TONES[head.tone]
    lines = wrapped(head.sentence, WIDTH - 0.4, 9.5)
    height = 0.45 + 0.2 * len(lines)
    sheet.box(LEFT, y + height, WIDTH, height, ground)
    sheet.box(LEFT, y + height, 0.06, height, colour)
    words = f"{head.mark} {head.verdict}"
    sheet.text(LEFT + 0.2, y + 0.27, words, fontsize=11, fontweight="bold", color=colour)
    for k, line in enumerate(lines):
        sheet.text(LEFT + 0.2, y + 0.5 + 0.2 * k, line, fontsize=9.5)
    return y + height + 0.3


def _section_on_sheets(sheets: Sheets, section: Section) -> None:
    """Heading and parts; the heading stands on one sheet with what comes first below it, and with what a paragraph leads to."""
    parts = [as_part(part) for part in section.parts]
    leading = parts[: 2 if parts and isinstance(parts[0], Paragraph) else 1]
    sheets.y += 0.22
    sheets.need(0.3 + sum(part.beginning() for part in leading))
    sheets.last.text(LEFT, sheets.y, section.title, fontsize=11, fontweight="bold")
    sheets.last.rule(sheets.y + 0.08)
    sheets.y += 0.3
    for part in parts:
        part.on_sheets(sheets)
