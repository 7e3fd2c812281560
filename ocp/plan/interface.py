"""`ocp.api.plan`: blade and cell in; a verified program, its table and a report out."""

from pathlib import Path
from typing import TYPE_CHECKING, Any

from ocp.data import CELL
from ocp.model.cell import files_of
from ocp.plan.kept import KeptPlan, PlanKey
from ocp.shell.output import reserved
from ocp.shell.processes import crew
from ocp.shell.progress import Phases, Progress

if TYPE_CHECKING:
    from ocp.plan.files import PlanResult


def plan(
    blade: str | Path | None = None,
    *,
    out: str | Path,
    cell: str | Path = CELL,
    overwrite: bool = False,
    path: str | Path | None = None,
    program: str | Path | None = None,
    stock: str | Path | None = None,
    kind: str = "axis",
    name: str | None = None,
    step: float = 1e-3,
    whole: bool = False,
    progress: Progress | None = None,
) -> "PlanResult":
    """Plan the grinding of a blade (its STL; None: the cell's own) and write programs, table and report into the folder `out`.

    path: contact points made elsewhere, path.csv; program: an existing KRL program to take the path from; stock: a map of the
    depth to take off, stock.csv or a PLY (None: even); kind: axis (timed splines), cartesian (#TCP splines) or lin (KSS 5); name
    of the program (None: the blade's); step m between waypoints; whole: refuse what cannot be ground whole instead of leaving
    stretches out. Raises BadInput: an argument or a file is not what it should be; Infeasible: there is no safe plan. Nothing is
    written then.
    """
    phases = Phases(progress)
    inputs = _inputs(cell, blade, path, program, stock)
    with reserved(Path(out), overwrite, inputs) as output, crew("ocp.plan.files", "ocp.plan.report.pages"):
        from ocp.plan.files import write_plan  # heavy: a kept plan does without, and the crew imports it meanwhile
        from ocp.plan.paths import PlanOptions
        from ocp.plan.planning import make_plan

        chosen = PlanOptions(_path(path), _path(program), kind, name, step, whole=whole, stock=_path(stock))
        return write_plan(make_plan(Path(cell), _path(blade), chosen, phases), output, phases)


def plan_unless_kept(
    blade: Path | None, *, out: Path, cell: Path, overwrite: bool, progress: Progress | None, **asked: Any
) -> "PlanResult | KeptPlan":
    """As `plan` with its further arguments in `asked`; where nothing has changed since it was planned, the kept folder."""

    def key() -> PlanKey | None:
        files = _inputs(cell, blade, asked.get("path"), asked.get("program"), asked.get("stock"))
        return PlanKey.of(files, {"blade": blade, "cell": cell} | asked)

    before = key()
    again = None if before is None else before.written_again(out, overwrite)
    if again is not None:
        return again
    made = plan(blade, out=out, cell=cell, overwrite=overwrite, progress=progress, **asked)
    if before is not None and key() == before:  # nobody wrote there meanwhile
        before.keep(made.folder, made.written, made.notices, [file for _, file in made.plan.inputs])
    return made


def _inputs(cell: str | Path, blade: str | Path | None, *others: str | Path | None) -> list[Path]:
    """Every file that planning reads: the cell's, those named, and the programs and positions beside a program."""
    files = [Path(file) for file in (blade, *others) if file is not None]
    called = [file for one in files if one.suffix.lower() == ".src" for file in one.parent.glob("*.[sSdD][rRaA][cCtT]")]
    return [*files_of(Path(cell)), *files, *sorted(called)]


def _path(given: str | Path | None) -> Path | None:
    return None if given is None else Path(given)
