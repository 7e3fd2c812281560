"""`python -m ocp.experiments`: the paper's experiments on many virtual robots, with its numbers beside ours."""

from pathlib import Path
from typing import Annotated

import typer

from ocp.data import CELL
from ocp.shell.command import command, command_line, main, shown_progress
from robots.bounds import refuse_outside
from robots.errors import BadInput

app = command_line()


@command(app, "python -m ocp.experiments --robots 30 --out experiments", failed="no experiment")
def _experiments(
    cell: Annotated[Path, typer.Option(help="the cell file", show_default="the bundled one")] = CELL,
    robots: Annotated[int, typer.Option(help="how many virtual robots")] = 30,
    seed: Annotated[int, typer.Option(help="number of the first robot")] = 0,
    poses: Annotated[int, typer.Option(help="readings of each calibration")] = 40,
    mount: Annotated[str, typer.Option(help="flange, rigid or both")] = "both",
    jobs: Annotated[int, typer.Option(help="processes; 0: as many as there are cores")] = 0,
    scheduler: Annotated[str | None, typer.Option(help="tcp://..: a Dask cluster does it instead")] = None,
    out: Annotated[Path, typer.Option(help="folder to write")] = Path("experiments"),
    overwrite: Annotated[bool, typer.Option(help="replace a folder that is not empty")] = False,
) -> str:
    """Calibrate virtual robots, compensate, grind: positions by four methods and force after each step, with a report."""
    from ocp.experiments.grinding import MOUNTS
    from ocp.experiments.report import last_line, write_experiments
    from ocp.experiments.trial import run_trials, trials_json
    from ocp.model.cell import files_of, read_cell
    from ocp.shell.executor import Hands
    from ocp.shell.output import reserved
    from ocp.shell.processes import cores
    from ocp.shell.progress import Phases

    if mount not in (*MOUNTS, "both"):
        raise BadInput(f"--mount '{mount}' is not flange, rigid or both")
    refuse_outside(("--robots", robots, 1, 10000, ""), ("--poses", poses, 20, 1000, ""))
    refuse_outside(("--seed", seed, 0, 2**31, ""), ("--jobs", jobs, 0, 64, ""))
    hands = Hands(jobs or cores(), scheduler)
    mounts = list(MOUNTS) if mount == "both" else [mount]
    seeds = list(range(seed, seed + robots))
    with reserved(out, overwrite, files_of(cell)) as output:
        believed = read_cell(cell)
        with shown_progress() as progress:
            trials = run_trials(believed, mounts, seeds, poses, hands, Phases(progress))
        options: dict[str, object] = {"cell": believed.name, "robots": robots, "seed": seed, "poses": poses, "mounts": mounts}
        with output.whole() as folder:
            (folder / "experiments.json").write_text(trials_json(trials, options))
            write_experiments(trials, believed.process.force, folder)
    return f"{out}: {last_line(trials, believed.process.force)}. {out / 'report.html'} has tables and figures."


if __name__ == "__main__":
    main(app)
