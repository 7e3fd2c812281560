"""Setpoints that were changed and not written down: read off the runs themselves, and open in the fit.

Without a column setpoint_N the cell's setpoint stands for every row. Where a run presses by a fifth more or less than another
over the same points of the blade, that is rather an operator's force ladder than an error of the cell. Such a run's setpoint is
taken from its readings and fitted with them, so an error that is one force over the whole run is not seen there.
"""

from dataclasses import replace

import numpy as np

from ocp.calibrate.force.log import AIR_SHARE, Flags, ForceLog
from ocp.diagnose.rules import SAME_POINTS, SETPOINT_ALIKE, SETPOINT_CHANGED, SETPOINT_ROWS, SETPOINT_SD
from robots.pose import Array


def with_setpoints_read_off(log: ForceLog, own: float) -> tuple[ForceLog, str] | None:
    """The log with its runs' setpoints where the readings say that some were changed, and a sentence about it; own N: the cell's
    setpoint. None: the log tells them, or nothing speaks against one for all."""
    if log.setpoint is not None or not own > 0:
        return None
    touching = {int(r): (log.run == r) & log.contact for r in np.unique(log.run)}
    pressed = {r: rows for r, rows in touching.items() if np.count_nonzero(rows) >= SETPOINT_ROWS}
    force = {r: float(np.median(log.fn[rows])) for r, rows in pressed.items()}
    pressed = {r: rows for r, rows in pressed.items() if force[r] > AIR_SHARE * own}  # what hardly touches has no setpoint
    force = {r: force[r] for r in pressed}
    changed: dict[int, float] = {}
    for group in _over_the_same_points(log, pressed):
        # Most runs of a log are at the cell's setpoint, whatever the cell makes of it.
        usual = _usual([force[r] for r in group], _usual(list(force.values()), own))
        changed |= {r: own + force[r] - usual for r in group if abs(force[r] - usual) > SETPOINT_CHANGED * usual}
    if not changed:
        return None
    setpoint, sd = np.full(len(log), own), np.zeros(len(log))
    for r, value in changed.items():
        setpoint[log.run == r], sd[log.run == r] = max(value, 0.0), SETPOINT_SD * own
    return replace(log, setpoint=setpoint, setpoint_sd=sd), _sentence(log, changed, own)


def _usual(forces: list[float], likely: float) -> float:
    """The one of some forces N that most of them are like, of several such the one nearest to `likely`."""
    return max(forces, key=lambda u: (sum(abs(f - u) <= SETPOINT_ALIKE * u for f in forces), -abs(u - likely)))


def _sentence(log: ForceLog, changed: dict[int, float], own: float) -> str:
    runs = ", ".join(f"{log.runs[r]} ({value:.0f} N)" for r, value in changed.items())
    return (
        f"{log.path.name}: no column setpoint_N, and other forces than over the same points at the cell's {own:g} N: run {runs}; "
        "taken for setpoints that were changed, what is off by one force over such a run cannot be seen; add the column"
    )


def _over_the_same_points(log: ForceLog, pressed: dict[int, Flags]) -> list[list[int]]:
    """Runs of one session whose contact points have the same middle, on the same side of the blade."""
    groups: list[tuple[Array, Array, int, list[int]]] = []
    for r, rows in pressed.items():
        p, n, session = log.p[rows].mean(axis=0), log.n[rows].mean(axis=0), int(log.session[np.argmax(rows)])
        for middle, normal, at, members in groups:
            if at == session and np.linalg.norm(p - middle) < SAME_POINTS and n @ normal > 0:
                members.append(r)
                break
        else:
            groups.append((p, n, session, [r]))
    return [members for *_, members in groups]
