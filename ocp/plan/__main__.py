"""`python -m ocp.plan [blade.stl ..] [--cell cell.toml]`: a verified KRL program and a report, of one blade or of each."""

from pathlib import Path
from typing import Annotated, Any

import typer

from ocp.data import CELL
from ocp.shell.command import NOT_SOLVED, OK, answer, command, command_line, main, shown_progress
from robots.errors import BadInput

app = command_line()


@command(app, "python -m ocp.plan blade.stl --cell cell.toml --out plan", "python -m ocp.plan a.stl b.stl --out night")
def _plan(
    blade: Annotated[
        list[Path] | None,
        typer.Argument(help="the blade's file (STL, STEP, PLY, OBJ); without it the cell's own; several: a plan each"),
    ] = None,
    cell: Annotated[Path, typer.Option(help="the cell file", show_default="the bundled one")] = CELL,
    out: Annotated[Path, typer.Option(help="folder to write; of several blades one that a later call goes on with")] = Path(
        "plan"
    ),
    overwrite: Annotated[bool, typer.Option(help="replace a folder that is not empty")] = False,
    path: Annotated[Path | None, typer.Option(help="contact points made elsewhere, path.csv")] = None,
    program: Annotated[Path | None, typer.Option(help="take the path from an existing KRL program, old.src")] = None,
    stock: Annotated[Path | None, typer.Option(help="map of the depth to take off, stock.csv or .ply; without it even")] = None,
    kind: Annotated[str, typer.Option(help="axis (timed splines), cartesian (#TCP splines) or lin (KSS 5)")] = "axis",
    name: Annotated[str | None, typer.Option(help="name of the program; without it the blade's")] = None,
    step: Annotated[float, typer.Option(help="distance of waypoints in mm")] = 1.0,
    whole: Annotated[bool, typer.Option(help="refuse the blade where any of it has to be left out")] = False,
    jobs: Annotated[int, typer.Option(help="several blades: processes, a blade each; 0: one for each core")] = 0,
    scheduler: Annotated[str | None, typer.Option(help="several blades, tcp://..: a Dask cluster plans them")] = None,
) -> str:
    """Plan the grinding of a blade: joints that hold the process force, KRL files and a report to look at first."""
    from ocp.plan.interface import plan_unless_kept

    several = len(blade or ()) > 1
    one: dict[str, Any] = {"path": path, "program": program, "name": name}
    if several and (option := next((key for key, value in one.items() if value is not None), None)):
        raise BadInput(f"--{option} is of one blade and {len(blade or ())} are named; plan that blade alone")
    if not several and (jobs or scheduler is not None):
        raise BadInput("--jobs and --scheduler spread several blades and there is one; leave them out")
    asked: dict[str, Any] = {"out": out, "cell": cell, "overwrite": overwrite, "stock": stock, "kind": kind, "whole": whole}
    with shown_progress() as progress:
        asked |= {"step": step * 1e-3, "progress": progress}
        if not several:
            return answer(plan_unless_kept(blade[0] if blade else None, **asked, **one))
        from ocp.plan import night

        made = night.plan_night(blade or (), **asked, jobs=jobs, scheduler=scheduler)
        return answer(made, NOT_SOLVED if made.failed else OK)


if __name__ == "__main__":
    main(app)
