"""A plan's rows as the force log that will be recorded of it: what a measurement would show can be asked before it is made."""

from dataclasses import replace
from pathlib import Path

import numpy as np

from ocp.calibrate.force.log import AXES, FEED, NORMAL, POINT, ForceLog, log_of_table
from robots.csv_table import columns_named, read_csv_table
from robots.errors import BadInput
from robots.pose import Array, Index

NEEDED = ("time_s", "line", "contact", *AXES, *POINT, *NORMAL, *FEED)  # of a plan.csv
ALONG = ("s_mm", "feed_mm_s")  # told by a plan.csv too


def log_of_plan(path: Path) -> ForceLog:
    """Rows in contact of a plan.csv: every passage is a recording, the program's clock that of the campaign, no line was ground
    before. Raises BadInput: a column or cell that is missing, times out of order."""
    header = columns_named(path)
    if header and "line" not in header:
        raise BadInput(f"{path}: has neither a column run (as a force.csv) nor a column line (as a plan.csv); give one of both")
    vectors = (*POINT, *NORMAL, *FEED)
    table = read_csv_table(path, NEEDED, ALONG, gaps=(*vectors, *ALONG))
    contact, line = table.numbers["contact"], table.numbers["line"]
    table.column("contact", 1.0, lambda v: ~np.isin(v, (0.0, 1.0)), "1 in contact or 0 between passes")
    rows = np.flatnonzero(contact == 1.0)
    for column in vectors:
        empty = ~np.isfinite(table.numbers[column][rows])
        if empty.any():
            at = table.line[rows[int(np.argmax(empty))]]
            raise BadInput(f"{path}, line {at}, column {column}: the cell is empty in a row in contact; fill it in")
    change = (np.diff(contact) != 0) | (np.diff(line) != 0)  # a new passage begins there
    _, first, run = np.unique(np.append(0, np.cumsum(change))[rows], return_index=True, return_inverse=True)
    clock = table.numbers["time_s"][rows]
    back = np.flatnonzero(np.diff(clock) < 0)
    if len(back):
        raise table.refuse(int(rows[back[0] + 1]), "time_s", f"comes after {clock[back[0]]:g}; a plan's rows are in time order")
    there = table.take(rows)
    known = {name: values for name, values in there.numbers.items() if np.isfinite(values).all()}  # s and feed may have gaps
    known |= {
        "time_s": clock - clock[first][run],
        "clock_s": clock - clock.min(initial=0.0),
        "ground_before": _ground(run, line[rows]),
    }
    return log_of_table(replace(there, numbers=known, words={"run": [f"{k + 1}" for k in run]}), sealed=True)


def _ground(run: Index, line: Array) -> Array:
    """How often (n,) each row's line was ground in the recordings before."""
    out = np.zeros(len(run))
    for k in np.unique(line):
        out[line == k] = np.unique(run[line == k], return_inverse=True)[1]
    return out
