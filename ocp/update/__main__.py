"""`python -m ocp.update force.csv --cell cell.toml [--removal removal.csv]`: the cell after one more blade."""

from pathlib import Path
from typing import Annotated

import typer

from ocp.shell.command import answer, command, command_line, main, shown_progress

app = command_line()


@command(app, "python -m ocp.update force.csv --cell cell.toml --removal removal.csv", failed="not updated")
def _update(
    force: Annotated[Path, typer.Argument(help="force log of the last blade, force.csv")],
    cell: Annotated[Path, typer.Option(help="the cell file that the blade was ground with")],
    blade: Annotated[Path | None, typer.Option(help="that blade's file; without it the cell's own")] = None,
    removal: Annotated[Path | None, typer.Option(help="depths measured on that blade, removal.csv")] = None,
    changed: Annotated[
        list[str] | None,
        typer.Option(help="what was changed since: wheel, blade (its holder), flange, belt or sensor; repeat for more"),
    ] = None,
    out: Annotated[Path, typer.Option(help="folder to write")] = Path("update"),
    overwrite: Annotated[bool, typer.Option(help="replace a folder that is not empty")] = False,
) -> str:
    """Bring wheel, blade, flange and wear up to date from one blade's force log, without a new campaign."""
    asked = locals() | {"changed": changed or ()}  # as `interface.update` names them
    from ocp.update import interface

    with shown_progress() as progress:
        return answer(interface.update(**asked, progress=progress))


if __name__ == "__main__":
    main(app)
