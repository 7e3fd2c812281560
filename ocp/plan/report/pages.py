"""The pages of a plan's report, in their order."""

from ocp.plan.grades import NOT_TO_GRIND
from ocp.plan.report.axes import axes_section
from ocp.plan.report.force import force_section, left_out_section, verification_section
from ocp.plan.report.plan_report import PlanReport
from ocp.plan.report.quantities import contact_section, maps_section
from ocp.plan.report.removal import removal_section
from ocp.plan.report.scene import scene_section
from ocp.report.parts import Facts, made_from
from ocp.report.report import Report
from ocp.report.section import Headline, Section


def plan_pages(report: PlanReport) -> Report:
    """The report as headline and sections, in their order."""
    words = report.headline if report.safe else "Do not use."
    head = Headline(report.safe and words != NOT_TO_GRIND, words, report.verdict, doubtful=words != "Safe to use.")
    sections = (
        scene_section(report),
        Section("Summary", (Facts(tuple(report.summary)),)),
        *([left_out_section(report)] if report.left_out else []),
        force_section(report),
        axes_section(report),
        removal_section(report),
        maps_section(report),
        contact_section(report),
        verification_section(report),
        made_from(report.inputs),
    )
    return Report("Grinding plan", report.title, head, report.notices, sections)
