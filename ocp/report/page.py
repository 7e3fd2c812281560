"""A report of sections as one page that loads nothing and runs nothing: calibration, diagnosis, rehearsal, checks."""

from collections.abc import Sequence
from pathlib import Path

from markupsafe import Markup

from ocp.report.section import Headline, Plot, Points, Section, Table
from ocp.report.svg import inline_svg
from ocp.report.template import fill, joined, source_hash

_KIT = Path(__file__).parent
PAGE_STYLE = _KIT / "page.css"
"""What every page shares, a plan's too."""


def render_page(title: str, head: Headline, notices: Sequence[str], sections: Sequence[Section], kind_of: str) -> str:
    """The page as text; equal sections give equal text. `kind_of` report, above the title."""
    style = joined((PAGE_STYLE, _KIT / "sections_page.css"))
    kinds = {Table: "table", Points: "points", Plot: "plot"}
    return fill(
        _KIT / "sections_page.html",
        title=title,
        eyebrow=kind_of,
        head=head,
        notices=notices,
        sections=sections,
        kind=lambda part: kinds.get(type(part), "words"),
        svg=lambda plot: Markup(inline_svg(plot)),
        style=Markup(style),
        style_hash=source_hash(style),
    )
