"""A grinding-force log as recorded: axes, planned contact points, forces and conditions (FORMATS, force.csv)."""

import hashlib
from collections.abc import Iterable
from dataclasses import dataclass, replace
from itertools import pairwise, product
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.fft import dct

from ocp.model.cell import Cell
from robots.column_mapping import SEALED, ColumnMapping
from robots.csv_table import OURS, CsvTable, read_csv_table
from robots.errors import BadInput, shown
from robots.pose import Array, Stacked

Index = NDArray[np.int64]
Flags = NDArray[np.bool_]

AXES = tuple(f"q{i}_deg" for i in range(1, 7))
POINT, NORMAL, FEED = (tuple(f"{stem}{a}{unit}" for a in "xyz") for stem, unit in (("p", "_mm"), ("n", ""), ("t", "")))
CONDITIONS = ("setpoint_N", "feed_mm_s", "belt_m_s", "line", "ground_before", "temperature_C", "wheel_temperature_C", "clock_s")
OPTIONAL = ("s_mm", "ft_N", "sigma_fn_N", "sigma_ft_N", "contact", "session", *CONDITIONS)
# What a missing column cannot show; the words after "no column NAME".
BLIND = {
    "contact": "rows whose fn_N stays near zero are taken as air runs",
    "setpoint_N": "the cell's setpoint is taken, but for runs that plainly press otherwise",
    "belt_m_s": "the cell's belt speed is taken for every row, a reversed or stopped belt cannot be seen",
    "ft_N": "friction cannot be tested",
    "clock_s": "wear, drift and heat cannot be seen",
    "session": "a blade gripped anew or a wheel moved between sessions cannot be seen",
    "line": "errors cannot be told by line of the blade",
    "ground_before": "material removal cannot be tested",
    "feed_mm_s": "the feed of the log is taken from its points, effects of speed are seen less sharply",
    "wheel_temperature_C": "heat in the wheel cannot be tested",
}
# Columns in SI that are taken as they are, by their names here.
PLAIN = {**{"ft": "ft_N", "belt": "belt_m_s"}, **{"temperature": "temperature_C", "wheel_temperature": "wheel_temperature_C"}}
UNIT_TOLERANCE = 0.01  # of a unit vector's length
SQUARE = 0.05  # largest |n . t|
UNITS_APART = 30.0  # no process runs at thirty times its setpoint; kilonewtons and grams are farther off
OTHER_UNITS = {"kilograms-force (or decanewtons)": 9.80665, "pounds-force": 4.44822, "kilonewtons": 1000.0}  # N
OTHER_UNIT_NEAR = 0.08  # a controlled force keeps as near to its setpoint
SAME_SETPOINT = 5e-4  # a setpoint is a round number in one unit only
MOST_FRICTION = 3.0  # coated abrasives grind with 0.3 to 1
BACKWARD = 0.05  # of the normal force, by which a pull against the belt is no sensor's zero
EXCHANGED = 0.3  # of how far fn_N is from what was asked for (log), how near a larger ft_N is then
OTHER_TIME = 50.0  # times slower than the feed: milliseconds are farther off, what a log may say of its feed is nearer
FEED_APART = 3.0  # times; other units are farther apart, a feed that ramps or that an override lowers is nearer
LEAST_WAY = 5e-3  # m; over which points that move were ground along, however slowly they seem to move
CREEP = 1e-3  # m/s; points that are read off a standing arm move by less
AIR_SHARE = 0.15  # of the log's usual force, below which a row without `contact` is taken for air
AIR_WINDOW = 9  # rows over whose median that is judged
STILL = 100  # rows in contact after the first of their recording: one that never changes over more of them is no reading
AT_LIMIT, LEAST_AT_LIMIT = 0.02, 5  # share of the rows in contact, and rows, that read the log's very largest force: its end
FINE_STEPS = 0.01  # of that, up to which a sensor's steps are fine: one of coarser steps reads one force often anyhow
BELOW_LIMIT, PILED = 0.1, 2.0  # readings in the tenth below, times as often as any of which it then stands
LEAST_ROWS = 20  # in contact that follow another of their recording: a sensor's noise is known to a quarter of itself by so many
OTHER_CLOCKS = {1e3: "milliseconds", 1.0 / 60.0: "minutes", 1.0 / 3600.0: "hours"}  # by what they count of a second
OTHER_CLOCK_NEAR = 0.1  # of that; clocks are alike to less
COARSE = 2.0  # s a recording that are not known better
UNCOUNTED = 10.0  # times as long as its clock says: a wheel may stand meanwhile
WORDS = 8  # of a log that are remembered
MARKED = 20  # rows of a recording by which it is told again
WAVED, WAVING, WAVES = "~", 3, 6  # sign of the words that tell the waves of a recording, recordings and waves that are told
ROUNDED = 1.5e-3  # N; numbers rounded to 0.01 N move a wave by less, noise of 0.1 N moves each of them by ten times that
COPIED = 5  # rows from which a recording that is another's to the last digit is its copy
STEADY = 0.75  # of a run's usual largest feed, up to which wheel and blade meet
AIR_APART = 1.0  # s from contact, from which low readings are of the air: ramps take less
SETTLING = 0.08  # s after that: three time constants and the delay of a flange of 10 Hz and 10 ms


@dataclass(frozen=True)
class ForceLog(Stacked):
    """n rows in time order inside each run, SI and radians.

    run, session (n,): indices into `runs`, `sessions`; time (n,) s; q (n, 6) rad commanded; p (n, 3) m, n, t (n, 3) unit,
    blade frame; fn (n,) N, nan where it is to be predicted; contact (n,) False in an air run. None where the file has no
    such column: s m, ft N, sigma_fn N, sigma_ft N, setpoint N, feed m/s, belt m/s, line, ground_before, temperatures C,
    clock s. row (n,): line in the file. setpoint_sd (n,) N: one sigma of a setpoint that the readings gave, 0 where it was
    told; None where all were.
    """

    path: Path
    run: Index
    runs: tuple[str, ...]
    time: Array
    q: Array
    p: Array
    n: Array
    t: Array
    fn: Array
    contact: Flags
    session: Index
    sessions: tuple[str, ...]
    row: Index
    s: Array | None = None
    ft: Array | None = None
    sigma_fn: Array | None = None
    sigma_ft: Array | None = None
    setpoint: Array | None = None
    feed: Array | None = None
    belt: Array | None = None
    line: Index | None = None
    ground_before: Index | None = None
    temperature: Array | None = None
    wheel_temperature: Array | None = None
    clock: Array | None = None
    notices: tuple[str, ...] = ()
    setpoint_sd: Array | None = None

    def __len__(self) -> int:
        return len(self.q)


def read_force_log(path: str | Path, sealed: bool = False, mapping: ColumnMapping = OURS) -> ForceLog:
    """The rows of a force.csv; `sealed` files hold conditions to predict, without fn_N; mapping: how a table made by
    others becomes one of ours.

    Raises BadInput: as `read_csv_table`, and for vectors that are not unit or not square to each other, times that run
    back, flags, counts, feeds, setpoints and sigmas out of range, a force that is negative nearly throughout, no contact.
    """
    vectors = (*POINT, *NORMAL, *FEED)
    needed = ("run", "time_s", *AXES, *vectors, *(() if sealed else ("fn_N",)))
    optional = tuple(c for c in OPTIONAL if c != "ft_N") if sealed else OPTIONAL  # what is sealed is no condition
    return log_of_table(
        read_csv_table(path, needed, optional, ("run", "session"), (), mapping, f"{SEALED * sealed}force"), sealed
    )


def log_of_table(table: CsvTable, sealed: bool) -> ForceLog:
    """The log that the rows of a table are, which has all needed columns. Raises BadInput: as `read_force_log`."""
    n, t = table.stack(NORMAL), table.stack(FEED)
    _check_vectors(table, n, t)
    for column, words in table.words.items():
        for row, word in enumerate(words):
            if not word:
                raise table.refuse(row, column, "is empty where a label is expected; give one or remove the row")
    run, runs = table.labels("run")
    session, sessions = table.labels("session")
    _check_sessions(table, run, runs, session, sessions)
    table.check_order("time_s", run, runs, strictly=False)
    _check_running(table, "time_s", [np.flatnonzero(run == i) for i in range(len(runs))])
    if "clock_s" in table.numbers:  # one value a recording will do
        table.check_order("clock_s", run, runs, strictly=False)
        _check_running(table, "clock_s", [np.arange(len(table))])
        _check_clock(table, run)
    fn = np.full(len(table), np.nan) if sealed else table.numbers["fn_N"]
    known = {*table.numbers, *table.words, *(("contact", "ft_N") if sealed else ())}
    blind = [f"{table.path.name}: no column {c}: {text}" for c, text in BLIND.items() if c not in known]
    contact = _contact(table, fn, run)
    if not sealed:
        _check_force(table, fn, contact, run)
        _check_copies(table, fn, np.where(contact, run, -1), runs)
    found = ForceLog(
        path=table.path,
        run=run,
        runs=runs,
        time=table.numbers["time_s"],
        q=np.radians(table.stack(AXES)),
        p=1e-3 * table.stack(POINT),
        n=n / np.linalg.norm(n, axis=1, keepdims=True),
        t=t / np.linalg.norm(t, axis=1, keepdims=True),
        fn=fn,
        contact=contact,
        session=session,
        sessions=sessions,
        s=table.column("s_mm", 1e-3),
        sigma_fn=table.column("sigma_fn_N", 1.0, lambda v: v <= 0, "above 0"),
        sigma_ft=table.column("sigma_ft_N", 1.0, lambda v: v <= 0, "above 0"),
        setpoint=table.column("setpoint_N", 1.0, lambda v: v < 0, "zero or above"),
        feed=table.column("feed_mm_s", 1e-3, lambda v: v < 0, "zero or above"),
        line=_counts(table, "line"),
        ground_before=_counts(table, "ground_before"),
        row=np.array(table.line),
        notices=(*table.ignored_columns(), *blind, *_standing_still(table, run, contact), *_at_once(table, session, sessions)),
        clock=table.column("clock_s", 1.0, lambda v: v < 0, "zero or above: how long the wheel has run"),
        **{name: table.numbers.get(column) for name, column in PLAIN.items()},
    )
    return found if sealed or "contact" in table.numbers else _undoubted(found)


def refuse_few_rows(log: ForceLog) -> None:
    """Raises BadInput: fewer than LEAST_ROWS rows in contact follow another one of their recording."""
    follow = int(np.maximum(np.bincount(log.run[log.contact]) - 1, 0).sum())
    if follow < LEAST_ROWS:
        raise BadInput(
            f"{log.path}, columns run, contact: {follow} rows in contact follow another one of their recording; at least "
            f"{LEAST_ROWS} are needed to tell the sensor's noise"
        )


def refuse_saturated(log: ForceLog) -> None:
    """Raises BadInput: the sensor stood at the end of its range in a part of the log; more force would have read the same."""
    if (found := saturation(log)) is not None:
        raise BadInput(
            f"{log.path}, line {found[0]}, column fn_N: {found[1]}; measure with a larger range, or leave out those runs"
        )


def saturation(log: ForceLog) -> tuple[int, str] | None:
    """The first line that reads the end of a sensor's range, and what there is to say; None where it is not met."""
    fn = log.fn[log.contact]
    if not len(fn) or not np.isfinite(fn).all() or (top := float(fn.max())) <= 0:
        return None
    at = np.flatnonzero(log.contact & (log.fn == top))
    values, often = np.unique(fn, return_counts=True)
    coarse = len(values) == 1 or np.diff(values).min() > FINE_STEPS * top
    usual = often[:-1][values[:-1] >= (1.0 - BELOW_LIMIT) * top].max(initial=0)
    if coarse or len(at) < max(LEAST_AT_LIMIT, AT_LIMIT * len(fn), PILED * usual):
        return None
    share = f"{len(at)} of {len(fn)} rows in contact read {top:.6g} N, none more"
    return int(log.row[at[0]]), f"{share}: the sensor seems to be at the end of its range, and the force above it is not known"


def log_mark(log: ForceLog) -> str:
    """Words that tell recordings of a log again: of postures, points and forces where each comes into contact, whatever line
    endings, the order of columns, or rows taken off at the end; the least ones, which a part of the log mostly has too. And of
    the first recordings the slow waves of the force, which a copy with rounded numbers has as well."""
    told = np.column_stack([log.q, log.p, log.fn])
    rows = [np.flatnonzero((log.run == i) & log.contact) for i in np.unique(log.run)]
    long = [at[:MARKED] for at in rows if len(at) >= MARKED] or [np.flatnonzero(log.contact)]
    words = [hashlib.sha256(np.ascontiguousarray(told[at]).tobytes()).hexdigest()[:12] for at in long]
    return " ".join([*sorted(words)[:WORDS], *(_waves(log.fn[at]) for at in rows if len(at) >= MARKED)][: WORDS + WAVING])


def _waves(fn: Array) -> str:
    """A word of the forces (n,) of a recording: their number and the first cosine waves in them, N."""
    found = dct(fn, norm="ortho")[:WAVES] / np.sqrt(len(fn))
    return f"{WAVED}{len(fn)}:" + ",".join(f"{x:.4f}" for x in found)


def _alike(one: str, other: str) -> bool:
    """Whether two words of `_waves` are of one recording, but for rounding."""
    (n, mine), (m, theirs) = (word.removeprefix(WAVED).split(":") for word in (one, other))
    if n != m:
        return False
    return all(abs(float(a) - float(b)) < ROUNDED for a, b in zip(mine.split(","), theirs.split(","), strict=True))


def is_known(mark: str, marks: Iterable[str]) -> bool:
    """Whether recordings of a log are in one of these marks: two, or the only one."""

    def parted(one: str) -> tuple[set[str], list[str]]:
        words = one.split()
        return {word for word in words if word[0] != WAVED}, [word for word in words if word[0] == WAVED]

    mine, waves = parted(mark)
    for words, others in (parted(one) for one in marks if one):
        if len(mine & words) >= min(2, len(mine), len(words)):
            return True
        again = sum(any(_alike(wave, other) for other in others) for wave in waves)
        if waves and others and again >= min(2, len(waves), len(others)):
            return True
    return False


def steady_rows(log: ForceLog, flange: bool) -> Flags:
    """The rows (n,) of a log but those in contact where wheel and blade meet and part: from either end of a run until STEADY of
    its usual largest feed is reached, and SETTLING more. There the flange moves, and its mass, friction and late pressure make
    another force than the balance at rest that calibrations rest on; without a `flange` only the arm moves, and all are kept."""
    kept = np.ones(len(log), bool)
    for run in np.unique(log.run[log.contact]) if flange else ():
        at = np.flatnonzero((log.run == run) & log.contact)
        feed, time = _feed(log, at), log.time[at]
        fast = np.flatnonzero(feed >= STEADY * np.percentile(feed, 90))
        begin, end = time[fast[0]] + SETTLING * (fast[0] > 0), time[fast[-1]] - SETTLING * (fast[-1] < len(at) - 1)
        kept[at] = (time >= begin) & (time <= end)
    return kept


def _feed(log: ForceLog, at: Index) -> Array:
    """Feed m/s at rows of one run, by their points where the log does not tell it; even where their times do not rise."""
    if log.feed is not None:
        return log.feed[at]
    if len(at) < 2 or np.any(np.diff(log.time[at]) <= 0):
        return np.ones(len(at))
    way = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(log.p[at], axis=0), axis=1))])
    return np.asarray(np.gradient(way, log.time[at]))


def refuse_force_unit(log: ForceLog, cell: Cell) -> None:
    """Raises BadInput: the median force in steady contact is UNITS_APART times more or less than what the cell asks for, or as
    much less than what was asked for, row by row where the log says it, as another unit makes it."""
    wanted = cell.flange.setpoint if cell.flange is not None else cell.process.force
    own = log.setpoint if log.setpoint_sd is None else None
    steady = log.contact & steady_rows(log, cell.flange is not None)
    if not steady.any():
        steady = log.contact
    pressed = log.fn[steady]
    asked = np.full(len(pressed), wanted) if own is None else own[steady]
    there, seen, told = asked > 0, float(np.median(pressed)), float(np.median(asked))
    if cell.flange is not None and told == 0 < seen:
        k = int(log.row[np.flatnonzero(steady)[np.argmin(asked)]])
        raise BadInput(
            f"{log.path}, line {k}, column setpoint_N: 0 in contact, as in most of the log, where fn_N is {seen:.3g} N (median); "
            "give what the flange was asked for, or leave the column out"
        )
    share = float(np.median(pressed[there] / asked[there])) if there.any() else 1.0
    for unit, newtons in OTHER_UNITS.items():
        if abs(share * newtons - 1.0) < OTHER_UNIT_NEAR:
            raise BadInput(
                f"{log.path}, column fn_N: {share:.3g} times what was asked for in contact (median), as a force in {unit} would "
                f"be; give newtons (times about {newtons:.2g}), or what was really asked for in a column setpoint_N"
            )
        if wanted > 0 and share < UNITS_APART and abs(told * newtons / wanted - 1.0) < SAME_SETPOINT:
            raise BadInput(
                f"{log.path}, column setpoint_N: {told:.4g} (median) is the cell's setpoint of {wanted:g} N in {unit}; give "
                f"newtons (times {newtons:.4g}) in setpoint_N, fn_N and ft_N"
            )
    if own is not None and share > UNITS_APART:
        raise BadInput(
            f"{log.path}, column setpoint_N: fn_N is {share:.3g} times as large in contact (median); give both in newtons"
        )
    pull = 0.0 if log.ft is None else float(np.median(np.abs(log.ft[steady])))
    if min(told, seen) > 0 and pull > seen and abs(np.log(pull / told)) < EXCHANGED * abs(np.log(seen / told)):
        raise BadInput(
            f"{log.path}, columns fn_N, ft_N: fn_N is {seen:.3g} and ft_N {pull:.3g} in contact (median) where {told:.3g} N were "
            "asked for; they look exchanged: exchange them"
        )
    if pull > MOST_FRICTION * abs(seen):
        raise BadInput(
            f"{log.path}, column ft_N: {pull:.3g} in contact (median) where fn_N is {seen:.3g}: no belt pulls by over "
            f"{MOST_FRICTION:g} times the normal force; give both in newtons"
        )
    if wanted > 0 and not 1 / UNITS_APART < seen / wanted < UNITS_APART:
        raise BadInput(
            f"{log.path}, column fn_N: {seen:.3g} N in contact (median) where the cell asks for {wanted:g} N; give newtons, or "
            "correct the cell's setpoint_N"
        )
    _refuse_pull_backward(log, cell)


def _refuse_pull_backward(log: ForceLog, cell: Cell) -> None:
    """Raises BadInput: the tangential force is against the belt, as friction never is."""
    if log.ft is None:
        return
    belt = np.full(len(log), cell.wheel.belt_speed) if log.belt is None else log.belt
    at = np.flatnonzero(log.contact & (belt != 0))
    along = log.ft[at] * np.sign(belt[at])
    if len(at) and np.median(along) < -BACKWARD * abs(np.median(log.fn[at])):
        k = at[np.argmax(along < 0)]
        raise BadInput(
            f"{log.path}, line {log.row[k]}, column ft_N: {log.ft[k]:.3g} at a belt speed of {belt[k]:g} m/s is a pull against "
            "the belt, as in most of the log, where friction pulls along it: ft_N and belt_m_s are both positive along axis x "
            "outward radial of the wheel; turn the sign of the one that is not"
        )


def without_ramps(log: ForceLog, flange: bool) -> ForceLog:
    """The log without the rows that `steady_rows` leaves out. Raises BadInput: none in contact is left."""
    kept = steady_rows(log, flange)
    if kept.all():
        return log
    if not (kept & log.contact).any():
        raise BadInput(
            f"{log.path}, column feed_mm_s: no run keeps its feed for longer than wheel and blade take to meet and part; log "
            "longer passes, or more rows a second"
        )
    told = (
        f"{log.path.name}: {int((~kept).sum())} rows in which blade and wheel meet and part were left out: "
        "the flange moves there, and what it then gives is not its balance at rest"
    )
    return replace(log.take(kept), notices=(*log.notices, told))


def _check_vectors(table: CsvTable, n: Array, t: Array) -> None:
    for columns, vectors in ((NORMAL, n), (FEED, t)):
        length = np.linalg.norm(vectors, axis=1)
        bad = np.abs(length - 1.0) > UNIT_TOLERANCE
        if bad.any():
            k = int(np.argmax(bad))
            what = f"{columns[0]}, {columns[1]}, {columns[2]}"
            raise table.refuse(k, columns[0], f"makes the vector {what} {length[k]:.4g} long; a unit vector is expected")
    slant = np.abs(np.sum(n * t, axis=1))
    if (slant > SQUARE).any():
        k = int(np.argmax(slant > SQUARE))
        raise table.refuse(k, "tx", f"makes n . t = {slant[k]:.3f}; the feed direction must lie in the surface (below {SQUARE})")


def _contact(table: CsvTable, fn: Array, run: Index) -> Flags:
    """The column, else a running median of fn_N against the log's usual force."""
    if "contact" in table.numbers:
        flags = table.column("contact", 1.0, lambda v: ~np.isin(v, (0.0, 1.0)), "1 in contact or 0 in an air run")
        return np.asarray(flags == 1.0)
    if np.isnan(fn).all():
        return np.ones(len(fn), bool)
    limit = AIR_SHARE * float(np.percentile(fn, 90))
    from scipy.ndimage import median_filter  # only those who measured force wait for it

    level = np.empty_like(fn)
    for i in range(int(run.max()) + 1):
        level[run == i] = median_filter(fn[run == i], AIR_WINDOW, mode="nearest")
    return np.asarray(level > limit)


def _undoubted(log: ForceLog) -> ForceLog:
    """The log without what may be either: rows that count as air less than AIR_APART from one in contact, where the wheel meets
    or leaves the blade."""
    kept = log.contact.copy()
    for run in range(len(log.runs)):
        at = np.flatnonzero(log.run == run)
        touching = np.concatenate([[-np.inf], log.time[at][log.contact[at]], [np.inf]])
        k = np.searchsorted(touching, log.time[at])
        kept[at] |= np.minimum(log.time[at] - touching[k - 1], touching[k] - log.time[at]) >= AIR_APART
    count = int(np.count_nonzero(~kept))
    told = f"{log.path.name}: no column contact: {count} rows of low force within {AIR_APART:g} s of a touch are left out"
    return replace(log.take(kept), notices=(*log.notices, told)) if count else log


def _check_force(table: CsvTable, fn: Array, contact: Flags, run: Index) -> None:
    if not contact.any():
        raise BadInput(f"{table.path}: no row is in contact (column contact, or fn_N near zero throughout); nothing to fit")
    if np.median(fn[contact]) < 0:
        k = int(np.argmax(contact & (fn < 0)))
        raise table.refuse(k, "fn_N", "is negative as most of the log is; the force that presses wheel and blade is positive")
    recordings = [fn[contact & (run == i)] for i in np.unique(run[contact])]
    if sum(len(one) - 1 for one in recordings) > STILL and all(np.ptp(one) == 0 for one in recordings):
        why = "stays the same through every recording, as a setpoint does; give what the sensor read"
        raise table.refuse(int(np.argmax(contact)), "fn_N", why)


def _check_sessions(table: CsvTable, run: Index, runs: tuple[str, ...], session: Index, sessions: tuple[str, ...]) -> None:
    """Raises BadInput: a run of two sessions."""
    first = np.unique(run, return_index=True)[1]
    other = session != session[first][run]
    if other.any():
        k = int(np.argmax(other))
        name, before = shown(runs[run[k]]), shown(sessions[session[first[run[k]]]])
        why = f"is another than at the beginning of run {name} ({before}); a run is one recording: give each a name of its own"
        raise table.refuse(k, "session", why)


def _standing_still(table: CsvTable, run: Index, contact: Flags) -> list[str]:
    """Notices of a belt that stands in contact, and of a feed that is not what the points move by."""
    found, p, time = [], 1e-3 * table.stack(POINT), table.numbers["time_s"]
    follows = contact[1:] & contact[:-1] & (run[1:] == run[:-1]) & (np.diff(time) > 0)
    moving = np.linalg.norm(np.diff(p, axis=0), axis=1)[follows] / np.diff(time)[follows]
    if "belt_m_s" in table.numbers and not table.numbers["belt_m_s"][contact].any():
        found.append(f"{table.path.name}, column belt_m_s: 0 in every row in contact; a belt that stands grinds nothing")
    ways = [float(np.linalg.norm(np.ptp(p[contact & (run == i)], axis=0))) for i in np.unique(run[contact])]
    if "feed_mm_s" in table.numbers and len(moving) and (np.median(moving) > CREEP or np.median(ways) > LEAST_WAY):
        feed, path = float(np.median(table.numbers["feed_mm_s"][contact])), 1e3 * float(np.median(moving))
        if feed > OTHER_TIME * path > 0:
            why = f"makes the points move at {path:.3g} mm/s (median) where feed_mm_s says {feed:.3g}; give seconds"
            raise table.refuse(int(np.argmax(contact)), "time_s", why)
        if path > 0 and not 1 / FEED_APART < feed / path < FEED_APART:
            found.append(
                f"{table.path.name}, column feed_mm_s: {feed:.3g} in contact (median) while the points move at {path:.3g} mm/s "
                "by time_s; give the feed in mm/s and the time in s, or leave the column out"
            )
    return found


def _check_running(table: CsvTable, column: str, parts: list[Index]) -> None:
    """Raises BadInput: a clock that stands still through every part of more than STILL rows."""
    long = [at for at in parts if len(at) > STILL]
    if long and all(np.ptp(table.numbers[column][at]) == 0 for at in long):
        raise table.refuse(int(long[0][-1]), column, "stands still throughout; give a time that runs")


def _check_clock(table: CsvTable, run: Index) -> None:
    """Raises BadInput: a clock in another unit than the times, or one that counts less than a tenth of the recordings."""
    time, clock = table.numbers["time_s"], table.numbers["clock_s"]
    rows = sorted((np.flatnonzero(run == i) for i in np.unique(run)), key=lambda at: float(clock[at[0]]))
    went, counted = (np.array([float(np.ptp(values[at])) for at in rows]) for values in (time, clock))
    for (unit, name), wrong in product(OTHER_CLOCKS.items(), ("clock_s", "time_s")):
        most, right = (counted, went) if wrong == "clock_s" else (went, counted)
        like = (right > 0) & (np.abs(most - unit * right) < OTHER_CLOCK_NEAR * unit * right)
        if np.count_nonzero(like) > 0.5 * len(rows):
            at, other = int(np.argmax(like)), "time_s" if wrong == "clock_s" else "clock_s"
            why = f"counts {most[at]:.6g} where {other} counts {right[at]:.6g} s in this run: {name}? give seconds"
            raise table.refuse(int(rows[at][-1]), wrong, why)
    span, recorded = float(np.ptp([clock[at[0]] for at in rows] or [0.0])), float(went[:-1].sum())
    if recorded > COARSE * len(rows) + UNCOUNTED * span:
        why = f"counts {span:.6g} s from the first recording to the last, those before it take {recorded:.6g} s; give one clock"
        raise table.refuse(int(rows[-1][0]), "clock_s", f"{why} of seconds for all")


def _at_once(table: CsvTable, session: Index, sessions: tuple[str, ...]) -> list[str]:
    """A notice of sessions that overlap on the campaign's clock, as those do that each began at zero."""
    clock = table.numbers.get("clock_s", np.zeros(len(table)))
    spans = sorted((*np.quantile(clock[session == k], (0.0, 1.0)).tolist(), shown(name)) for k, name in enumerate(sessions))
    return [
        f"{table.path.name}, column clock_s: session {other} begins at {begin:g} s, before session {one} ends at {end:g} s; one "
        "clock counts for all: where each began at zero, what wears, warms up or drifts is told wrong"
        for (_, end, one), (begin, _, other) in pairwise(spans)
        if begin < end
    ][:1]


def _check_copies(table: CsvTable, fn: Array, run: Index, runs: tuple[str, ...]) -> None:
    """Raises BadInput: more than COPIED rows that are others of their recording again, a recording of more than COPIED rows that
    has the same postures and forces as another; run (n,): -1 for rows in the air, where a sensor may well read the same."""
    seen: dict[bytes, int] = {}
    q = table.stack(AXES)
    rows = np.column_stack([run, *table.numbers.values()])[run >= 0]
    _, at_first, group = np.unique(rows, axis=0, return_index=True, return_inverse=True)
    sources = at_first[group.ravel()]
    again = np.flatnonzero(sources != np.arange(len(rows)))
    if len(again) > COPIED:
        copy, source = np.flatnonzero(run >= 0)[[again[0], sources[again[0]]]]
        raise table.refuse(int(copy), "time_s", f"repeats line {table.line[source]}, as {len(again)} rows do; remove the copies")
    for i in range(len(runs)):
        at = np.flatnonzero(run == i)
        first = seen.setdefault(np.column_stack([q[at], fn[at]]).tobytes(), i) if len(at) > COPIED else i
        if first != i:
            why = f"holds the readings of run {shown(runs[first])} again; give each recording once"
            raise table.refuse(int(at[0]), "run", why)


def _counts(table: CsvTable, column: str) -> Index | None:
    values = table.column(column, 1.0, lambda v: (v < 0) | (v != np.round(v)), "a whole number, zero or above")
    return None if values is None else values.astype(np.int64)
