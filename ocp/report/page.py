"""The report as one HTML file: opens offline in any browser, loads nothing, runs only its own script.

Every word passes through the escaping template, every number for the script through `script_json`. A content
security policy names the script and the style sheet by their hashes, so that even text that slipped through
could not run.
"""

import base64
import hashlib
from pathlib import Path

import jinja2
from markupsafe import Markup

from ocp.report.charts import HEIGHT, LEFT, RIGHT, TOP, WIDTH, contact_bands, force_panels
from ocp.report.data import PlanReport
from ocp.report.payload import page_payload, script_json
from ocp.report.quantities import QUANTITIES
from ocp.report.tables import limit_rows, pass_rows

_FOLDER = Path(__file__).parent
_SCRIPTS = ("math.js", "mesh.js", "scene.js", "orbit.js", "viewer.js", "page.js")
_STYLES = ("page.css", "viewer.css")


def write_page(report: PlanReport, path: Path) -> None:
    """Write the report of a plan as one self-contained HTML file; equal reports give equal bytes.

    Raises OSError where the file cannot be written.
    """
    Path(path).write_bytes(render_page(report).encode("utf-8", "replace"))


def render_page(report: PlanReport) -> str:
    """The page as text."""
    script = '(function () {\n"use strict";\n' + "\n".join(_read(name) for name in _SCRIPTS) + "})();\n"
    style = "\n".join(_read(name) for name in _STYLES)
    environment = jinja2.Environment(
        loader=jinja2.FileSystemLoader(_FOLDER),
        autoescape=True,
        undefined=jinja2.StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    return environment.get_template("page.html").render(
        report=report,
        panels=force_panels(report),
        panel={"width": WIDTH, "height": HEIGHT, "left": LEFT, "right": RIGHT, "top": TOP},
        bands=contact_bands(report),
        limits=limit_rows(report),
        passes=pass_rows(report),
        quantities=QUANTITIES,
        payload=Markup(script_json(page_payload(report))),
        script=Markup(script),
        style=Markup(style),
        script_hash=_source_hash(script),
        style_hash=_source_hash(style),
    )


def _read(name: str) -> str:
    return (_FOLDER / name).read_text(encoding="utf-8")


def _source_hash(text: str) -> str:
    """Hash of an inline source as a content security policy spells it."""
    return "sha256-" + base64.b64encode(hashlib.sha256(text.encode("utf-8")).digest()).decode("ascii")
