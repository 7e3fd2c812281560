"""A grinding-force log that is planned and not yet measured: force.csv without fn_N, or the plan.csv of `ocp.plan`."""

import csv
from pathlib import Path

import numpy as np

from ocp.calibrate.force.log import AXES, FEED, NORMAL, POINT, UNIT_TOLERANCE, ForceLog, Index, read_force_log
from ocp.diagnose.rules import LEAST_CONTACT_ROWS
from robots.csv_table import read_csv_table
from robots.errors import BadInput
from robots.pose import Array

NEEDED = ("time_s", "line", "contact", *AXES, *POINT, *NORMAL, *FEED)  # of a plan.csv
ALONG = ("s_mm", "feed_mm_s")  # told by a plan.csv too


def read_planned_log(path: Path) -> ForceLog:
    """Planned rows; forces nan (fn) or what stands there (ft, which says that it will be logged).

    A file without a column run is taken for a plan.csv: every passage in contact is a recording, the program's clock that of the
    campaign, no line was ground before. Raises BadInput: as `read_force_log`, and where too few rows are in contact.
    """
    log = read_force_log(path, sealed=True) if "run" in _header(path) else _of_plan(path)
    count = int(log.contact.sum())
    if count < LEAST_CONTACT_ROWS:
        raise BadInput(f"{path}, column contact: {count} rows in contact tell nothing; plan at least {LEAST_CONTACT_ROWS}")
    return log


def _header(path: Path) -> list[str]:
    """Names of the columns; none where the file cannot be read, which its reader explains."""
    try:
        with path.open(encoding="utf-8-sig", newline="") as file:
            rows = csv.reader(line for line in file if line.strip() and not line.startswith("#"))
            return [cell.strip() for cell in next(rows, [])]
    except (OSError, UnicodeDecodeError):
        return []


def _of_plan(path: Path) -> ForceLog:
    """Rows in contact of a plan.csv."""
    header = _header(path)
    if header and "line" not in header:
        raise BadInput(
            f"{path}: has neither a column run (force.csv without fn_N) nor a column line (plan.csv of ocp.plan); give one of "
            "the two"
        )
    vectors = (*POINT, *NORMAL, *FEED)
    table = read_csv_table(path, NEEDED, ALONG, gaps=(*vectors, *ALONG))
    contact, line = table.numbers["contact"], table.numbers["line"]
    bad = ~np.isin(contact, (0.0, 1.0))
    if bad.any():
        raise table.refuse(int(np.argmax(bad)), "contact", "must be 1 in contact or 0 between passes")
    rows = np.flatnonzero(contact == 1.0)
    for column in vectors:
        empty = ~np.isfinite(table.numbers[column][rows])
        if empty.any():
            at = table.line[rows[int(np.argmax(empty))]]
            raise BadInput(f"{path}, line {at}, column {column}: the cell is empty in a row in contact; fill it in")
    n, t = (table.stack(columns)[rows] for columns in (NORMAL, FEED))
    for columns, values in ((NORMAL, n), (FEED, t)):
        length = np.linalg.norm(values, axis=1)
        if (np.abs(length - 1.0) > UNIT_TOLERANCE).any():
            k, what = int(np.argmax(np.abs(length - 1.0))), ", ".join(columns)
            raise table.refuse(int(rows[k]), columns[0], f"makes {what} {length[k]:.4g} long; a unit vector is expected")
    run = _passages(contact, line)[rows]
    clock = table.numbers["time_s"][rows]
    back = np.flatnonzero(np.diff(clock) < 0)
    if len(back):
        raise table.refuse(int(rows[back[0] + 1]), "time_s", f"comes after {clock[back[0]]:g}; a plan's rows are in time order")
    label, none = np.unique(run, return_inverse=True), np.zeros(len(rows), np.int64)
    s, feed = (table.numbers.get(c) for c in ALONG)
    return ForceLog(
        path=path,
        run=label[1].astype(np.int64),
        runs=tuple(f"{k + 1}" for k in range(len(label[0]))),
        time=clock - _first(label[1], clock),
        q=np.radians(table.stack(AXES))[rows],
        p=1e-3 * table.stack(POINT)[rows],
        n=n / np.linalg.norm(n, axis=1, keepdims=True),
        t=t / np.linalg.norm(t, axis=1, keepdims=True),
        fn=np.full(len(rows), np.nan),
        contact=np.ones(len(rows), bool),
        session=none,
        sessions=("",),
        s=_known(s, rows),
        ft=None,
        sigma_fn=None,
        sigma_ft=None,
        setpoint=None,
        feed=_known(feed, rows),
        belt=None,
        line=line[rows].astype(np.int64),
        ground_before=_ground(label[1], line[rows]),
        temperature=None,
        wheel_temperature=None,
        clock=clock,
        row=np.array(table.line)[rows],
    )


def _known(values: Array | None, rows: Index) -> Array | None:
    """A column of millimetres in metres; None where it has gaps in contact."""
    return None if values is None or not np.isfinite(values[rows]).all() else 1e-3 * values[rows]


def _passages(contact: Array, line: Array) -> Index:
    """Number (n,) of the passage that each row belongs to: a new one where contact or line changes."""
    change = (np.diff(contact) != 0) | (np.diff(line) != 0)
    return np.concatenate([[0], np.cumsum(change)]).astype(np.int64)


def _first(run: Index, clock: Array) -> Array:
    """Clock (n,) s at the start of each row's recording."""
    start = np.full(int(run.max(initial=-1)) + 1, np.inf)
    np.minimum.at(start, run, clock)
    return start[run]


def _ground(run: Index, line: Array) -> Index:
    """How often (n,) each row's line was ground in the recordings before."""
    out = np.zeros(len(run), np.int64)
    for k in np.unique(line):
        out[line == k] = np.unique(run[line == k], return_inverse=True)[1]
    return out
