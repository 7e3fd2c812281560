"""A report of sections as one page that loads nothing and runs nothing: calibration, diagnosis, rehearsal, checks."""

import base64
import hashlib
from collections.abc import Sequence
from pathlib import Path

import jinja2
from markupsafe import Markup

from ocp.report.section import Headline, Plot, Points, Section, Table
from ocp.report.svg_inline import inline_svg

_FOLDER = Path(__file__).parent
_STYLES = ("page.css", "sections_page.css")


def render_page(title: str, head: Headline, notices: Sequence[str], sections: Sequence[Section], kind_of: str) -> str:
    """The page as text; equal sections give equal text. `kind_of` report, above the title."""
    style = "\n".join((_FOLDER / name).read_text(encoding="utf-8") for name in _STYLES)
    environment = jinja2.Environment(
        loader=jinja2.FileSystemLoader(_FOLDER),
        autoescape=True,
        undefined=jinja2.StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    kinds = {Table: "table", Points: "points", Plot: "plot"}
    digest = base64.b64encode(hashlib.sha256(style.encode()).digest()).decode("ascii")
    return environment.get_template("sections_page.html").render(
        title=title,
        eyebrow=kind_of,
        head=head,
        notices=notices,
        sections=sections,
        kind=lambda part: kinds.get(type(part), "words"),
        svg=lambda plot: Markup(inline_svg(plot)),
        style=Markup(style),
        style_hash=f"sha256-{digest}",
    )
