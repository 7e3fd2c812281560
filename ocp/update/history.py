"""What earlier updates left in a calibration: when they held, which logs they used, how the wheel wore; and the running time that
a wheel wears with: a log's clock also goes on over night, and is started anew now and then."""

from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from ocp.calibrate.force.log import ForceLog
from ocp.calibrate.force.rows import log_conditions
from ocp.model.cell import Cell
from robots.calibration.carried import UPDATE
from robots.calibration.store import Calibration
from robots.errors import BadInput, shown
from robots.pose import Array

MOST = 2000  # updates that are remembered: a year of eight a working day
LARGEST = 1e12
ENTRIES = (
    *("clock_s", "measured_N", "expected_N", "expected_sd_N", "found_N", "found_sd_N"),
    *("radius_um", "radius_sd_um", "wear_um_per_h", "wear_sd_um_per_h", "preston", "preston_sd"),
)
"""Columns of the history, one number an update; nan where there was none (preston in um mm^2 / (N m))."""


@dataclass(frozen=True)
class History:
    """ends: running time s of the wheel where the last log ended, holds: that which the state is for, both None before the first
    update; offset s: running time over the logs' clock; logs: `log_mark` of the logs used; columns: lists by name of ENTRIES;
    stated: Preston's coefficient and its sd, 1/Pa, in the cell of the first update, zero where it had none."""

    ends: float | None = None
    holds: float | None = None
    offset: float = 0.0
    logs: tuple[str, ...] = ()
    columns: dict[str, tuple[float, ...]] = field(default_factory=lambda: dict.fromkeys(ENTRIES, ()))
    stated: tuple[float, float] = (0.0, 0.0)

    def __len__(self) -> int:
        return len(self.columns["clock_s"])

    def grown(self, clock: tuple[float, float, float], log: str, entry: dict[str, float]) -> "History":
        """With one more update (clock: ends, holds, offset); the oldest goes where there are MOST."""
        columns = {name: (*self.columns[name], float(entry[name]))[-MOST:] for name in ENTRIES}
        return History(*clock, logs=(*self.logs, log)[-MOST:], columns=columns, stated=self.stated)

    def table(self) -> dict[str, Any]:
        """As a calibration's provenance holds it."""
        known = {name: [round(x, 9) for x in values] for name, values in self.columns.items()}
        return {
            "ends_s": self.ends,
            "holds_s": self.holds,
            "offset_s": self.offset,
            "logs": list(self.logs),
            "history": known,
        } | {"stated_preston": list(self.stated)}


def history_of(calibration: Calibration | None, path: Path) -> History:
    """What the calibration of the cell `path` remembers. Raises BadInput: it was edited into something else."""
    told = None if calibration is None else calibration.provenance.get(UPDATE)
    if told is None:
        return History()
    table = told if isinstance(told, dict) else {}
    columns, logs = table.get("history"), table.get("logs")
    known = columns if isinstance(columns, dict) else {}
    read = {name: known.get(name) for name in ENTRIES}
    counts = {len(values) if isinstance(values, list) else -1 for values in read.values()}
    sound = len(counts) == 1 and min(counts) >= 1 and isinstance(logs, list) and all(isinstance(x, str) for x in logs)
    clocks: list[Any] = [table.get(key) for key in ("ends_s", "holds_s", "offset_s")]
    numbers = [*clocks, *(x for values in read.values() if isinstance(values, list) for x in values)]
    if not sound or not all(is_number(x) for x in numbers) or any(x != x for x in clocks):
        raise BadInput(
            f"{path}: its calibration's [provenance.{UPDATE}] is not as ocp.update wrote it ({shown(repr(told), 60)}); restore "
            "the file, or take that table out to begin a new history"
        )
    whole = {name: tuple(float(x) for x in values) for name, values in read.items() if values is not None}
    assert isinstance(logs, list)
    stated = table.get("stated_preston")
    pair = stated if isinstance(stated, list) and len(stated) == 2 and all(is_number(x) for x in stated) else (0.0, 0.0)
    before = float(pair[0]), float(pair[1])
    return History(float(clocks[0]), float(clocks[1]), float(clocks[2]), tuple(logs), whole, before)


def is_number(value: Any) -> bool:
    """Whether it is a number that is not beyond all bounds; nan stands for what was not measured."""
    return isinstance(value, int | float) and not isinstance(value, bool) and (value != value or abs(value) <= LARGEST)


TURN_BACK = 1.0  # s by which a clock may run back between two logs before it counts as started anew
PAUSE, LATER = 3600.0, 3.0  # s, and times the usual way from blade to blade, from which a later log means that the wheel stood
RECENT = 6  # logs whose distance says when the next blade comes


@dataclass(frozen=True)
class Running:
    """time (n,) s: running time of the wheel at each row; offset s: what it is over the log's clock; stood s: how long the wheel
    stood since the last update; contact s: how long it ground since then; notices."""

    time: Array
    offset: float
    stood: float
    contact: float
    notices: tuple[str, ...] = ()


def running_time(cell: Cell, log: ForceLog, history: History, holds: float | None) -> Running:
    """Of a log; holds s: running time that the state in the cell is for, None where nothing tells."""
    in_contact = sum(float(np.ptp(log.time[(log.run == r) & log.contact])) for r in np.unique(log.run[log.contact]))
    time = log_conditions(cell, log, history.ends or 0.0).clock
    if log.clock is None:
        return Running(time, history.offset, 0.0, in_contact)
    time, offset, stood, notices = time + history.offset, history.offset, 0.0, list[str]()
    if history.ends is not None and time.min() < history.ends - TURN_BACK:
        back = history.ends - float(time.min())
        time, offset = time + back, offset + back
        notices.append(
            f"{log.path.name}: clock_s begins {back:.0f} s before the last update ended: it was started anew, what the wheel "
            "wore between the two logs is not known and counted as none"
        )
    late = 0.0 if holds is None else float(time[log.contact].mean()) - holds
    if late > max(PAUSE, LATER * usual_way(history.columns["clock_s"])):
        time, offset, stood = time - late, offset - late, late
        notices.append(
            f"{log.path.name}: comes {late / 3600:.1f} h later by clock_s than the next blade was expected: the wheel is taken "
            "to have stood meanwhile, wear is counted as if the blade had come then"
        )
    # Blades that were ground between the logs wear the belt as this one did.
    since = float(time.max() - time.min() if history.ends is None else time.max() - history.ends)
    share = min(in_contact / max(float(np.ptp(time)), in_contact, 1e-9), 1.0)
    return Running(time, offset, stood, max(share * since, in_contact), tuple(notices))


def usual_way(middles: tuple[float, ...]) -> float:
    """Seconds from the middle of one logged blade to that of the next, as usual of late; 0 where there was one alone."""
    ways = np.diff(middles[-RECENT:])
    return float(np.median(ways)) if len(ways) else 0.0
