"""`ocp.api.blindtest`: worlds drawn and sealed, answered by the diagnosis without their labels, then judged."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from ocp.blindtest.figures import Figure, all_figures
from ocp.blindtest.record import Standing, entered, refuse_unrecorded
from ocp.blindtest.report import blindtest_last_line, write_blindtest_report
from ocp.blindtest.running import answer_all, forget_answers, make_all, resume, score_all
from ocp.blindtest.worlds.recipes import KINDS, SIGNALS, check_kinds, recipes
from ocp.blindtest.worlds.sealing import CELL as CELL_FILE
from ocp.blindtest.worlds.sealing import Check, write_cell
from ocp.data import CELL
from ocp.model.cell import files_of
from ocp.shell.executor import Hands
from ocp.shell.output import files_added, reserved
from ocp.shell.processes import cores
from ocp.shell.progress import Phases, Progress
from robots.errors import BadInput


@dataclass(frozen=True)
class BlindtestResult:
    """A blind check: its folder, one row of scores a world, the figures with their intervals and targets, what its answers are to
    its seed, and the one line that says how many figures are reached."""

    folder: Path
    rows: tuple[dict[str, Any], ...]
    figures: tuple[Figure, ...]
    standing: Standing
    line: str
    notices: tuple[str, ...] = ()


def blindtest(
    *,
    out: str | Path,
    worlds: int = 95,
    kinds: Sequence[str] = KINDS,
    signals: str = "tracker",
    seed: int = 1,
    jobs: int = 0,
    scheduler: str | None = None,
    cell: str | Path = CELL,
    readings: int = 150,
    again: bool = False,
    overwrite: bool = False,
    progress: Progress | None = None,
) -> BlindtestResult:
    """Draw and seal worlds, let the diagnosis answer them blind, then open the labels and score; worlds, answers, scores and
    report stand in the folder `out`, where a later call with the same arguments goes on.

    worlds: how many; kinds of worlds; signals: tracker, force or both; seed: everything is drawn from it, 1 to 99 for
    development, the answers to any other are entered in the repository's record; jobs: processes (0:
    one for each core); scheduler: address of a Dask scheduler whose workers do it instead; cell: whose machines are drawn;
    readings of a campaign; again: answer all worlds anew; overwrite: begin anew, with new worlds. Raises BadInput: an argument
    is not what it should be, or `out` holds something else.
    """
    folder = Path(out)
    if signals not in SIGNALS:
        raise BadInput(f"--signals '{signals}' is not one of {', '.join(SIGNALS)}")
    limits = (("--worlds", worlds, 1, 20000), ("--readings", readings, 40, 2000), ("--jobs", jobs, 0, 64))
    for name, value, low, high in limits:
        if not low <= value <= high:
            raise BadInput(f"{name} {value} must lie between {low} and {high}")
    check = Check(folder, seed, worlds, check_kinds(",".join(kinds), signals), readings, signals=signals)
    refuse_unrecorded(check)
    with reserved(folder, overwrite, files_of(cell), grows=True) as output, output.grown():
        return _judged(check, Path(cell), again, Hands(jobs or cores(), scheduler), Phases(progress))


def _judged(check: Check, cell: Path, again: bool, hands: Hands, phases: Phases) -> BlindtestResult:
    resume(check)
    if not check.cell.is_file():
        with files_added(check.folder, last=CELL_FILE) as part:
            write_cell(cell, replace(check, folder=part).cell, check.signals)
    if again:
        forget_answers(check)
    planned = recipes(check.worlds, check.kinds)
    make_all(check, planned, hands, phases)
    answer_all(check, planned, hands, phases)
    standing = entered(check)
    rows = score_all(check, planned, hands, phases)
    with phases.phase("report"):
        write_blindtest_report(check, rows, standing)
    line = blindtest_last_line(check, rows, standing)
    return BlindtestResult(check.folder, tuple(rows), tuple(all_figures(rows)), standing, line)
