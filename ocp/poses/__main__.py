"""`python -m ocp.poses --cell cell.toml -n 40`: where to measure before a calibration."""

import sys
from pathlib import Path
from typing import Annotated

import numpy as np
import typer

from ocp.data import CELL
from ocp.shell.command import main, run, shown_phases
from robots.errors import BadInput

CHOICES = ("zone", "O1", "O2", "O3", "O4", "O5")

app = typer.Typer(add_completion=False, pretty_exceptions_enable=False)


@app.command()
def poses(
    cell: Annotated[Path, typer.Option(help="the cell file")] = CELL,
    count: Annotated[int, typer.Option("-n", help="how many poses; each is read twice, approached from either side")] = 40,
    criterion: Annotated[str, typer.Option(help="zone (accuracy at the wheel), or O1 to O5 of the literature")] = "zone",
    payload: Annotated[list[str] | None, typer.Option(help="a payload to hang on; repeat for more")] = None,
    targets: Annotated[list[str] | None, typer.Option(help="a reflector nest to read; repeat for more")] = None,
    tracker: Annotated[str | None, typer.Option(help="place of the tracker head x,y,z in mm, base frame")] = None,
    seed: Annotated[int, typer.Option(help="of the random candidates")] = 0,
    name: Annotated[str, typer.Option(help="first part of the programs' names")] = "POSES",
    approach: Annotated[float, typer.Option(help="how far before every axis an approach begins, deg")] = 2.0,
    wait: Annotated[float | None, typer.Option(help="seconds to stand at a reading; without it the program halts")] = None,
    wait_input: Annotated[int | None, typer.Option("--input", help="wait for this input of the controller instead")] = None,
    speed: Annotated[int, typer.Option(help="percent of the axis speeds")] = 20,
    acceptance: Annotated[float | None, typer.Option(help="of a reflector, deg about away from its link's z axis")] = None,
    prior_mm: Annotated[float, typer.Option(help="one sigma of lengths before the calibration, mm")] = 1.0,
    prior_mrad: Annotated[float, typer.Option(help="one sigma of angles before the calibration, mrad")] = 1.0,
    joint_noise: Annotated[float, typer.Option(help="repeatability of an axis, one sigma in urad")] = 10.0,
    out: Annotated[Path, typer.Option(help="folder to write")] = Path("poses"),
    overwrite: Annotated[bool, typer.Option(help="replace a folder that is not empty")] = False,
) -> None:
    """Choose the poses of a laser-tracker campaign, tell what accuracy they will give, and write CSV and KRL programs."""
    from ocp.poses.files import write_poses  # heavy imports only once the arguments stand
    from ocp.poses.planning import PoseOptions, make_poses
    from ocp.poses.program import Pausing, base_name
    from robots.calibration.layout import Priors
    from robots.calibration.noise import Noise

    def job() -> str:
        if criterion not in CHOICES:
            raise BadInput(f"--criterion '{criterion}' is not one of {', '.join(CHOICES)}")
        _within("--approach", approach, 0.1, 20.0, "deg")
        _within("--speed", speed, 1, 100, "percent")
        _within("--wait", wait, 0.1, 3600.0, "s")
        _within("--input", wait_input, 1, 8192, "")
        _within("--acceptance", acceptance, 1.0, 180.0, "deg")
        _within("--prior-mm", prior_mm, 1e-3, 100.0, "mm")
        _within("--prior-mrad", prior_mrad, 1e-3, 100.0, "mrad")
        _within("--joint-noise", joint_noise, 0.1, 1000.0, "urad")
        _within("--seed", seed, 0, 2**32, "")
        if wait is not None and wait_input is not None:
            raise BadInput("--wait and --input exclude each other; give one of them")
        options = PoseOptions(
            count=count, criterion=criterion, payloads=tuple(payload or ()), targets=tuple(targets or ()),
            tracker=_place(tracker), seed=seed, name=base_name(name), approach=float(np.radians(approach)),
            pausing=Pausing(wait, wait_input), speed=speed,
            acceptance=None if acceptance is None else float(np.radians(acceptance)),
            priors=Priors(length=1e-3 * prior_mm, angle=1e-3 * prior_mrad), noise=Noise(1e-6 * joint_noise),
        )  # fmt: skip
        with shown_phases() as phases:
            return write_poses(lambda: make_poses(cell, options, phases), out, overwrite, phases, [cell])

    sys.exit(run(job, "no poses chosen"))


def _within(name: str, value: float | None, low: float, high: float, unit: str) -> None:
    if value is not None and not low <= value <= high:
        raise BadInput(f"{name} {value:g} must lie between {low:g} and {high:g} {unit}".rstrip())


def _place(text: str | None) -> np.ndarray | None:
    """x,y,z in mm as (3,) m."""
    if text is None:
        return None
    try:
        values = np.array([float(part) for part in text.split(",")])
    except ValueError:
        values = np.empty(0)
    if values.shape != (3,):
        raise BadInput(f"--tracker '{text}' must be x,y,z in mm in the base frame, as 2500,2500,1500")
    return 1e-3 * values


if __name__ == "__main__":
    main(app)
