"""A log of link-side encoders as recorded: motor and link angles, torques (FORMATS, joints.csv)."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from robots.column_mapping import SEALED, ColumnMapping
from robots.csv_table import OURS, CsvTable, read_csv_table
from robots.errors import BadInput
from robots.pose import Array, Index, Stacked
from robots.robot import Robot

AXES = tuple(f"q{i}_deg" for i in range(1, 7))
LINK = tuple(f"link{i}_deg" for i in range(1, 7))
TORQUE = tuple(f"tau{i}_Nm" for i in range(1, 7))
SPEED = tuple(f"qd{i}_deg_s" for i in range(1, 7))
FEW = 30  # rows of a joint below which nothing can be told of it
SHORT = 4  # rows of a run up to which it tells no motion
MOVED = np.radians(1.0)  # rad: an axis that travelled less did not move
FAR, ALIKE, SHARED = 0.3, 0.3, 0.7  # of the largest step; of their median; of steps: a unit is the same for all
OTHER_SPEED = 10.0  # times; a slow filter of speeds is nearer, other units farther apart
SLOW = 1.0  # s between rows, from which times may well be milliseconds
OTHER_TORQUE = 30.0  # times: between 1 and a gear's ratio
HEAVY = 100.0  # N m: less may be the arm's friction, or a mass that is not known
WILD = 0.05  # of the rows: a unit or a sign is wrong in many, few wild ones are not counted
APART = np.radians(8.0)  # rad of wander between the two sides: more than any gear or delay, so another unit or sign


@dataclass(frozen=True)
class JointLog(Stacked):
    """n rows in time order inside each run, radians; runs one behind the other but where they are to be predicted.

    run (n,): index into `runs`; time (n,) s; q (n, 6) motor side through the gear; link (n, 6) link side, nan where not
    recorded; tau (n, 6) N m motor torque on the link side, nan where not recorded. joints: those (1..6) with a link side that
    moved. Speeds are found from the angles.
    """

    path: Path
    run: Index
    runs: tuple[str, ...]
    time: Array
    q: Array
    link: Array
    tau: Array
    notices: tuple[str, ...] = ()

    def __len__(self) -> int:
        return len(self.q)

    @property
    def joints(self) -> tuple[int, ...]:
        """Joints (1..6) that have a link-side angle on enough rows and moved."""
        known = np.isfinite(self.link)
        return tuple(j + 1 for j in range(6) if known[:, j].sum() >= FEW and np.ptp(self.q[known[:, j], j]) > MOVED)


def read_joint_log(path: str | Path, mapping: ColumnMapping = OURS, sealed: bool = False) -> JointLog:
    """The rows of a joints.csv; mapping: how a table made by others becomes one of ours; sealed: conditions to predict, whose
    link sides are nobody's business.

    Raises BadInput: as `read_csv_table`; no link column; times that do not grow inside a run; a link side that has another
    unit or counts the other way; too few rows; no joint with a link side that moved.
    """
    needed, more = ("run", "time_s", *AXES), (*LINK, *TORQUE, *SPEED)
    table = read_csv_table(path, needed, more, ("run",), more, mapping, f"{SEALED * sealed}joints")
    if not sealed and not any(c in table.numbers for c in LINK):
        raise BadInput(f"{table.path}: none of the columns link1_deg .. link6_deg is there; the link side is what is compared")
    run, runs = table.labels("run")
    table.check_order("time_s", run, runs, strictly=True)
    read = np.radians(np.hstack([table.stack(AXES), table.stack(LINK, np.nan)]))
    whole = _unwrapped(read, run)
    turned = [name for name, was, now in zip((*AXES, *LINK), read.T, whole.T, strict=True) if not np.array_equal(was, now, True)]
    q, link = np.hsplit(whole, 2)
    _check_speeds(table, run)
    link = np.where(sealed | (np.bincount(run)[run] <= SHORT)[:, None], np.nan, link)
    _check_link(table, q, link)
    told = (f"{table.path.name}: {', '.join(turned)} jump by whole turns from row to row, which are taken out",) * bool(turned)
    log = JointLog(table.path, run, runs, table.numbers["time_s"], q, link, table.stack(TORQUE, np.nan), told)
    if sealed:
        return log
    log = log.take(np.argsort(run, kind="stable"))  # recordings may lie between one another, row by row
    if not log.joints:
        raise BadInput(
            f"{table.path}: no joint has {FEW} rows with a link side, in runs of more than {SHORT}, and moved by more than "
            f"{np.degrees(MOVED):g} deg; record a motion, and name a run in all its rows alike"
        )
    return replace(log, notices=(*log.notices, *_notices(table, log)))


def refuse_radians(log: JointLog, robot: Robot) -> None:
    """Raises BadInput: axes clearly beyond the robot's limits that lie within them once they are taken for radians."""
    low, high = robot.q_min - MOVED, robot.q_max + MOVED
    degrees, radians = (np.mean((low < q) & (q < high)) > 1.0 - WILD for q in (log.q, np.degrees(log.q)))
    if radians and not degrees:
        raise BadInput(f"{log.path}: the axes leave the robot's limits, and would keep them in radians; give degrees")


def refuse_torque_unit(log: JointLog, weight: Array) -> None:
    """Raises BadInput: torques of joint 2 or 3 that are far from all that the arm's weight (n, 6) N m asks for, as in another
    unit or on the motor's side of the gear."""
    for j in (1, 2):
        known = np.isfinite(log.tau[:, j])
        told, asked = (float(np.sqrt(np.mean(v[known, j] ** 2))) if known.any() else 0.0 for v in (log.tau, weight))
        if told > 0 and asked > HEAVY and not 1.0 / OTHER_TORQUE < told / asked < OTHER_TORQUE:
            raise BadInput(
                f"{log.path}, column {TORQUE[j]}: {told:.3g} N m (rms) where the arm's weight alone takes {asked:.3g}; give N m "
                "at the link side of the gear"
            )


def _unwrapped(angles: Array, run: Index) -> Array:
    """Angles (n, k) rad, nan where unknown, without the whole turns by which they jump inside a run."""
    out = angles.copy()
    for k in range(run.max(initial=-1) + 1):
        for column in out.T:
            rows = np.flatnonzero((run == k) & np.isfinite(column))
            column[rows[1:]] -= 2 * np.pi * np.cumsum(np.round(np.diff(column[rows]) / (2 * np.pi)))
    return out


def _check_link(table: CsvTable, q: Array, link: Array) -> None:
    """A link side in radians, of the motor's own turns or with the other sign is no gap but a mistake."""
    for j, column in enumerate(LINK):
        known = np.flatnonzero(np.isfinite(link[:, j]))
        if len(known) < FEW or np.ptp(q[known, j]) < MOVED:
            continue
        off = link[known, j] - q[known, j]
        off = off - np.median(off)
        limit = max(APART, 0.5 * np.ptp(q[known, j])) if np.ptp(q[known, j]) < 2 * APART else APART
        worst = int(np.argmax(np.abs(off)))
        if np.mean(np.abs(off) > limit) > WILD:
            slope = np.polyfit(q[known, j], link[known, j], 1)[0]
            how = "counts the other way" if slope < 0 else f"moves {slope:.3g} deg a degree of the motor side"
            raise table.refuse(
                int(known[worst]),
                column,
                f"is {np.degrees(off[worst]):.1f} deg off {AXES[j]} beyond a constant and {how}; give "
                "both in degrees at the link, with the axis' sign",
            )


def _check_speeds(table: CsvTable, run: Index) -> None:
    """Raises BadInput: speeds of which the angles' steps are another multiple than of times in seconds."""
    order = np.argsort(run, kind="stable")
    inside, time = np.diff(run[order]) == 0, table.numbers["time_s"][order]
    for column, angle in ((c, a) for c, a in zip(SPEED, AXES, strict=True) if c in table.numbers):
        speed, along = table.numbers[column][order], table.numbers[angle][order]
        went, told = np.diff(along)[inside], (0.5 * (speed[1:] + speed[:-1]) * np.diff(time))[inside]
        far = np.isfinite(told) & (np.abs(went) > FAR * np.abs(went).max(initial=0.0))
        if np.count_nonzero(far) < FEW or np.abs(went[far]).sum() < np.degrees(MOVED):
            continue
        ratio = told[far] / went[far]
        usual = float(np.median(ratio))
        alike = np.mean(np.abs(ratio - usual) < ALIKE * abs(usual))  # noise of either, or an arm that stands, scatters them
        if usual > 0 and alike > SHARED and not 1.0 / OTHER_SPEED < usual < OTHER_SPEED:
            raise table.refuse(
                int(order[np.nanargmax(np.abs(speed))]),
                column,
                f"makes {usual:.3g} times the way by which {angle} changes over time_s; give deg/s, and times in seconds",
            )


def _notices(table: CsvTable, log: JointLog) -> list[str]:
    """What was ignored or is absent, and what that blinds."""
    name = table.path.name
    found = table.ignored_columns()
    step = float(np.median(np.diff(log.time)[np.diff(log.run) == 0])) if len(log) > 1 else 0.0
    if step > SLOW:
        found.append(f"{name}: rows stand {step:.3g} s apart: are times in seconds? delays show in faster logs alone")
    copied = [j for j in log.joints if np.array_equal(log.link[:, j - 1], log.q[:, j - 1])]
    without = [j for j in range(1, 7) if j not in log.joints]
    still = [j for j in without if LINK[j - 1] in table.numbers]
    dark = [TORQUE[j - 1] for j in log.joints if not np.isfinite(log.tau[:, j - 1]).any()]
    told: dict[str, Sequence[object]] = {
        "the link side of joint {} is a copy of its motor's: it shows no gap": copied,
        "the link side of joint {} is not used, the joint hardly moved": still,
        f"no link side of joint {{}}: it says nothing of {'it' if len(without) == 1 else 'them'}": without,
        "no column {}: the load is taken from the believed arm, springs show less sharply": dark,
    }
    return found + [f"{name}: {words.format(', '.join(map(str, which)))}" for words, which in told.items() if which]
