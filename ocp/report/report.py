"""A whole report, written as one HTML page or as A4 sheets in a PDF.

The page opens offline, loads nothing and runs no script but its sections' own: a content security policy names script and
style by their hashes. Neither file depends on when or where it was made.
"""

import base64
import hashlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import jinja2
from markupsafe import Markup

from ocp.report.paper import sheets
from ocp.report.parts import Facts, Plot, Points, as_part
from ocp.report.section import Headline, Part, Section
from ocp.report.style import shorten

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

    def plots(self) -> list[Plot]:
        """Its pictures, most of its time: they may be drawn apart (`Plot.drawn`)."""
        found = [part for section in self.sections for part in section.parts if isinstance(part, Plot)]
        assert len({plot.key for plot in found}) == len(found)  # pictures are known by their keys
        return found

    def with_plots(self, drawn: Mapping[str, str]) -> "Report":
        """The same report with the pictures of these keys drawn."""

        def own(part: Part | str) -> Part | str:
            return replace(part, svg=drawn[part.key]) if isinstance(part, Plot) and part.key in drawn else part

        return replace(self, sections=[replace(s, parts=tuple(map(own, s.parts))) for s in self.sections])

    def write_pdf(self, path: Path) -> None:
        """Write the sheets. Raises OSError where the file cannot be written."""
        tone, ground = TONES[self.head.tone]
        notices = [Section("Notices", (Points(tuple(self.notices)),))] if self.notices else []
        data = {
            "title": shorten(self.title, 60),
            "foot": shorten(self.title, 80),
            "kind": self.kind,
            "verdict": f"{self.head.mark} {self.head.verdict}",
            "sentence": self.head.sentence,
            "facts": self.head.facts,
            "sections": [
                {"title": section.title, "parts": [as_part(part).on_paper() for part in section.parts]}
                for section in (*notices, *self.sections)
            ],
        }
        path.write_bytes(sheets(data, tone, ground))

    def write(self, folder: Path) -> None:
        """Write report.html and report.pdf, every picture drawn once. Raises OSError."""
        whole = self.with_plots({plot.key: plot.drawn() for plot in self.plots()})
        whole.write_page(folder / "report.html")
        whole.write_pdf(folder / "report.pdf")


def _source_hash(source: str) -> str:
    """As a content security policy names a script or a style."""
    return "sha256-" + base64.b64encode(hashlib.sha256(source.encode()).digest()).decode("ascii")
