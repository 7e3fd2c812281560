"""`ocp.api.plan`: blade and cell in; a verified program, its table and a report out."""

from pathlib import Path

from ocp.data import CELL
from ocp.model.cell import files_of
from ocp.plan.files import PlanResult, write_plan
from ocp.plan.paths import PlanOptions
from ocp.plan.planning import make_plan
from ocp.shell.output import reserved
from ocp.shell.progress import Phases, Progress


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
    step: float = 5e-4,
    whole: bool = False,
    progress: Progress | None = None,
) -> PlanResult:
    """Plan the grinding of a blade (its STL; None: the cell's own) and write programs, table and report into the folder `out`.

    path: contact points made elsewhere, path.csv; program: an existing KRL program to take the path from; stock: a map of the
    depth to take off, stock.csv or a PLY (None: even); kind: axis (timed splines), cartesian (#TCP splines) or lin (KSS 5); name
    of the program (None: the blade's); step m between waypoints; whole: refuse what cannot be ground whole instead of leaving
    stretches out. Raises BadInput: an argument or a file is not what it should be; Infeasible: there is no safe plan. Nothing is
    written then.
    """
    chosen = PlanOptions(_path(path), _path(program), kind, name, step, whole=whole, stock=_path(stock))
    files = [file for file in (_path(blade), chosen.path, chosen.program, chosen.stock) if file is not None]
    if chosen.program is not None:
        files += chosen.program.parent.glob("*.[sSdD][rRaA][cCtT]")  # the programs that it calls, and their positions
    phases = Phases(progress)
    with reserved(Path(out), overwrite, [*files_of(Path(cell)), *files]) as output:
        return write_plan(make_plan(Path(cell), _path(blade), chosen, phases), output, phases)


def _path(given: str | Path | None) -> Path | None:
    return None if given is None else Path(given)
