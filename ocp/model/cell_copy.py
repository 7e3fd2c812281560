"""A cell file written to another folder: the user's keys as they are, the files that it names found from there."""

import os
import tomllib
from pathlib import Path
from typing import Any


def cell_tables_for(source: Path, out: Path, blade: Path | None = None) -> dict[str, Any]:
    """Tables of the cell file `source` for a cell file in the folder `out`.

    Paths of robot, calibration and blade (or of `blade` in its place) are rewritten to be found from `out`.
    """
    tables = tomllib.loads(source.read_text(encoding="utf-8-sig"))
    robot = tables["robot"]
    for key in ("model", "calibration"):
        if key in robot and (source.parent / str(robot[key])).is_file():
            robot[key] = found_from(out, source.parent / str(robot[key]))
    if "workpiece" in tables:
        named = tables["workpiece"].get("stl")
        file = blade if blade is not None else source.parent / named if named is not None else None
        if file is not None:
            tables["workpiece"]["stl"] = found_from(out, file)
    return tables


def found_from(out: Path, file: Path) -> str:
    """A file's path as seen from the folder `out`."""
    try:
        return Path(os.path.relpath(file.resolve(), out.resolve())).as_posix()
    except ValueError:  # on another drive
        return file.resolve().as_posix()
