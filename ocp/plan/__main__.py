"""`python -m ocp.plan [blade.stl] [--cell cell.toml]`: a verified KRL program and a report."""

import sys
from pathlib import Path
from typing import Annotated

import typer

from ocp.data import CELL
from ocp.shell.command import answer, command, command_line, main, run, shown_progress

app = command_line()


@command(app, "python -m ocp.plan blade.stl --cell cell.toml --out plan")
def _plan(
    blade: Annotated[Path | None, typer.Argument(help="the blade's STL; without it the cell's own")] = None,
    cell: Annotated[Path, typer.Option(help="the cell file", show_default="the bundled one")] = CELL,
    out: Annotated[Path, typer.Option(help="folder to write")] = Path("plan"),
    overwrite: Annotated[bool, typer.Option(help="replace a folder that is not empty")] = False,
    path: Annotated[Path | None, typer.Option(help="contact points made elsewhere, path.csv")] = None,
    program: Annotated[Path | None, typer.Option(help="take the path from an existing KRL program, old.src")] = None,
    stock: Annotated[Path | None, typer.Option(help="map of the depth to take off, stock.csv or .ply; without it even")] = None,
    kind: Annotated[str, typer.Option(help="axis (timed splines), cartesian (#TCP splines) or lin (KSS 5)")] = "axis",
    name: Annotated[str | None, typer.Option(help="name of the program; without it the blade's")] = None,
    step: Annotated[float, typer.Option(help="distance of waypoints in mm")] = 0.5,
    whole: Annotated[bool, typer.Option(help="refuse the blade where any of it has to be left out")] = False,
) -> None:
    """Plan the grinding of a blade: joints that hold the process force, KRL files and a report to look at first."""
    from ocp.plan import interface  # heavy imports only once the arguments stand

    def job() -> str:
        with shown_progress() as progress:
            return answer(
                interface.plan(
                    blade,
                    out=out,
                    cell=cell,
                    overwrite=overwrite,
                    path=path,
                    program=program,
                    stock=stock,
                    kind=kind,
                    name=name,
                    step=step * 1e-3,
                    whole=whole,
                    progress=progress,
                )
            )

    sys.exit(run(job))


if __name__ == "__main__":
    main(app)
