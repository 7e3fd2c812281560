"""`ocp.api.calibrate`: tracker readings, with a force log or without; a calibrated cell with its covariance out."""

from dataclasses import replace
from pathlib import Path

from ocp.calibrate.files import CalibrationResult, tracker_calibration, write_tracker_calibration
from ocp.calibrate.force.log import ForceLog, read_force_log, refuse_force_unit, without_ramps
from ocp.calibrate.force.registration import fit_force, refuse_other_force
from ocp.calibrate.report.pages import contact_sections
from ocp.calibrate.tracker import TrackerCalibration, calibrate_tracker
from ocp.model.cell import Cell, files_of, read_cell, with_calibration
from ocp.report.section import Section
from ocp.shell.output import Output, reserved
from ocp.shell.progress import Phases, Progress
from robots.calibration.carried import carried_over
from robots.column_mapping import ColumnMapping, read_column_mapping
from robots.csv_table import OURS
from robots.errors import BadInput, Infeasible


def calibrate(
    tracker: str | Path,
    *,
    cell: str | Path,
    out: str | Path,
    force: str | Path | None = None,
    method: str = "full",
    columns: str | Path | None = None,
    overwrite: bool = False,
    progress: Progress | None = None,
) -> CalibrationResult:
    """Calibrate the robot of `cell` from the readings `tracker` (tracker.csv) and, with the log `force` of a force ladder
    (force.csv), the contact of wheel and blade; write calibration, cell and report into the folder `out`.

    method: full, geometry, relative or relative-literal; columns: a mapping file, for tables made by others (docs/formats.md).
    Raises BadInput: an argument or a file is not what it should be;
    Infeasible: the readings cannot be judged. Nothing is written then.
    """
    readings, cell_file, folder, phases = Path(tracker), Path(cell), Path(out), Phases(progress)
    inputs = [readings, *(Path(file) for file in (force, columns) if file is not None), *files_of(cell_file)]
    sealed = [file for given in inputs[:2] for file in given.parent.glob("sealed_*.csv")]
    with reserved(folder, overwrite, [*inputs, *sealed]) as output:
        for file in inputs:
            if file.is_dir():
                raise BadInput(f"{file}: is a folder; give the file in it, as {file / 'tracker.csv'}")
            if not file.is_file():
                raise BadInput(f"{file}: cannot be read (no such file); give the path of an existing file")
        mapping = OURS if columns is None else read_column_mapping(columns)
        ground = None
        if force is not None:
            believed, log = logged_cell(cell_file, Path(force), mapping)
            ground = replace(believed, calibration=None), log
        made = calibrate_tracker(readings, cell_file, method, phases, mapping)
        return _calibrated(made, ground, inputs, output, phases)


def _calibrated(
    made: TrackerCalibration, ground: tuple[Cell, ForceLog] | None, inputs: list[Path], output: Output, phases: Phases
) -> CalibrationResult:
    if not len(made.methods.before):
        path = made.fit.campaign.readings.path
        raise Infeasible(f"{path}: too few readings, outliers apart, to leave any out and judge the rest; measure more poses")
    methods, path = made.methods, made.fit.campaign.readings.path
    gain, half = methods.gained(made.method)
    if gain < -half:
        raise Infeasible(
            f"{path}: by method {made.method} left-out readings are met within {1e3 * methods.error[made.method].mean():.3f} mm "
            f"on average, {-1e3 * gain:.3f} +- {1e3 * half:.3f} mm worse than by the arm as believed "
            f"({1e3 * methods.before.mean():.3f} mm), so nothing is to be gained by it; {_remedy(made)}"
        )
    calibration, extra = tracker_calibration(made, inputs), list[Section]()
    if ground is None and (kept := carried_over(calibration, made.setup.calibration)) is not calibration:
        besides = ", ".join(name for name in kept.names if name not in calibration.names)
        earlier = f"no force log was given, so these stay as the cell's earlier calibration has them: {besides}"
        calibration, made = kept, replace(made, notices=(*made.notices, earlier))
    if ground is not None:
        with phases.phase("contact"):
            # Registered by the arm as it will be planned with, which bends where the readings say.
            bending = replace(with_calibration(ground[0], calibration), calibration=None)
            fit = fit_force(bending, without_ramps(ground[1]), calibration)
            refuse_other_force(bending, fit)
        calibration, extra = fit.calibration(calibration), contact_sections(fit)
    return write_tracker_calibration(made, calibration, extra, output, phases, inputs)


def _remedy(made: TrackerCalibration) -> str:
    """What to do about a calibration that makes things worse."""
    full = made.methods.gained("full")[0]
    if made.method != "full" and full > 0:
        return f"method full gains {1e3 * full:.3f} mm: use that one"
    return "measure more postures, and check that units, orientations and names are as docs/formats.md has them"


def logged_cell(cell_file: Path, force: Path, mapping: ColumnMapping = OURS) -> tuple[Cell, ForceLog]:
    """The cell, and the log of what was ground in it.

    Raises BadInput: the cell has no blade or wheel, the log is malformed or is not of this cell.
    """
    log = read_force_log(force, mapping=mapping)
    cell = read_cell(cell_file)
    if cell.workpiece.stl is None:
        raise BadInput(f"{cell_file}: workpiece.stl is missing; a force log needs the blade that was ground")
    refuse_force_unit(log, cell)
    return cell, log
