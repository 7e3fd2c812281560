"""`python -m ocp.simulate [plan/] [--cell cell.toml]`: run a plan on a virtual cell, see the force, write the logs."""

from pathlib import Path
from typing import Annotated

import typer

from ocp.shell.command import answer, command, command_line, main, numbers, shown_progress

app = command_line()


@command(app, "python -m ocp.simulate plan --seed 3 --effect backlash:5=2e-4", failed="not simulated")
def _simulate(
    plan: Annotated[Path | None, typer.Argument(help="folder that ocp.plan wrote; without it only the tracker campaign")] = None,
    cell: Annotated[Path | None, typer.Option(help="the cell file; without it the one the plan was made with")] = None,
    blade: Annotated[
        Path | None, typer.Option(help="the blade's file (STL, STEP, PLY, OBJ), where it is not the cell's own")
    ] = None,
    effects: Annotated[
        list[str] | None, typer.Option("--effect", help="plant NAME[:JOINT][=SIZE], as backlash:5=2e-4; repeat for more")
    ] = None,
    random: Annotated[str | None, typer.Option("--effects", help="plant some at random, as random:2")] = None,
    sealed: Annotated[bool, typer.Option(help="tell nothing of what was planted, and keep readings back to predict")] = False,
    machine: Annotated[str, typer.Option(help="drawn (real errors), believed (none), sampled (of the calibration)")] = "drawn",
    seed: Annotated[int, typer.Option(help="which machine; the same seed is the same machine, calibrated or not")] = 0,
    size: Annotated[float, typer.Option(help="the machine's own errors, 1 as usual")] = 1.0,
    poses: Annotated[str, typer.Option(help="postures of the tracker campaign: a number, or a folder of ocp.poses")] = "40",
    ladder: Annotated[
        str | None, typer.Option(help="setpoints of the force ladder in N, as 12,20,28; none for no ladder")
    ] = None,
    belts: Annotated[str | None, typer.Option("--belt", help="further belt speeds in m/s, as 0,-20")] = None,
    air: Annotated[bool, typer.Option(help="log a pass with the flange drawn back")] = True,
    joints: Annotated[bool, typer.Option(help="write joints.csv, link-side encoders")] = False,
    hz: Annotated[float, typer.Option(help="control rate in 1/s")] = 250.0,
    log_hz: Annotated[float, typer.Option(help="rows of force.csv a second")] = 25.0,
    clock: Annotated[float, typer.Option(help="seconds that the campaign's clock shows at the start: wear, drift, steps")] = 0.0,
    list_effects: Annotated[bool, typer.Option(help="print what can be planted")] = False,
    out: Annotated[Path, typer.Option(help="folder to write")] = Path("run"),
    overwrite: Annotated[bool, typer.Option(help="replace a folder that is not empty")] = False,
) -> str:
    """Rehearse a plan on a virtual cell that shares no code with the planner, and write the data a real cell would give."""
    asked = {name: value for name, value in locals().items() if name != "list_effects"}  # as `interface.simulate` names them
    from ocp.simulate import interface

    if list_effects:
        return interface.plantable_effects()
    levels = () if (ladder or "").strip().lower() == "none" else numbers("--ladder", ladder)
    asked |= {"effects": effects or (), "ladder": levels, "belts": numbers("--belt", belts) or ()}
    with shown_progress() as progress:
        return answer(interface.simulate(**asked, progress=progress))


if __name__ == "__main__":
    main(app)
