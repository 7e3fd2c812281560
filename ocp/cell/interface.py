"""A new cell, the examination of one, its page: what the commands of this room do."""

import shutil
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ocp.cell.examination import DOUBT, KNOWN, MISTAKE, UNMEASURED, Examined, examine
from ocp.cell.new import held_upright, new_cell_text, placed_wheel
from ocp.data import CELL
from ocp.model.cell import files_of, read_cell, read_tracker_setup
from ocp.model.cell_schema import CellTables
from ocp.shell.cache import sha256
from ocp.shell.output import whole_folder
from ocp.shell.progress import Phases, Progress
from robots.errors import BadInput
from robots.inverse import planned_family
from robots.robot import left_out_notices, load_robot
from robots.toml_files import json_schema
from trajectories.blade import find_shape, read_blade

FILE, SCHEMA_FILE = "cell.toml", "cell.schema.json"
FAR_ORIGIN = 5.0  # m of a blade from its file's origin: no holder reaches there
ORDER = (DOUBT, MISTAKE, UNMEASURED, KNOWN)  # a doubt on units explains the mistake that follows from it


@dataclass(frozen=True)
class CellResult:
    """A cell that was written or examined: its folder, the one line about it, and what the user should know."""

    folder: Path
    line: str
    notices: tuple[str, ...]
    sound: bool = True


def new_cell(robot: str, *, blade: str | Path | None = None, out: str | Path = "cell", overwrite: bool = False) -> CellResult:
    """Write a commented cell.toml for a robot (a catalogue name, or the path of a robot file) and a blade (None: the bundled one)
    into the folder `out`, with copies of both files beside it.

    Raises BadInput: no such robot, a blade that is none.
    """
    given, out = Path(robot), Path(out)
    arm = load_robot(robot)
    stl = CELL.parent / "blade.stl" if blade is None else Path(blade)
    planned = planned_family(arm) is not None
    own = given.is_file()
    model = given.name if own else robot
    held, mended = None, []
    if planned or blade is not None:
        solid = read_blade(stl)
        mended = list(solid.notices)
    if planned:
        held = held_upright(solid, find_shape(solid))
        away = float(np.linalg.norm(solid.vertices.mean(axis=0)))
        if away > FAR_ORIGIN:
            raise BadInput(
                f"{stl}: lies {away:.3g} m from its file's origin, the blade's frame; move the blade there and export anew"
            )
    inputs = [*([given] if own else []), *([stl] if blade is not None else [])]
    with whole_folder(out, overwrite, inputs) as folder:
        if own:
            shutil.copyfile(given, folder / model)
        if planned:
            shutil.copyfile(stl, folder / stl.name)
        file = folder / FILE
        (folder / SCHEMA_FILE).write_text(json_schema(CellTables, FILE), encoding="utf-8")
        file.write_text(new_cell_text(out.name, model, arm, held, stl.name), encoding="utf-8")
        if planned:
            centre = placed_wheel(file, folder / stl.name)
            file.write_text(new_cell_text(out.name, model, arm, held, stl.name, centre), encoding="utf-8")
            read_cell(file)
        read_tracker_setup(file)
    told = [*left_out_notices(arm), *mended]
    if not planned:
        told.append(
            f"{arm.title} has no closed inverse (axes 2 and 3 parallel, wrist axes in one point), so nothing can be planned "
            "with it: the cell has no wheel and no blade, and serves calibration and diagnosis of the arm"
        )
    line = f"{out / FILE}: its comments say what to measure; then `grindplan cell check {out / FILE}`"
    return CellResult(out, line, tuple(told))


def check_cell(file: str | Path, progress: Progress | None = None) -> CellResult:
    """Examine a cell file and all it names; `sound` is false where there are mistakes. Raises BadInput as `examine`."""
    seen = examine(Path(file), Phases(progress))
    notices = [f.sentence() for kind in ORDER for f in seen.of(kind)]
    told = f"{file}: {_counted(seen)}{_ground(seen)}."
    return CellResult(Path(file).parent, told, tuple(notices), not seen.of(MISTAKE))


def _counted(seen: Examined) -> str:
    """How many mistakes, doubts and unmeasured numbers there are."""
    many = {kind: len(seen.of(kind)) for kind in ORDER}
    words = [f"{many[k] or 'no'} {k}{'s' if many[k] != 1 else ''}" for k in (MISTAKE, DOUBT)]
    return f"{words[0]}, {words[1]}, {many[UNMEASURED] or 'nothing'} {UNMEASURED}"


def _ground(seen: Examined) -> str:
    """How much of the blade can be reached, where that was tried; whether axes and torques keep the feeds is seen by planning."""
    if seen.grindable is None:
        return ""
    return f"; {100 * seen.grindable.share:.1f} % of the asked surface can be reached, at what speed a plan tells"


def show_cell(
    file: str | Path, *, out: str | Path = "cell_page", overwrite: bool = False, progress: Progress | None = None
) -> CellResult:
    """Write a page with the cell in three dimensions, its frames, the numbers for the controller, where the wheel may stand, and
    what `check_cell` finds into the folder `out`. Raises BadInput as `examine`."""
    from ocp.cell.page import cell_page  # matplotlib: only for those who want a page

    file, out = Path(file), Path(out)
    phases = Phases(progress)
    read = files_of(file)
    with whole_folder(out, overwrite, read) as folder:
        seen = examine(file, phases)
        with phases.phase("page"):
            hashes: Mapping[str, str] = {p.name: sha256(p) for p in read}
            cell_page(seen, hashes, _counted(seen) + _ground(seen)).write_page(folder / "cell.html")
    line = f"{out / 'cell.html'}: {_counted(seen)}{_ground(seen)}."
    notices = tuple(f.sentence() for kind in (DOUBT, MISTAKE) for f in seen.of(kind))
    return CellResult(out, line, notices, not seen.of(MISTAKE))
