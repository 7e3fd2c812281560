"""The wheel's running time: what it wears with. A log's clock also goes on over night, and is started anew now and then."""

from dataclasses import dataclass

import numpy as np

from ocp.calibrate.force.log import ForceLog
from ocp.calibrate.force.rows import log_conditions
from ocp.model.cell import Cell
from ocp.update.history import History
from robots.pose import Array

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
