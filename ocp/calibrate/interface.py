"""`ocp.api.calibrate`: tracker readings, with a force log or without; a calibrated cell with its covariance out."""

from pathlib import Path

from ocp.calibrate.contact import contact_from
from ocp.calibrate.files import CalibrationResult, write_tracker_calibration
from ocp.calibrate.tracker import calibrate_tracker
from ocp.model.measuring_setup import files_of
from ocp.shell.progress import Phases, Progress


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
