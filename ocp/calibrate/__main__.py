"""`python -m ocp.calibrate tracker.csv --cell cell.toml`: a calibrated arm with its covariance and a report."""

from pathlib import Path
from typing import Annotated

import typer

from ocp.shell.command import answer, command, command_line, main, shown_progress

app = command_line()


@command(app, "python -m ocp.calibrate tracker.csv --cell cell.toml --force force.csv", failed="not calibrated")
def _calibrate(
    tracker: Annotated[Path, typer.Argument(help="laser-tracker readings, tracker.csv")],
    cell: Annotated[Path, typer.Option(help="the cell file")],
    force: Annotated[Path | None, typer.Option(help="grinding-force log of a force ladder, force.csv")] = None,
    method: Annotated[str, typer.Option(help="full, geometry, relative or relative-literal")] = "full",
    columns: Annotated[
        Path | None, typer.Option(help="mapping file: which of a table's columns is which (docs/formats.md)")
    ] = None,
    out: Annotated[Path, typer.Option(help="folder to write")] = Path("calibration"),
    overwrite: Annotated[bool, typer.Option(help="replace a folder that is not empty")] = False,
) -> str:
    """Calibrate the robot from laser-tracker readings and, with a force log, the contact of blade and wheel."""
    asked = dict(locals())  # as `interface.calibrate` names them
    from ocp.calibrate import interface

    with shown_progress() as progress:
        return answer(interface.calibrate(**asked, progress=progress))


if __name__ == "__main__":
    main(app)
