"""The contact side of `python -m ocp.calibrate`: a force log joined to the arm's calibration."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np

from ocp.calibrate.force.log import read_force_log
from ocp.calibrate.force.registration import fit_force
from ocp.calibrate.report.contact import contact_sections
from ocp.model.cell import read_cell
from ocp.report.section import Section
from ocp.shell.progress import Phases
from robots.calibration.store import Calibration
from robots.errors import BadInput

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
