"""`python -m ocp.blindtest`: the diagnosis judged on sealed worlds, against its rivals, chance and the oracle."""

from pathlib import Path
from typing import Annotated

import typer

from ocp.data import CELL
from ocp.shell.command import answer, command, command_line, main, shown_progress

app = command_line()
ALL = "single,none,none_background,pair,triple,outside,left_out"


@command(app, "python -m ocp.blindtest --worlds 95 --seed 101 --out blindtest", failed="not judged")
def _blindtest(
    worlds: Annotated[int, typer.Option(help="how many worlds; more than before goes on where the last run ended")] = 95,
    kinds: Annotated[str, typer.Option(help="kinds of worlds, with commas; all by default")] = ALL,
    signals: Annotated[str, typer.Option(help="what is measured: tracker, force or both")] = "tracker",
    seed: Annotated[int, typer.Option(help="everything is drawn from it")] = 1,
    jobs: Annotated[int, typer.Option(help="processes; 0: one for each core")] = 0,
    scheduler: Annotated[str | None, typer.Option(help="tcp://..: a Dask cluster does it instead")] = None,
    out: Annotated[Path, typer.Option(help="folder of worlds, answers, scores and report")] = Path("blindtest"),
    cell: Annotated[Path | None, typer.Option(help="the cell whose machines are drawn; the bundled one")] = None,
    readings: Annotated[int, typer.Option(help="readings of a campaign")] = 150,
    again: Annotated[bool, typer.Option(help="answer all worlds anew, with the diagnosis as it is now")] = False,
    overwrite: Annotated[bool, typer.Option(help="begin anew, with new worlds")] = False,
) -> str:
    """Draw and seal worlds, let the diagnosis answer them blind, then open the labels and score."""
    asked = dict(locals())  # as `interface.blindtest` names them
    from ocp.blindtest import interface

    with shown_progress() as progress:
        return answer(interface.blindtest(**asked | {"kinds": kinds.split(","), "cell": cell or CELL}, progress=progress))


if __name__ == "__main__":
    main(app)
