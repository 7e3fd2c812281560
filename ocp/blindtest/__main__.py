"""`python -m ocp.blindtest`: the diagnosis judged on sealed worlds, against its rivals, chance and the oracle."""

import shutil
import sys
from pathlib import Path
from typing import Annotated

import typer

from ocp.data import CELL
from ocp.shell.command import main, run, shown_phases

app = typer.Typer(add_completion=False, pretty_exceptions_enable=False)
SIGNALS = ("tracker", "force", "both")
ALL = "single,none,none_background,pair,triple,outside,left_out"


@app.command()
def blindtest(
    worlds: Annotated[int, typer.Option(help="how many worlds; more than before goes on where the last run ended")] = 95,
    kinds: Annotated[str, typer.Option(help="kinds of worlds, with commas; all by default")] = ALL,
    signals: Annotated[str, typer.Option(help="what is measured: tracker, force or both")] = "tracker",
    seed: Annotated[int, typer.Option(help="everything is drawn from it")] = 1,
    jobs: Annotated[int, typer.Option(help="processes; 0: one for each core")] = 0,
    out: Annotated[Path, typer.Option(help="folder of worlds, answers, scores and report")] = Path("blindtest"),
    cell: Annotated[Path | None, typer.Option(help="the cell whose machines are drawn; the bundled one")] = None,
    readings: Annotated[int, typer.Option(help="readings of a campaign")] = 150,
    again: Annotated[bool, typer.Option(help="answer all worlds anew, with the diagnosis as it is now")] = False,
    overwrite: Annotated[bool, typer.Option(help="begin anew, with new worlds")] = False,
) -> None:
    """Draw and seal worlds, let the diagnosis answer them blind, then open the labels and score."""
    from ocp.blindtest.worlds.recipes import check_kinds, recipes  # heavy imports only once the arguments stand
    from ocp.shell.workers import cores
    from robots.errors import BadInput

    def job() -> str:
        from ocp.blindtest.report.page import last_line, write_blindtest_report
        from ocp.blindtest.running import answer_all, forget_answers, make_all, resume, score_all
        from ocp.blindtest.worlds.sealing import Check, write_cell

        if signals not in SIGNALS:
            raise BadInput(f"--signals '{signals}' is not one of {', '.join(SIGNALS)}")
        limits = (("--worlds", worlds, 1, 20000), ("--readings", readings, 40, 2000), ("--jobs", jobs, 0, 64))
        for name, value, low, high in limits:
            if not low <= value <= high:
                raise BadInput(f"{name} {value} must lie between {low} and {high}")
        check = Check(out, seed, worlds, check_kinds(kinds, signals), readings, signals=signals)
        if overwrite and out.is_dir():
            if not (out / "plan.json").is_file() and any(out.iterdir()):
                raise BadInput(f"{out}: holds no blind check; --overwrite would delete it, give another --out")
            shutil.rmtree(out)
        resume(check, overwrite)
        if not check.cell.is_file():
            write_cell(cell or CELL, check.cell, signals)
        if again:
            forget_answers(check)
        planned, count = recipes(worlds, check.kinds), jobs or cores()
        with shown_phases() as phases:
            make_all(check, planned, count, phases)
            answer_all(check, planned, count, phases)
            rows = score_all(check, planned, count, phases)
            with phases.phase("report"):
                write_blindtest_report(check, rows)
        return last_line(check, rows)

    sys.exit(run(job, "not judged"))


if __name__ == "__main__":
    main(app)
