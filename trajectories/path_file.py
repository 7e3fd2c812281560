"""path.csv: a grinding path made elsewhere, read and checked line by line."""

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from robots.csv_table import read_csv_table
from robots.errors import BadInput
from robots.pose import Array
from trajectories.blade.mesh import Blade
from trajectories.blade.shape import AerofoilShape
from trajectories.passes import BladePath
from trajectories.path_points import paths_from_points

NEEDED = ("line", "px_mm", "py_mm", "pz_mm", "nx", "ny", "nz", "tx", "ty", "tz")
OPTIONAL = ("feed_mm_s", "force_N")


def read_path_file(
    path: str | Path, blade: Blade, shape: AerofoilShape, feed: float, force: float
) -> tuple[list[BladePath], list[str]]:
    """Passes of a path.csv on a blade, and notices; feed m/s and force N stand in where the columns are absent.

    Raises: BadInput naming file, line, column and value, or the distance of a point off the surface.
    """
    path = Path(path)
    read = read_csv_table(path, NEEDED, OPTIONAL)
    table, numbers = read.numbers, read.line
    notices = [f"{path.name}: columns {', '.join(read.ignored)} were ignored."] if read.ignored else []
    for column, default, unit in (("feed_mm_s", 1e3 * feed, "mm/s"), ("force_N", force, "N")):
        if column not in table:
            table[column] = np.full(len(numbers), default)
            notices.append(f"{path.name}: no column {column}, {default:g} {unit} is used throughout.")
        elif (table[column] <= 0.0).any():
            k = int(np.argmax(table[column] <= 0.0))
            raise BadInput(f"{path}, line {numbers[k]}, column {column}: {table[column][k]:g} {unit} must be above 0.")
    line = _line_numbers(path, table["line"], numbers)
    p = 1e-3 * np.stack([table[c] for c in ("px_mm", "py_mm", "pz_mm")], axis=1)
    n = np.stack([table[c] for c in ("nx", "ny", "nz")], axis=1)
    t = np.stack([table[c] for c in ("tx", "ty", "tz")], axis=1)
    places = [f"line {number}" for number in numbers]
    paths, more = paths_from_points(blade, shape, line, p, n, t, 1e-3 * table["feed_mm_s"], table["force_N"], str(path), places)
    return paths, notices + more


def _line_numbers(path: Path, values: Array, numbers: list[int]) -> NDArray[np.int64]:
    """Line numbers of the passes as integers, each in one stretch."""
    bad = (values != np.round(values)) | (values < 1)
    if bad.any():
        k = int(np.argmax(bad))
        raise BadInput(f"{path}, line {numbers[k]}, column line: {values[k]:g} is not a whole number from 1 on.")
    line = values.astype(np.int64)
    starts = np.flatnonzero(np.concatenate([[True], line[1:] != line[:-1]]))
    seen: set[int] = set()
    for i in starts.tolist():
        if int(line[i]) in seen:
            raise BadInput(
                f"{path}, line {numbers[i]}, column line: line {line[i]} was left and comes again; give every "
                f"pass a number of its own."
            )
        seen.add(int(line[i]))
    return line
