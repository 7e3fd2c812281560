"""The report as one HTML file: opens offline in any browser, loads nothing, runs only its own script.

Every word passes through the escaping template, every number for the script through `script_json`. A content
security policy names the script and the style sheet by their hashes, so that even text that slipped through
could not run.
"""

from pathlib import Path

from markupsafe import Markup

from ocp.plan.report.charts import HEIGHT, LEFT, RIGHT, TOP, WIDTH, contact_bands, force_panels
from ocp.plan.report.data import PlanReport
from ocp.plan.report.payload import page_payload, script_json
from ocp.plan.report.quantities import QUANTITIES
from ocp.plan.report.tables import limit_rows, pass_rows
from ocp.report.page import PAGE_STYLE
from ocp.report.template import fill, joined, source_hash

_VIEWER = Path(__file__).parent / "viewer"
_SCRIPTS = ("math.js", "mesh.js", "scene.js", "orbit.js", "viewer.js", "page.js")


def write_page(report: PlanReport, path: Path) -> None:
    """Write the report of a plan as one self-contained HTML file; equal reports give equal bytes.

    Raises OSError where the file cannot be written.
    """
    Path(path).write_bytes(render_page(report).encode("utf-8", "replace"))


def render_page(report: PlanReport) -> str:
    """The page as text."""
    script = '(function () {\n"use strict";\n' + joined([_VIEWER / name for name in _SCRIPTS]) + "})();\n"
    style = joined((PAGE_STYLE, _VIEWER / "viewer.css"))
    return fill(
        _VIEWER / "page.html",
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
        script_hash=source_hash(script),
        style_hash=source_hash(style),
    )
