"""Several blades in one cell: a whole plan each, in a folder that grows, with one table and one page of them all.

A blade is done when its row stands in night.json, which comes last with its files. The same call goes on with those that are not.
"""

import hashlib
import json
import os
import time
import traceback
from collections.abc import Sequence
from concurrent.futures import Future
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any

from ocp.data import CELL
from ocp.model.cell import files_of
from ocp.plan.grades import Grade, Grades
from ocp.plan.interface import plan
from ocp.plan.paths import PlanOptions
from ocp.plan.planning import cell_to_plan
from ocp.plan.report.night import night_page, words_of
from ocp.shell.cache import sha256
from ocp.shell.command import NOT_SOLVED, OK, refusal
from ocp.shell.executor import Files, Hands, WorkerEnded, carried_out, errand, lay, named_below
from ocp.shell.output import MARKER, as_written, files_added, not_as_written, reserved
from ocp.shell.processes import cores
from ocp.shell.progress import Phases, Progress
from robots.bounds import MEGABYTE
from robots.errors import BadInput
from trajectories.blade.other_files import BLADE_FILES
from trajectories.blade.stl import MOST_BYTES
from trajectories.dialects import dialect_named

TABLE, PAGE, PLAN = "night.json", "index.html", "plan"
MOST_JOBS = 256
Row = dict[str, Any]


@dataclass(frozen=True)
class NightResult:
    """Plans of several blades: their folder, a row for each blade asked for as night.json has it, and the one line that says how
    many are safe."""

    folder: Path
    rows: tuple[Row, ...]
    line: str

    @property
    def failed(self) -> tuple[Row, ...]:
        """Rows of the blades that have no plan."""
        return tuple(row for row in self.rows if row["exit_code"] != OK)

    @property
    def notices(self) -> tuple[str, ...]:
        """Why each of them has none."""
        return tuple(f"{row['name']}: {row['reason']}" for row in self.failed)


def plan_night(
    blades: Sequence[str | Path],
    *,
    out: str | Path,
    cell: str | Path = CELL,
    overwrite: bool = False,
    stock: str | Path | None = None,
    kind: str = "axis",
    step: float = 1e-3,
    whole: bool = False,
    jobs: int = 0,
    scheduler: str | None = None,
    progress: Progress | None = None,
) -> NightResult:
    """Plan the grinding of several blades in one cell; each into a folder of its STL's name below `out`, with index.html and
    night.json of them all. A later call on the same folder goes on where this one ended; a blade without a plan is a row with the
    reason.

    stock, kind, step, whole: of every blade, as in `plan`; jobs: processes, a blade each (0: one for each core); scheduler:
    address of a Dask scheduler whose workers do it instead; overwrite: begin anew. Raises BadInput: an argument or the cell is
    not what it should be, or `out` holds something else.
    """
    if not 0 <= jobs <= MOST_JOBS:
        raise BadInput(f"--jobs {jobs} must lie between 0 and {MOST_JOBS}")
    options = PlanOptions(None, None, kind, None, step, whole=whole, stock=None if stock is None else Path(stock))
    night = _Night(_named([Path(one) for one in blades]), Path(cell), options)
    hands = Hands(jobs or cores(), scheduler)
    night.check(away=scheduler is not None)
    with reserved(Path(out), overwrite, night.all_inputs(), grows=True) as output, output.grown():
        folder = output.named
        rows = _rows_before(night, folder)
        todo = [name for name in night.blades if name not in rows]
        tasks = ((_planned, night.common | _read(night.blade(name)), night.arguments(name)) for name in todo)
        with Phases(progress).phase("blades", len(night.blades)) as advance:
            for _ in range(len(night.blades) - len(todo)):
                advance()
            for place, done in carried_out(errand, tasks, replace(hands, jobs=min(hands.jobs, max(len(todo), 1))), apart=True):
                row, files = _ended(done)
                rows[todo[place]] = {"name": todo[place]} | row | {"reason": night.as_given(todo[place], row["reason"])}
                _add(night, rows, todo[place], files, folder)
                advance()
    asked = tuple(rows[name] for name in night.blades)
    return NightResult(Path(out), asked, f"{out}: {words_of(asked)} Look at {Path(out) / PAGE}, which has a row of each.")


@dataclass(frozen=True)
class _Night:
    """What is asked for: blades by name, and what they have in common.

    Where a blade is planned its files stand in a folder of their own, under the names that `beside` and `blade` give.
    """

    blades: dict[str, Path]
    cell: Path
    options: PlanOptions

    def check(self, away: bool) -> None:
        """Raises BadInput: cell, stock or options cannot be planned; a blade is not there; two would have programs of one name on
        the controller; what the cell names cannot travel where the work is done `away`."""
        for blade in self.blades.values():
            if not blade.is_file():
                raise BadInput(f"{blade}: there is no such file{', it is a folder' * blade.is_dir()}; correct the name")
            if blade.stat().st_size > MOST_BYTES:
                raise BadInput(f"{blade}: is larger than the {MOST_BYTES / MEGABYTE:g} MB that are read; give a coarser mesh")
        believed, _ = cell_to_plan(self.cell, next(iter(self.blades.values())), self.options)
        dialect, programs = dialect_named(believed.controller.dialect), dict[str, Path]()
        for blade in self.blades.values():
            program, _ = dialect.program_names(blade.name, 1, [2])  # as short as it may have to be
            if program in programs:
                raise BadInput(
                    f"{blade}: its program would be called {program} as that of {programs[program]}; rename one of them"
                )
            programs[program] = blade
        robot = believed.tables.robot
        for name in (robot.model, robot.calibration):
            if away and name is not None and Path(name).is_absolute():
                raise BadInput(f"{self.cell}: names {name}, which other machines do not have; name it from the cell's own folder")

    @cached_property
    def beside(self) -> dict[str, Path]:
        """What all blades share: the cell with the files that it names, but for its own blade; the depth to take off."""
        files = [file for file in files_of(self.cell) if file.suffix.lower() not in BLADE_FILES]
        places = [Path(os.path.abspath(file)) for file in files]
        root = os.path.commonpath([place.parent for place in places])
        found = {f"cell/{place.relative_to(root).as_posix()}": file for place, file in zip(places, files, strict=True)}
        return found | ({} if self.options.stock is None else {f"stock/{self.options.stock.name}": self.options.stock})

    def blade(self, name: str) -> dict[str, Path]:
        """A blade's own file."""
        return {f"blade/{self.blades[name].name}": self.blades[name]}

    def all_inputs(self) -> list[Path]:
        """Every file that is read."""
        return [*self.beside.values(), *self.blades.values()]

    def arguments(self, name: str) -> dict[str, Any]:
        """Those of `plan`, where a blade is planned."""
        there = {file: name for name, file in (self.beside | self.blade(name)).items()}
        files = {"blade": there[self.blades[name]], "cell": there[self.cell]}
        files |= {} if self.options.stock is None else {"stock": there[self.options.stock]}
        return {"files": files} | {key: getattr(self.options, key) for key in ("kind", "step", "whole")}

    def as_given(self, name: str, sentence: str) -> str:
        """A sentence with the files named as the user did."""
        for there, file in (self.beside | self.blade(name)).items():
            sentence = sentence.replace(there, str(file))
        return sentence

    @cached_property
    def common(self) -> Files:
        """What stands in them, read once: all blades are planned with the cell as it was at the beginning."""
        return _read(self.beside)

    def asked(self) -> dict[str, Any]:
        """What may not change when a night is gone on with, as night.json has it."""
        options = {"kind": self.options.kind, "step_mm": 1e3 * self.options.step, "whole": self.options.whole}
        hashes = {there: hashlib.sha256(content).hexdigest() for there, content in self.common.items()}
        return {"cell": self.cell.name} | options | {"inputs": hashes}


def _named(blades: Sequence[Path]) -> dict[str, Path]:
    """Blades by the names of their folders. Raises BadInput: there is none, two would share a folder, or one's name is taken."""
    if not blades:
        raise BadInput("no blade is named; give their STL files")
    names: dict[str, Path] = {}
    for blade in blades:
        same = next((other for name, other in names.items() if name.casefold() == blade.stem.casefold()), None)
        if same is not None:
            again = "name it once" if blade.resolve() == same.resolve() else "rename one of them"
            raise BadInput(f"{blade}: would be planned into the same folder as {same}; {again}")
        if blade.stem in (TABLE, PAGE, MARKER, ""):
            raise BadInput(f"{blade}: would be planned into a folder named {blade.stem}, which stands for all; rename it")
        names[blade.stem] = blade
    return names


def _rows_before(night: _Night, folder: Path) -> dict[str, Row]:
    """Rows of the blades that an earlier call has done and whose plans stand there. Raises BadInput: the folder holds something
    else, other plans, or one that was changed."""
    file = folder / TABLE
    if not file.is_file():
        if any(p.name != MARKER for p in folder.iterdir()):
            raise BadInput(f"{folder}: is not empty and holds no {TABLE}; give another --out")
        _add(night, {}, "", {}, folder)
        return {}
    if not as_written(file, folder):
        raise BadInput(f"{file}: was changed since it was written; put it back, or give another --out")
    before = json.loads(file.read_text(encoding="utf-8"))
    changed = [key for key, value in night.asked().items() if before["asked"].get(key) != value]
    other = f"give the same again to go on with {folder}, or another --out, or --overwrite to begin anew"
    if changed:
        what = "cell, or file that it names" if changed[0] == "inputs" else changed[0]
        raise BadInput(f"{folder}: its blades were planned with another {what}; {other}")
    rows = {row["name"]: row for row in before["blades"]}
    for name, blade in night.blades.items():
        if name in rows and not any(one["sha256"] == sha256(blade) for one in rows[name]["inputs"]):  # or it was lost
            if rows[name]["exit_code"] == OK:
                raise BadInput(f"{blade}: is not the blade that {folder / name} was planned for; {other}")
            del rows[name]
        elif name in rows and (lost := not_as_written(folder, name)) is not None:
            if (folder / name).exists():
                again = f"put it back, or move {folder / name} away to have it planned again"
                raise BadInput(f"{lost}: is gone or was changed since it was written; {again}")
            del rows[name]
    return rows


def _read(files: dict[str, Path]) -> Files:
    return {there: file.read_bytes() for there, file in files.items()}


def _planned(folder: Path, asked: dict[str, Any]) -> Row:
    """One blade in `folder`, where its files stand: its row, with its plan beside it where there is one."""
    files = {role: folder / there for role, there in asked.pop("files").items()}
    inputs = [{"role": role, "name": file.name, "sha256": sha256(file)} for role, file in files.items()]
    row = {"exit_code": OK, "reason": "", "inputs": inputs}
    began = time.perf_counter()
    try:
        plan(**files, out=folder / PLAN, **asked)
        row |= _told(json.loads((folder / PLAN / "plan.json").read_text(encoding="utf-8")))
    except Exception as error:
        sentence, row["exit_code"] = refusal(error) or (_own_fault(error), NOT_SOLVED)
        row["reason"] = named_below(folder, sentence)
    return row | {"seconds": round(time.perf_counter() - began, 1)}


def _own_fault(error: Exception) -> str:
    place = traceback.extract_tb(error.__traceback__)[-1]
    where = f"{Path(place.filename).name}:{place.lineno}"
    return f"a fault of this software, {type(error).__name__}: {error} ({where}); please report it"


def _told(document: dict[str, Any]) -> Row:
    """Of plan.json what the night's table has."""
    move, force = (Grade(**document["grades"][name]) for name in ("move", "force"))
    found = {"headline": Grades(move, force, "").headline, "grades": {"move": move.grade, "force": force.grade}}
    return found | {name: document[name] for name in ("verdict", "force_error_N", "force_sd_max_N", "duration_s", "process")}


def _ended(done: "Future[tuple[Row, Files]]") -> tuple[Row, Files]:
    try:
        return done.result()
    except WorkerEnded as error:  # not the blade's doing for sure: the next call tries it again
        return {"exit_code": NOT_SOLVED, "reason": f"no safe plan: {error}", "inputs": [], "seconds": None}, {}


def _add(night: _Night, rows: dict[str, Row], name: str, files: Files, folder: Path) -> None:
    """Put a blade's plan into its folder, with table and page; the table comes last."""
    order = [*(row for other, row in rows.items() if other not in night.blades)]
    order += [rows[blade] for blade in night.blades if blade in rows]
    for row in order:
        row["link"] = f"{row['name']}/report.html" if row["exit_code"] == OK else None
    with files_added(folder, last=TABLE) as part:
        lay({f"{name}/{file.removeprefix(f'{PLAN}/')}": content for file, content in files.items()}, part)
        night_page(order, len(night.blades), night.cell.name).write_page(part / PAGE)
        content = {"schema": 1, "asked": night.asked(), "blades": order}
        (part / TABLE).write_text(json.dumps(content, indent=1) + "\n", encoding="utf-8")
