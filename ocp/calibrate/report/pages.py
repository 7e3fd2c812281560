"""The report of `python -m ocp.calibrate`: report.html and report.pdf of one calibration, from the same sections."""

from collections.abc import Sequence
from pathlib import Path

from ocp.calibrate.report.sections import calibration_sections
from ocp.calibrate.report.view import look_at
from ocp.calibrate.report.words import headline
from ocp.calibrate.tracker import TrackerCalibration
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
    report = Report("Calibration of a robot", title, headline(c, view), c.notices, sections)
    report.write_page(folder / "report.html")
    report.write_pdf(folder / "report.pdf")
