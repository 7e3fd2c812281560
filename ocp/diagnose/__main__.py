"""`python -m ocp.diagnose run/`: where the gap lies, which effect causes it, how far it shrinks, what to measure next."""

from pathlib import Path
from typing import Annotated

import typer

from ocp.shell.command import answer, command, command_line, main, shown_progress

app = command_line()


@command(app, "python -m ocp.diagnose run --out diagnosis", failed="not diagnosed")
def _diagnose(
    folder: Annotated[Path | None, typer.Argument(help="data set: cell.toml with tracker.csv, force.csv, joints.csv")] = None,
    out: Annotated[Path | None, typer.Option(help="folder to write", show_default="diagnosis")] = None,
    columns: Annotated[
        Path | None, typer.Option(help="mapping file: which of a table's columns is which (docs/formats.md)")
    ] = None,
    overwrite: Annotated[bool, typer.Option(help="replace a folder that is not empty")] = False,
    design: Annotated[Path | None, typer.Option(help="a cell: what a planned measurement could see, before any data")] = None,
    poses: Annotated[
        Path | None, typer.Option(help="with --design: the planned readings, as tracker.csv without x, y, z")
    ] = None,
    log: Annotated[
        Path | None, typer.Option(help="with --design: the planned force log, as force.csv without fn_N, or plan.csv of ocp.plan")
    ] = None,
    list_effects: Annotated[bool, typer.Option(help="list the catalogue with units and usual ranges")] = False,
) -> str:
    """Say where model and cell differ, which effect causes it, and how far the gap shrinks with it."""
    from robots.errors import BadInput, shown  # imports only what the arguments ask for

    if list_effects:
        from ocp.effects.catalogue import effect_list

        return effect_list()
    for name, file in (("--poses", poses), ("--log", log)):
        if file is not None and design is None:
            raise BadInput(f"{name} goes with --design cell.toml; what was measured belongs into the data set's folder")
    if design is not None and (given := folder or columns) is not None:
        raise BadInput(f"{given}: --design looks at a plan, not at a data set; give one of them")
    if design is not None and out is not None:
        raise BadInput(f"--out {shown(out)}: --design prints a table and writes nothing; leave it out")
    if design is not None:
        from ocp.diagnose.foresee.design import design_text

        return design_text(design, poses, log)
    if folder is None:
        raise BadInput("no data set is named; give the folder that holds cell.toml and measurements, or --design cell.toml")
    from ocp.diagnose.interface import diagnose

    with shown_progress() as progress:
        return answer(diagnose(folder, out=out or Path("diagnosis"), columns=columns, overwrite=overwrite, progress=progress))


if __name__ == "__main__":
    main(app)
