"""The report of `python -m ocp.calibrate`: report.html and report.pdf of one calibration, from the same sections."""

from collections.abc import Sequence
from pathlib import Path

from ocp.calibrate.report.advice import advice_section
from ocp.calibrate.report.headline import calibration_headline
from ocp.calibrate.report.held_out import before_and_after_section, left_out_section
from ocp.calibrate.report.identifiability import identifiability_section, tellable_parameters
from ocp.calibrate.report.noise import noise_section
from ocp.calibrate.report.parameters import parameters_section, terms_section
from ocp.calibrate.report.residuals import residuals_section
from ocp.calibrate.report.view import ReadingsView, look_at
from ocp.calibrate.tracker import TrackerCalibration
from ocp.report.parts import made_from
from ocp.report.report import Report
from ocp.report.section import Section


def write_calibration_report(c: TrackerCalibration, folder: Path, hashes: dict[str, str], extra: Sequence[Section] = ()) -> None:
    """Write report.html and report.pdf into `folder`; equal calibrations give equal bytes.

    hashes: SHA-256 by file name of what it was made from. extra: sections of other measurements, shown before what to measure
    next. Raises OSError where a file cannot be written.
    """
    view = look_at(c)
    title = f"{c.fit.campaign.robot.title} from {c.fit.campaign.readings.path.name}"
    sections = calibration_sections(c, view, hashes, extra)
    report = Report("Calibration of a robot", title, calibration_headline(c, view), c.notices, sections)
    report.write_page(folder / "report.html")
    report.write_pdf(folder / "report.pdf")


def calibration_sections(
    c: TrackerCalibration, view: ReadingsView, hashes: dict[str, str], extra: Sequence[Section]
) -> list[Section]:
    """All sections after the headline; `extra` stands before what to measure next."""
    tellable = tellable_parameters(c)
    return [
        before_and_after_section(c),
        left_out_section(c),
        residuals_section(c, view),
        parameters_section(c),
        identifiability_section(c, tellable),
        terms_section(c),
        noise_section(c, view),
        *extra,
        advice_section(c, view, tellable),
        made_from(hashes),
    ]
