"""The report of `python -m ocp.plan`: report.html and report.pdf of one plan, from the same sections."""

from pathlib import Path

from ocp.plan.report.axes import axes_section
from ocp.plan.report.force import force_section
from ocp.plan.report.plan_report import PlanReport
from ocp.plan.report.quantities import contact_section, maps_section
from ocp.plan.report.scene import scene_section
from ocp.report.parts import Facts, made_from
from ocp.report.report import Report
from ocp.report.section import Headline, Section


def plan_pages(report: PlanReport) -> Report:
    """The report as headline and sections, in their order."""
    head = Headline(report.safe, "Safe to use." if report.safe else "Do not use.", report.verdict)
    sections = (
        Section("Summary", (Facts(tuple(report.summary)),)),
        scene_section(report),
        force_section(report),
        axes_section(report),
        maps_section(report),
        contact_section(report),
        made_from(report.inputs),
    )
    return Report("Grinding plan", report.title, head, report.notices, sections)


def write_plan_report(report: PlanReport, folder: Path) -> None:
    """Write report.html and report.pdf into `folder`; equal reports give equal bytes. Raises OSError."""
    pages = plan_pages(report)
    pages.write_page(folder / "report.html")
    pages.write_pdf(folder / "report.pdf")
