"""`python -m ocp.cell new|check|show`: a cell file to fill in, what is wrong or unmeasured in one, a page that shows it."""

from pathlib import Path
from typing import Annotated

import typer

from ocp.shell.command import NOT_SOLVED, OK, answer, command, command_line, main, shown_progress

app = command_line(
    "A cell of one's own: a new file, its examination, its page.", example="python -m ocp.cell check cell/cell.toml"
)


@command(app, "python -m ocp.cell new --robot kr210_r2700_extra --blade blade.stl", name="new", failed="no cell")
def _new(
    robot: Annotated[str, typer.Option(help="name in the catalogue, or the path of a robot file")],
    blade: Annotated[
        Path | None, typer.Option(help="the blade's file (STL, STEP, PLY, OBJ)", show_default="the bundled one")
    ] = None,
    out: Annotated[Path, typer.Option(help="folder to write")] = Path("cell"),
    overwrite: Annotated[bool, typer.Option(help="replace a folder that is not empty")] = False,
) -> str:
    """Write a cell file whose comments say what to measure for every number, and how."""
    from ocp.cell.interface import new_cell

    return answer(new_cell(robot, blade=blade, out=out, overwrite=overwrite))


@command(app, "python -m ocp.cell check cell/cell.toml", name="check", failed="not examined")
def _check(cell: Annotated[Path, typer.Argument(help="the cell file")]) -> str:
    """Read a cell file and all it names; tell mistakes, doubts, and what is not measured yet."""
    from ocp.cell.interface import check_cell

    with shown_progress() as progress:
        told = check_cell(cell, progress)
    return answer(told, OK if told.sound else NOT_SOLVED)


@command(app, "python -m ocp.cell show cell/cell.toml --out cell_page --open", name="show", failed="not shown")
def _show(
    cell: Annotated[Path, typer.Argument(help="the cell file")],
    out: Annotated[Path, typer.Option(help="folder to write")] = Path("cell_page"),
    overwrite: Annotated[bool, typer.Option(help="replace a folder that is not empty")] = False,
) -> str:
    """Write a page: the cell in three dimensions, frames, numbers for the controller, where the wheel may stand."""
    from ocp.cell.interface import show_cell

    with shown_progress() as progress:
        told = show_cell(cell, out=out, overwrite=overwrite, progress=progress)
    return answer(told, OK if told.sound else NOT_SOLVED)


if __name__ == "__main__":
    main(app)
