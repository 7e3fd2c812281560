"""A CSV file as columns of numbers and words, every complaint with file, line, column and value."""

import csv
import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from robots.bounds import LONGEST_LABEL, MOST_CSV_BYTES, MOST_CSV_LINE, MOST_CSV_VALUES, column_bounds, read_whole
from robots.column_mapping import ColumnMapping, seconds_of
from robots.errors import BadInput, shown
from robots.pose import Array

OURS = ColumnMapping()
DAYS = ("%d", "%j", "%x", "%c", "%D", "%F", "%s", "%U", "%W")  # of forms that tell one day from the next
A_MINUTE = 60.0  # s by which rows may stand in another order than they were taken

# Digits that a person types: float() alone also takes other scripts' digits, and underscores.
_PLAIN = re.compile(r"[-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?", re.ASCII)


@dataclass(frozen=True)
class CsvTable:
    """Columns of a file: `numbers` as (n,) arrays, `words` as lists; line (n,) in the file of each row; ignored columns."""

    path: Path
    numbers: dict[str, Array]
    words: dict[str, list[str]]
    line: list[int]
    ignored: tuple[str, ...]

    def __len__(self) -> int:
        return len(self.line)

    def stack(self, columns: Sequence[str], absent: float | None = None) -> Array:
        """The named columns side by side, (n, len(columns)), a number in the place of one that is absent."""
        known = self.numbers if absent is None else dict.fromkeys(columns, np.full(len(self), absent)) | self.numbers
        return np.stack([known[c] for c in columns], axis=1)

    def take(self, rows: NDArray[np.int64]) -> "CsvTable":
        """The table of some rows only."""
        numbers = {c: v[rows] for c, v in self.numbers.items()}
        words = {c: [v[i] for i in rows] for c, v in self.words.items()}
        return replace(self, numbers=numbers, words=words, line=[self.line[i] for i in rows])

    def column(
        self, name: str, factor: float = 1.0, bad: Callable[[Array], NDArray[np.bool_]] | None = None, must: str = ""
    ) -> Array | None:
        """A column of numbers times a factor, None where the file has none. Raises BadInput at the first value that is `bad`."""
        values = self.numbers.get(name)
        if values is not None and bad is not None and (wrong := bad(values)).any():
            raise self.refuse(int(np.argmax(wrong)), name, f"must be {must}")
        return None if values is None else values * factor

    def labels(self, column: str) -> tuple[NDArray[np.int64], tuple[str, ...]]:
        """Index (n,) of each row's word and the words as they come; an absent column is one word without letters."""
        words = self.words.get(column, [""] * len(self))
        names = tuple(dict.fromkeys(words))
        at = {name: i for i, name in enumerate(names)}
        return np.array([at[word] for word in words], np.int64), names

    def check_order(self, column: str, run: NDArray[np.int64], runs: tuple[str, ...], strictly: bool) -> None:
        """Raises BadInput where a column of times runs back inside a run, or stands still if it must grow `strictly`."""
        time = self.numbers[column]
        for i, name in enumerate(runs):
            rows = np.flatnonzero(run == i)
            step = np.diff(time[rows])
            for k in np.flatnonzero(step <= 0 if strictly else step < 0)[:1]:
                how = "no later than" if strictly else "after"
                rule = "times must grow in a run" if strictly else "the rows of a run must be in time order"
                raise self.refuse(int(rows[k + 1]), column, f"comes {how} {time[rows[k]]:.10g} in run {shown(name)}; {rule}")

    def ignored_columns(self) -> list[str]:
        """A sentence on the columns that nobody asked for; none where there are none."""
        names = ", ".join(name or "(no name)" for name in dict.fromkeys(self.ignored))
        return [f"{self.path.name}: columns {shown(names, 400)} were ignored"] if names else []

    def refuse(self, row: int, column: str, reason: str) -> BadInput:
        """The error to raise about one value."""
        value = self.words[column][row] if column in self.words else f"{self.numbers[column][row]:.10g}"
        return BadInput(f"{self.path}, line {self.line[row]}, column {column}: {shown(value) or '(empty)'} {reason}")


def read_csv_table(
    path: str | Path,
    needed: Sequence[str],
    optional: Sequence[str] = (),
    words: Sequence[str] = (),
    gaps: Sequence[str] = (),
    mapping: ColumnMapping = OURS,
    kind: str = "",
) -> CsvTable:
    """Read a file with a header. Numbers lie in the bounds of their columns (robots.bounds); `words` names the columns, needed
    or optional, kept as text.

    In the columns `gaps` an empty cell is nan. `mapping`: how the file's columns become ours; kind: of what the table is, for the
    zero of its dates (`ColumnMapping.zero`).

    Comma-separated, decimal points; blank lines and lines that begin with # are passed over. Columns of other names are
    ignored and named in `ignored`. Raises BadInput for everything else.
    """
    path = Path(path)
    mapping.asked.update(needed, optional)
    theirs, rows, lines = _cells(path, needed, words, mapping)
    mapping = mapping.of_file(path, theirs)
    header = mapping.header(theirs)
    known = [c for c in header if c in needed or c in optional]
    made = {c: mapping.sources_of(c) for c in known}
    for column in (source for sources in made.values() for source in sources):
        if theirs.count(column) > 1:
            raise BadInput(f"{path}: column {column} stands there twice; remove one")
    numbers: dict[str, Array] = {}
    texts: dict[str, list[str]] = {}
    for column, sources in made.items():
        found = {source: [row[theirs.index(source)] for row in rows] for source in sources}
        cells = ["+".join(parts) for parts in zip(*found.values(), strict=True)] or ["a constant"] * len(rows)
        if column in words:
            _check_words(path, lines, column, cells)
            texts[column] = cells
            continue
        dates = mapping.seconds(column)
        read = [_numbers(path, lines, name, texts_, column in gaps, mapping, dates) for name, texts_ in found.items()]
        if dates:
            _check_midnight(path, lines, column, read[0], dates)
            numbers[column] = read[0] - mapping.zero(kind, float(read[0][0]))
        elif column in mapping.columns:
            numbers[column] = mapping.values(column, read, len(rows))
        else:
            numbers[column] = read[0]
        _check_bounds(path, lines, column, numbers[column], cells)
    return CsvTable(path, numbers, texts, lines, tuple(c for c in header if c not in known))


def _numbers(
    path: Path, lines: list[int], column: str, cells: list[str], holes: bool, mapping: ColumnMapping, dates: str
) -> Array:
    """Cells as numbers (n,), `holes`: empty ones as nan; `dates`: as seconds of dates in that form. Raises BadInput."""
    if not dates:
        pairs = list(zip(lines, cells, strict=True))
        if mapping.decimal != ".":
            for n, cell in pairs:
                if "." in cell:
                    raise BadInput(
                        f"{path}, line {n}, column {column}: '{shown(cell)}' has a point where {mapping.path} says decimal = "
                        f"'{mapping.decimal}'; take points between thousands out, or correct decimal"
                    )
            pairs = [(n, cell.replace(mapping.decimal, ".")) for n, cell in pairs]
        return np.array([np.nan if holes and not cell else _number(path, n, column, cell) for n, cell in pairs])
    found = []
    for n, cell in zip(lines, cells, strict=True):
        try:
            found.append(seconds_of(cell, dates))
        except ValueError:
            raise BadInput(
                f"{path}, line {n}, column {column}: '{shown(cell)}' is no time of the form {dates}; correct it"
            ) from None
    return np.array(found)


def _check_midnight(path: Path, lines: list[int], column: str, seconds: Array, dates: str) -> None:
    """Raises BadInput: times of day (n,) that begin anew."""
    back = np.flatnonzero(np.diff(seconds) < -A_MINUTE)
    if len(back) and not any(day in dates for day in DAYS):
        raise BadInput(
            f"{path}, line {lines[back[0] + 1]}, column {column}: a time of the form {dates} that is earlier by "
            f"{(seconds[back[0]] - seconds[back[0] + 1]) / 3600.0:.2g} h than in the row before: a new day? give the date with it"
        )


def _cells(
    path: Path, needed: Sequence[str], words: Sequence[str], mapping: ColumnMapping
) -> tuple[list[str], list[list[str]], list[int]]:
    """Header, rows and the line of each row. Where the first column is of `words`, what begins with # may be a name or a row that
    somebody took out: a whole row of it is refused."""
    reader = csv.reader(_lines_of(path), delimiter=mapping.separator, skipinitialspace=mapping.separator == " ")
    header: list[str] = []
    rows: list[list[str]] = []
    lines: list[int] = []
    words_first = False
    try:
        for row in reader:
            cells = [cell.strip() for cell in row]
            if not any(cells):
                continue
            if cells[0].startswith("#"):
                if words_first and len(cells) == len(header) and any(cells[1:]):
                    raise BadInput(
                        f"{path}, line {reader.line_num}, column {header[0]}: '{shown(cells[0])}' begins with #, and the row has "
                        "a value for every column: rename it if it is a name, remove the row if it is none"
                    )
                continue
            if not header:
                header = cells
                of_file = _checked_header(path, header, reader.line_num, needed, mapping)
                words_first = any(header[0] in of_file.sources_of(word) for word in words)
            elif len(cells) != len(header):
                raise BadInput(
                    f"{path}, line {reader.line_num}: {len(cells)} values where the header names {len(header)} columns; "
                    "separate values by commas and decimals by points"
                )
            else:
                rows.append(cells)
                lines.append(reader.line_num)
                if len(rows) * len(header) > MOST_CSV_VALUES:
                    raise BadInput(
                        f"{path}, line {reader.line_num}: more than {MOST_CSV_VALUES} values; thin the file out or split it"
                    )
    except csv.Error as error:
        raise BadInput(f"{path}, line {reader.line_num}: {error}; give a CSV file") from None
    if not rows:
        raise BadInput(f"{path}: holds no {'row' if header else 'header'}; needed columns are {', '.join(needed)}")
    return header, rows, lines


def columns_named(path: Path) -> list[str]:
    """Names of a table's columns; none where it has no header. Raises BadInput: a file that cannot be read."""
    lines = (line for line in _lines_of(path) if line.strip() and not line.startswith("#"))
    return [cell.strip() for cell in next(csv.reader(lines), [])]


def _lines_of(path: Path) -> list[str]:
    """The lines of a text file, none so long that it is no table."""
    try:
        lines = read_whole(path, MOST_CSV_BYTES, "a CSV file").decode("utf-8-sig").splitlines()
    except UnicodeDecodeError as error:
        raise BadInput(f"{path}: byte {error.start} is no UTF-8 text; save it as CSV in UTF-8") from None
    for number, line in enumerate(lines, 1):
        if len(line) > MOST_CSV_LINE:
            raise BadInput(f"{path}, line {number}: {len(line)} characters, the limit is {MOST_CSV_LINE}; give a CSV file")
    return lines


def _check_words(path: Path, lines: list[int], column: str, cells: list[str]) -> None:
    """Labels go into reports, files and onto the terminal."""
    for line, cell in zip(lines, cells, strict=True):
        if len(cell) > LONGEST_LABEL or not cell.isprintable():
            raise BadInput(
                f"{path}, line {line}, column {column}: '{shown(cell)}' is no label of at most {LONGEST_LABEL} characters that "
                "can be printed; shorten it"
            )


def _check_bounds(path: Path, lines: list[int], column: str, values: Array, cells: list[str]) -> None:
    least, most, reason = column_bounds(column)
    outside = np.flatnonzero((values < least) | (values > most))
    if len(outside):
        k = int(outside[0])
        raise BadInput(
            f"{path}, line {lines[k]}, column {column}: {shown(cells[k])} is not between {least:g} and {most:g} ({reason}); "
            "correct it"
        )


def _checked_header(path: Path, header: list[str], number: int, needed: Sequence[str], mapping: ColumnMapping) -> ColumnMapping:
    """What of the mapping is for a file with this header. Raises BadInput: columns that are needed are missing."""
    for sign, name in ((",", "commas"), (";", "semicolons"), ("\t", "tabs")):
        if len(header) == 1 and sign in header[0]:
            what = "separate them by commas" if mapping is OURS else f"say so in {mapping.path} (separator)"
            raise BadInput(f"{path}, line {number}: values are separated by {name}; {what}")
    of_file = mapping.of_file(path, header)
    ours = of_file.header(header)
    missing = [column for column in needed if column not in ours]
    if missing:
        raise BadInput(
            f"{path}, line {number}: column{'s' if len(missing) > 1 else ''} {', '.join(missing)} missing; the header "
            f"reads '{shown(', '.join(header), 120)}'"
        )
    return of_file


def _number(path: Path, line: int, column: str, text: str) -> float:
    if not text:
        raise BadInput(f"{path}, line {line}, column {column}: the cell is empty; fill it in or remove the row")
    if _PLAIN.fullmatch(text):
        value = float(text)
        if value - value == 0.0:
            return value
    elif text.lower().lstrip("+-") not in ("nan", "inf", "infinity"):
        raise BadInput(f"{path}, line {line}, column {column}: '{shown(text)}' is not a number, as in 12.5; correct it")
    raise BadInput(f"{path}, line {line}, column {column}: '{shown(text)}' is not a finite number; remove the row")
