"""`python -m ocp.poses --cell cell.toml -n 40`: where to measure before a calibration."""

from pathlib import Path
from typing import Annotated

import numpy as np
import typer

from ocp.data import CELL
from ocp.shell.command import answer, command, command_line, main, numbers, shown_progress

app = command_line()


@command(app, "python -m ocp.poses --cell cell.toml -n 40 --payload bare --payload weight", failed="no poses chosen")
def _poses(
    cell: Annotated[Path, typer.Option(help="the cell file", show_default="the bundled one")] = CELL,
    count: Annotated[int, typer.Option("-n", help="how many poses; each is read twice, approached from either side")] = 40,
    criterion: Annotated[str, typer.Option(help="zone (accuracy at the wheel), or O1 to O5 of the literature")] = "zone",
    payloads: Annotated[list[str] | None, typer.Option("--payload", help="a payload to hang on; repeat for more")] = None,
    targets: Annotated[list[str] | None, typer.Option(help="a reflector nest to read; repeat for more")] = None,
    tracker: Annotated[str | None, typer.Option(help="place of the tracker head x,y,z in mm, base frame")] = None,
    seed: Annotated[int, typer.Option(help="of the random candidates")] = 0,
    name: Annotated[str, typer.Option(help="first part of the programs' names")] = "POSES",
    approach: Annotated[float, typer.Option(help="how far before every axis an approach begins, deg")] = 2.0,
    wait: Annotated[float | None, typer.Option(help="seconds to stand at a reading; without it the program halts")] = None,
    wait_input: Annotated[int | None, typer.Option("--input", help="wait for this input of the controller instead")] = None,
    speed: Annotated[int, typer.Option(help="percent of the axis speeds")] = 20,
    acceptance: Annotated[float | None, typer.Option(help="of a reflector, deg about away from its link's z axis")] = None,
    length_sd: Annotated[float, typer.Option("--prior-mm", help="one sigma of lengths before the calibration, mm")] = 1.0,
    angle_sd: Annotated[float, typer.Option("--prior-mrad", help="one sigma of angles before the calibration, mrad")] = 1.0,
    joint_noise: Annotated[float, typer.Option(help="repeatability of an axis, one sigma in urad")] = 10.0,
    out: Annotated[Path, typer.Option(help="folder to write")] = Path("poses"),
    overwrite: Annotated[bool, typer.Option(help="replace a folder that is not empty")] = False,
) -> str:
    """Choose the poses of a laser-tracker campaign, tell what accuracy they will give, and write CSV and KRL programs."""
    asked = dict(locals())  # as `interface.choose_poses` names them, but in the units of the command line
    from ocp.poses import interface

    head = numbers("--tracker", tracker, "x,y,z in mm in the base frame, as 2500,2500,1500", 3)
    lists = {"payloads": payloads or (), "targets": targets or (), "tracker": head and [1e-3 * v for v in head]}
    angles = {n: None if asked[n] is None else float(np.radians(asked[n])) for n in ("approach", "acceptance")}
    sizes = {"length_sd": 1e-3 * length_sd, "angle_sd": 1e-3 * angle_sd, "joint_noise": 1e-6 * joint_noise}
    with shown_progress() as progress:
        return answer(interface.choose_poses(**asked | lists | angles | sizes, progress=progress))


if __name__ == "__main__":
    main(app)
