"""`python -m ocp.calibrate tracker.csv --cell cell.toml`: a calibrated arm with its covariance and a report."""

import sys
from pathlib import Path
from typing import Annotated

import typer

from ocp.shell.command import main, run, shown_phases

app = typer.Typer(add_completion=False, pretty_exceptions_enable=False)


@app.command()
def calibrate(
    tracker: Annotated[Path, typer.Argument(help="laser-tracker readings, tracker.csv")],
    cell: Annotated[Path, typer.Option(help="the cell file")],
    force: Annotated[Path | None, typer.Option(help="grinding-force log of a force ladder, force.csv")] = None,
    method: Annotated[str, typer.Option(help="full, geometry, relative or relative-literal")] = "full",
    out: Annotated[Path, typer.Option(help="folder to write")] = Path("calibration"),
    overwrite: Annotated[bool, typer.Option(help="replace a folder that is not empty")] = False,
) -> None:
    """Calibrate the robot from laser-tracker readings and, with a force log, the contact of blade and wheel."""
    from ocp.calibrate.contact import contact_from
    from ocp.calibrate.files import write_tracker_calibration
    from ocp.calibrate.tracker import calibrate_tracker  # heavy imports only once the arguments stand
    from ocp.model.measuring_setup import files_of

    def job() -> str:
        inputs = [file for file in (tracker, force) if file is not None] + files_of(cell)
        with shown_phases() as phases:
            contact = None if force is None else contact_from(cell, force, phases)
            return write_tracker_calibration(
                lambda: calibrate_tracker(tracker, cell, method, phases), out, overwrite, phases, inputs, contact
            )

    sys.exit(run(job, "not calibrated"))


if __name__ == "__main__":
    main(app)
