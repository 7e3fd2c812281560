"""`python -m ocp.robot new NAME`, `python -m ocp.robot import FILE.urdf`: a robot file to name in a cell."""

from pathlib import Path
from typing import Annotated

import typer

from ocp.shell.command import answer, command, command_line, main

app = command_line("A robot file of one's own: from a data sheet, or from a URDF.", example="python -m ocp.robot import arm.urdf")


@command(app, "python -m ocp.robot new my_arm --out robot", name="new", failed="no robot")
def _new(
    name: Annotated[str, typer.Argument(help="name of the robot, of letters, digits, _ . -")],
    out: Annotated[Path, typer.Option(help="folder to write")] = Path("robot"),
    overwrite: Annotated[bool, typer.Option(help="replace a folder that is not empty")] = False,
) -> str:
    """Write a robot file with a geometry to replace, and what a data sheet's numbers mean."""
    from ocp.robot.interface import new_robot

    return answer(new_robot(name, out=out, overwrite=overwrite))


@command(app, "python -m ocp.robot import arm.urdf --out robot", name="import", failed="no robot")
def _import(
    urdf: Annotated[Path, typer.Argument(help="the arm's URDF")],
    flange: Annotated[str | None, typer.Option(help="link that the tool is screwed to; without it the last of the chain")] = None,
    name: Annotated[str | None, typer.Option(help="name of the robot; without it the URDF's")] = None,
    out: Annotated[Path, typer.Option(help="folder to write")] = Path("robot"),
    overwrite: Annotated[bool, typer.Option(help="replace a folder that is not empty")] = False,
) -> str:
    """Write a robot file from a URDF: geometry in MD-H form, limits, masses."""
    from ocp.robot.interface import import_robot

    return answer(import_robot(urdf, out=out, flange=flange, name=name, overwrite=overwrite))


if __name__ == "__main__":
    main(app)
