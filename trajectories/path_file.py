"""path.csv: a grinding path made elsewhere, read and checked line by line."""

import csv
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from robots.errors import BadInput
from trajectories.blade.mesh import Blade
from trajectories.blade.shape import AerofoilShape
from trajectories.passes import BladePath
from trajectories.path_points import paths_from_points

Array = NDArray[np.float64]

NEEDED = ("line", "px_mm", "py_mm", "pz_mm", "nx", "ny", "nz", "tx", "ty", "tz")
OPTIONAL = ("feed_mm_s", "force_N")


def read_path_file(
    path: str | Path, blade: Blade, shape: AerofoilShape, feed: float, force: float
) -> tuple[list[BladePath], list[str]]:
    """Passes of a path.csv on a blade, and notices; feed m/s and force N stand in where the columns are absent.

    Raises: BadInput naming file, line, column and value, or the distance of a point off the surface.
    """
    path = Path(path)
    table, numbers, notices = _read_table(path)
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
    paths, more = paths_from_points(
        blade, shape, line, p, n, t, 1e-3 * table["feed_mm_s"], table["force_N"], str(path), places
    )
    return paths, notices + more


def _read_table(path: Path) -> tuple[dict[str, Array], list[int], list[str]]:
    """Columns by name, the line of the file each row stands in, and notices."""
    try:
        text = path.read_bytes().decode("utf-8-sig")
    except OSError as error:
        raise BadInput(f"{path}: cannot be read ({error.strerror or error}); give the path of a CSV file.") from None
    except UnicodeDecodeError as error:
        raise BadInput(f"{path}: byte {error.start} is no text; give a CSV file.") from None
    reader = csv.reader(text.splitlines())
    header: list[str] = []
    rows: list[list[str]] = []
    numbers: list[int] = []
    for row in reader:
        cells = [cell.strip() for cell in row]
        if not any(cells) or cells[0].startswith("#"):
            continue
        if not header:
            header = cells
            _check_header(path, header, reader.line_num)
            continue
        if len(cells) != len(header):
            raise BadInput(f"{path}, line {reader.line_num}: {len(cells)} values where the header names {len(header)} "
                           f"columns; separate values by commas and decimals by points.")  # fmt: skip
        rows.append(cells)
        numbers.append(reader.line_num)
    if not rows:
        raise BadInput(f"{path}: holds no {'row' if header else 'header'}; see FORMATS.md, path.csv.")
    table: dict[str, Array] = {}
    for k, column in enumerate(header):
        if column in NEEDED or column in OPTIONAL:
            table[column] = np.array([_number(path, numbers[i], column, row[k]) for i, row in enumerate(rows)])
    extra = [column for column in header if column not in table]
    notices = [f"{path.name}: columns {', '.join(extra)} were ignored."] if extra else []
    return table, numbers, notices


def _check_header(path: Path, header: list[str], number: int) -> None:
    if len(header) == 1 and ";" in header[0]:
        raise BadInput(f"{path}, line {number}: values are separated by semicolons; separate them by commas.")
    missing = [column for column in NEEDED if column not in header]
    if missing:
        raise BadInput(f"{path}, line {number}: column{'s' if len(missing) > 1 else ''} {', '.join(missing)} "
                       f"missing; the header reads {', '.join(header)[:120]!r}.")  # fmt: skip
    double = [column for column in header if header.count(column) > 1 and column in NEEDED + OPTIONAL]
    if double:
        raise BadInput(f"{path}, line {number}: column {double[0]} stands there twice; remove one.")


def _number(path: Path, number: int, column: str, text: str) -> float:
    try:
        value = float(text)
    except ValueError:
        value = float("nan")
        if text.lower() not in ("nan", "-nan", "+nan"):
            raise BadInput(f"{path}, line {number}, column {column}: {text!r} is not a number.") from None
    if not np.isfinite(value):
        raise BadInput(f"{path}, line {number}, column {column}: {text!r} is not a finite number.")
    return value


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
            raise BadInput(f"{path}, line {numbers[i]}, column line: line {line[i]} was left and comes again; give every "
                           f"pass a number of its own.")  # fmt: skip
        seen.add(int(line[i]))
    return line
