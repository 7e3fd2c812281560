"""`ocp.api.calibrate`: tracker readings, with a force log or without; a calibrated cell with its covariance out."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np

from ocp.calibrate.files import CalibrationResult, write_tracker_calibration
from ocp.calibrate.force.log import read_force_log
from ocp.calibrate.force.registration import fit_force
from ocp.calibrate.report.pages import contact_sections
from ocp.calibrate.tracker import calibrate_tracker
from ocp.model.cell import files_of, read_cell
from ocp.report.section import Section
from ocp.shell.progress import Phases, Progress
from robots.calibration.store import Calibration
from robots.errors import BadInput


def calibrate(
    tracker: str | Path,
    *,
    cell: str | Path,
    out: str | Path,
    force: str | Path | None = None,
    method: str = "full",
    overwrite: bool = False,
    progress: Progress | None = None,
) -> CalibrationResult:
    """Calibrate the robot of `cell` from the readings `tracker` (tracker.csv) and, with the log `force` of a force ladder
    (force.csv), the contact of wheel and blade; write calibration, cell and report into the folder `out`.

    method: full, geometry, relative or relative-literal. Raises BadInput: an argument or a file is not what it should be;
    Infeasible: the readings cannot be judged. Nothing is written then.
    """
    readings, cell_file, log = Path(tracker), Path(cell), None if force is None else Path(force)
    inputs = [readings, *([] if log is None else [log]), *files_of(cell_file)]
    phases = Phases(progress)
    contact = None if log is None else contact_from(cell_file, log, phases)
    return write_tracker_calibration(
        lambda: calibrate_tracker(readings, cell_file, method, phases), Path(out), overwrite, phases, inputs, contact
    )


UNITS = 30.0  # kilonewtons and grams-force are farther off than any setpoint of a ladder
Joined = tuple[Calibration, list[Section]]


def contact_from(cell_file: Path, force: Path, phases: Phases) -> Callable[[Calibration], Joined]:
    """A function that joins wheel, blade, flange and sensor of a force log to the arm's calibration, and says what of them
    belongs in the report. Cell and log are read at once.

    Raises BadInput, Infeasible: the cell has no blade or wheel, the log is malformed or is not of this cell.
    """
    log = read_force_log(force)
    cell = read_cell(cell_file)
    if cell.workpiece.stl is None:
        raise BadInput(f"{cell_file}: workpiece.stl is missing; a force log needs the blade that was ground")

    wanted = cell.flange.setpoint if cell.flange is not None else cell.process.force
    seen = float(np.median(log.fn[log.contact])) if log.contact.any() else wanted
    if wanted > 0 and not 1 / UNITS < seen / wanted < UNITS:
        raise BadInput(
            f"{force}, column fn_N: {seen:.3g} N in contact (median) where the cell asks for {wanted:g} N; give newtons, or "
            "correct the cell's setpoint_N"
        )

    def join(arm: Calibration) -> Joined:
        with phases.phase("contact"):
            fit = fit_force(replace(cell, calibration=None), log, arm)
        return fit.calibration(arm), contact_sections(fit)

    return join
