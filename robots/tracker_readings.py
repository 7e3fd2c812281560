"""Laser-tracker readings: what was commanded, what hung on the robot, what the tracker saw (FORMATS, tracker.csv)."""

from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from robots.column_mapping import SEALED, ColumnMapping
from robots.csv_table import OURS, CsvTable, read_csv_table
from robots.errors import BadInput, shown
from robots.pose import Array, Index, Mask, Stacked, rotations_in_order

AXES = tuple(f"q{i}_deg" for i in range(1, 7))
POINT = ("x_mm", "y_mm", "z_mm")
LOAD = ("fx_N", "fy_N", "fz_N", "mx_Nm", "my_Nm", "mz_Nm")
PLACE = ("lx_mm", "ly_mm", "lz_mm")
TURN = ("rx_deg", "ry_deg", "rz_deg")
QUATERNION = ("qw", "qx", "qy", "qz")
ROTATION = "zyx_intrinsic"  # order in which they turn: R = Rz(rz) Ry(ry) Rx(rx)
UNIT = 1e-2  # how far a quaternion's length may be from one
SEVENTH = "q7_deg"
# Share of rows that are copies: above, the file was put together wrongly, and which rows were measured is its owner's to say.
COPIES = 0.2
# Digits that are coarser than this share of the instrument's noise let two readings of one pose agree by chance: noise s and last
# digit r agree in one coordinate with probability r / (2 sqrt(pi) s), here in all three once in a thousand times.
CHANCE = 0.35
DECIMALS = 6  # of a millimetre that are looked for
LISTED = 5  # copies that a notice lists
APPROACH = tuple(f"approach{i}" for i in range(1, 7))
WORDS = ("target", "payload", "session", "station")
SINGLE = ("time_s", "temperature_C", "load_link", "sigma_um", "sigma_rot_deg")
OPTIONAL = (*POINT, *WORDS, *APPROACH, *LOAD, *PLACE, *TURN, *QUATERNION, *SINGLE)
WARMEST = 55.0  # deg C that arms are made for; a hall at 68 to 77 is one in degrees Fahrenheit
LONGEST = 3600.0  # s between most readings; a robot that moves and settles takes some twenty, which in milliseconds are hours
LEAST_OF_STRATUM = 30  # readings of a station, nest and payload that thinning leaves
REPEAT_TOLERANCE = np.radians(1e-4)
RESTARTS = 3  # times that a clock begins anew in a session; rows sorted by something else fall back far oftener
# What a missing column cannot show.
BLIND = {
    "approach1": "no approach columns: backlash cannot be tested",
    "temperature_C": "no column temperature_C: growth with temperature cannot be seen",
    "time_s": "no column time_s: drift cannot be seen",
}


@dataclass(frozen=True)
class Nest:
    """A reflector nest or 6D target: the link it sits on (0..6, 6 = flange), place (3,) m and turn (3, 3) in that link's
    MD-H frame, or None where the cell does not say where it is."""

    link: int = 6
    place: Array | None = None
    turn: Array | None = None


@dataclass(frozen=True)
class Hanging:
    """A payload: mass kg, centre (3,) m in the flange frame, moments of inertia (3,) kg m^2 about it along the flange's axes
    (zero: a point, as controllers take it where none are told)."""

    mass: float = 0.0
    com: Array = field(default_factory=lambda: np.zeros(3))
    inertia: Array = field(default_factory=lambda: np.zeros(3))


@dataclass(frozen=True)
class Instrument:
    """The cell's tracker: one sigma m along the beam and per m of range more across it, sd m of nest places, the nests, and the
    order (one of ROTATION_ORDERS) in which a 6D target's angles turn."""

    range_noise: float = 8e-6
    transverse_noise: float = 3e-6
    nest_sd: float = 1e-3
    nests: dict[str, Nest] | None = None
    rotation: str = ROTATION


@dataclass(frozen=True)
class Readings(Stacked):
    """n readings. q (n, 6) rad commanded; point (n, 3) m in the tracker's frame, nan where it is to be predicted.

    Words as indices into their names: target, payload, session, station (n,). load (n, 6) N, N m in base axes at
    load_place (n, 3) m of load_link (n,); approach (n, 6) or None; time s, temperature C, sigma m (n,) or None; waited (n,) s
    since the last reading before the motion to this one and moved (n, 6) rad by it (`last_motions`), None without times; turn
    (n, 3, 3) with sigma_turn (n,) rad of a 6D target or None, angles (n, 3) rad that it was made of (None: no angles were given);
    line (n,) in the file.
    """

    path: Path
    q: Array
    point: Array
    target: Index
    targets: tuple[str, ...]
    payload: Index
    payloads: tuple[str, ...]
    station: Index
    stations: tuple[str, ...]
    session: Index
    sessions: tuple[str, ...]
    load: Array
    load_link: Index
    load_place: Array
    line: Index
    approach: Array | None = None
    time: Array | None = None
    waited: Array | None = None
    moved: Array | None = None
    temperature: Array | None = None
    sigma: Array | None = None
    turn: Array | None = None
    sigma_turn: Array | None = None
    angles: Array | None = None
    notices: tuple[str, ...] = ()

    def __len__(self) -> int:
        return len(self.q)

    @property
    def turned(self) -> Mask:
        """Which readings (n,) have an orientation."""
        if self.turn is None:
            return np.zeros(len(self), bool)
        return np.asarray(np.isfinite(self.turn).all(axis=(1, 2)))

    def timed(self, time: Array) -> "Readings":
        """The readings, nothing else having been read between them, at instants (n,) s, with the motion to each."""
        waited, moved = last_motions(time, self.motions, self.session)
        return replace(self, time=time, waited=waited, moved=moved)

    def among(self, others: "Readings") -> "Readings":
        """The readings where `others` were read before, between and after them: the arm came from these, too."""
        if self.time is None or others.time is None:
            return self
        motions = [r.motions if self.approach is not None and others.approach is not None else r.q for r in (self, others)]
        session = np.concatenate([np.array(r.sessions)[r.session] for r in (self, others)])
        waited, moved = last_motions(np.append(self.time, others.time), np.concatenate(motions), session)
        return replace(self, waited=waited[: len(self)], moved=moved[: len(self)])

    @property
    def motions(self) -> Array:
        """What tells the motion to a reading from the one before: axes (n, 6) rad, and beside them signs where they are known."""
        return self.q if self.approach is None else np.hstack([self.q, self.approach])

    def strata(self) -> list[Index]:
        """Rows of each nest with each payload from each station: what thinning and folds must not empty."""
        keys = np.column_stack([self.station, self.target, self.payload])
        kind = np.unique(keys, axis=0, return_inverse=True)[1].ravel()
        return [np.flatnonzero(kind == k) for k in range(kind.max() + 1)]

    def thinned(self, most: int) -> "Readings":
        """About so many readings, evenly taken from each stratum, of which LEAST_OF_STRATUM stay at least (or all)."""
        n = len(self)
        if n <= most:
            return self
        counts = [(rows, max(round(most * len(rows) / n), min(len(rows), LEAST_OF_STRATUM))) for rows in self.strata()]
        few = [rows[np.linspace(0, len(rows) - 1, count).astype(np.int64)] for rows, count in counts]
        return self.take(np.sort(np.concatenate(few)))

    def postures(self) -> Index:
        """Group (n,) of each reading: the same commanded axes. What a model lacks is alike in all of them."""
        return np.asarray(np.unique(np.round(self.q / REPEAT_TOLERANCE), axis=0, return_inverse=True)[1], np.int64).ravel()

    def repeats(self) -> Index:
        """Group (n,) of each reading: the same axes, target, payload, load, approach, station and session."""
        keys = [np.round(self.q / REPEAT_TOLERANCE), *(getattr(self, w)[:, None] for w in WORDS), self.load]
        keys += [self.load_link[:, None], self.load_place]
        if self.approach is not None:
            keys.append(self.approach)
        return np.asarray(np.unique(np.hstack(keys), axis=0, return_inverse=True)[1], np.int64).ravel()


def planned_readings(q: Array, target: Index, targets: tuple[str, ...], payload: Index, payloads: tuple[str, ...]) -> Readings:
    """Readings (n,) that are yet to be taken: joints q (n, 6) rad, indices of nests and payloads; one station."""
    n = len(q)
    one = np.zeros(n, np.int64), ("",)
    measured, unloaded, flange = np.full((n, 3), np.nan), np.zeros((n, 6)), np.full(n, 6)
    words = target, targets, payload, payloads, *one, *one
    return Readings(Path("poses.csv"), q, measured, *words, unloaded, flange, unloaded[:, :3], line=np.arange(n) + 2)


def read_readings(
    path: str | Path, payloads: dict[str, Hanging], instrument: Instrument, sealed: bool = False, mapping: ColumnMapping = OURS
) -> Readings:
    """Readings of a tracker.csv; `sealed` files have conditions to predict and no measured columns; mapping: how a table made by
    others becomes one of ours.

    Raises BadInput: as `read_csv_table`, and a payload, target, sign or link that does not exist.
    """
    needed = AXES if sealed else (*AXES, *POINT)
    table = read_csv_table(
        path, needed, OPTIONAL, WORDS, (*POINT, *TURN, *QUATERNION, "sigma_rot_deg"), mapping, f"{SEALED * sealed}tracker"
    )
    if SEVENTH in table.ignored:
        raise BadInput(
            f"{table.path}: column {SEVENTH}: an arm of seven axes is not one of six; if it is a rail or a table, measure with "
            "it standing still and remove the column"
        )
    notices = _notices(table, payloads)
    came = _last_motions(table)
    if not sealed:
        table = _without_copies(_without_gaps(table, notices), notices, 1e3 * instrument.range_noise)
        _refuse_zeros(table)
    n = len(table)
    measured = all(c in table.numbers for c in POINT)
    nests = instrument.nests or {}
    # Without the column one nest was used, and nobody says which.
    named = tuple(nests) if nests and "target" in table.words else None
    target, targets = _words(table, "target", named, "tracker.targets")
    payload, names = _words(table, "payload", tuple(payloads) if payloads else None, "payloads")
    station, stations = _words(table, "station")
    session, sessions = _words(table, "session")
    turn = _turns(table, mapping.rotation or instrument.rotation)
    turn_sd = table.column("sigma_rot_deg", np.pi / 180.0, lambda v: v <= 0, "above 0")
    return Readings(
        path=table.path,
        q=np.radians(table.stack(AXES)),
        point=1e-3 * table.stack(POINT) if measured else np.full((n, 3), np.nan),
        target=target,
        targets=targets,
        payload=payload,
        payloads=names,
        station=station,
        stations=stations,
        session=session,
        sessions=sessions,
        load=table.stack(LOAD, 0.0),
        load_link=_links(table),
        load_place=1e-3 * table.stack(PLACE, 0.0),
        approach=_signs(table),
        time=table.numbers.get("time_s"),
        waited=None if came is None else np.array([came[line][0] for line in table.line]),
        moved=None if came is None else np.array([came[line][1:] for line in table.line]),
        temperature=table.numbers.get("temperature_C"),
        sigma=table.column("sigma_um", 1e-6, lambda v: v <= 0, "above 0"),
        turn=turn,
        sigma_turn=turn_sd,
        angles=np.radians(table.stack(TURN)) if turn is not None and _all(table, TURN) else None,
        line=np.array(table.line),
        notices=tuple(notices),
    )


def _refuse_zeros(table: CsvTable) -> None:
    """Raises BadInput at the first reading of 0, 0, 0."""
    for row in np.flatnonzero(~table.stack(POINT).any(axis=1))[:1]:
        raise BadInput(f"{table.path}, line {table.line[row]}: the reading is 0, 0, 0, the tracker itself; remove the row")


def last_motions(time: Array, motions: Array, session: NDArray[np.generic]) -> tuple[Array, Array]:
    """The motions that led to readings at times (n,) s of sessions (n,), told apart by rows of `motions` (n, k), axes rad first.

    Time (n,) s since the last reading that another motion led to (the motion to a reading began at the earliest then) and by how
    far (n, 6) rad each axis moved. Before the first of a session nobody knows: the median of the others' times, and no motion.
    """
    waited, moved = np.full(len(time), np.inf), np.zeros((len(time), 6))
    for one in np.unique(session):
        rows = np.flatnonzero(session == one)
        order = rows[np.argsort(time[rows], kind="stable")]
        steps = np.diff(motions[order], axis=0, prepend=motions[order[:1]])
        fresh = np.abs(steps).max(axis=1) > REPEAT_TOLERANCE
        first = np.maximum.accumulate(np.where(fresh, np.arange(len(fresh)), 0))  # the first reading after each one's motion
        waited[order] = time[order] - np.append(-np.inf, time[order][:-1])[first]
        moved[order] = steps[first, :6]
    known = np.isfinite(waited)
    return np.where(known, waited, np.median(waited[known])) if known.any() else waited, moved


def _last_motions(table: CsvTable) -> dict[int, Array] | None:
    """What was waited and moved for each line of a table, also where the tracker saw nothing; None without times."""
    if "time_s" not in table.numbers:
        return None
    motions = np.hstack([np.radians(table.stack(AXES)), table.stack(APPROACH, 0.0)])
    session = np.asarray(table.labels("session")[0]) if "session" in table.words else np.zeros(len(table), np.int64)
    return dict(zip(table.line, np.column_stack(last_motions(table.numbers["time_s"], motions, session)), strict=True))


def _notices(table: CsvTable, payloads: dict[str, Hanging]) -> list[str]:
    """What was ignored or is absent, and what that blinds."""
    name = table.path.name
    found = table.ignored_columns()
    found += [text for column, text in BLIND.items() if column not in table.numbers]
    for group in (APPROACH, TURN, QUATERNION):
        given = [c for c in group if c in table.numbers]
        if 0 < len(given) < len(group):
            found.append(f"{name}: of {', '.join(group)} only {', '.join(given)} are given; they are ignored")
    found += _clock_begun_anew(table)
    warm = table.numbers.get("temperature_C", np.zeros(0))
    if (warm > WARMEST).sum() > len(warm) / 2:
        found.append(
            f"{name}: temperature_C is above {WARMEST:g} in most rows, warmer than arms are made for; if these are degrees "
            "Fahrenheit, convert them"
        )
    apart = np.diff(np.sort(table.numbers.get("time_s", np.zeros(2))))
    if len(apart) and np.median(apart) > LONGEST:
        hours = np.median(apart) / 3600
        found.append(f"{name}: readings are {hours:.1f} h apart in the median; if time_s is in milliseconds, divide it by 1000")
    if "payload" not in table.words and len(payloads) > 1:
        found.append(f"{name}: no column payload: '{next(iter(payloads))}' is taken to hang on the flange throughout")
    return found


def _clock_begun_anew(table: CsvTable) -> list[str]:
    """A sentence where times fall back in a session, less often than in rows that somebody sorted by something else."""
    session, names = table.labels("session")
    for one in range(len(names) if "time_s" in table.numbers else 0):
        rows = np.flatnonzero(session == one)
        time = table.numbers["time_s"][rows]
        back = np.flatnonzero(np.diff(time) < 0)
        if 0 < len(back) <= RESTARTS:
            k = back[0]
            return [
                f"{table.path.name}, line {table.line[rows[k + 1]]}: time_s goes back from {time[k]:g} to {time[k + 1]:g} s; "
                "rows are taken in the order of their times: if a clock began anew there, give what follows a session of its own"
            ]
    return []


def _without_gaps(table: CsvTable, notices: list[str]) -> CsvTable:
    """The table without rows in which the tracker saw nothing; a point of which a part is missing is refused."""
    missing = np.isnan(table.stack(POINT))
    for row in np.flatnonzero(missing.any(axis=1) & ~missing.all(axis=1))[:1]:
        column = POINT[int(np.argmax(missing[row]))]
        raise BadInput(f"{table.path}, line {table.line[row]}, column {column}: the cell is empty; fill it in or remove the row")
    gaps = missing.all(axis=1)
    if not gaps.any():
        return table
    keep = np.flatnonzero(~gaps)
    if not len(keep):
        raise BadInput(f"{table.path}: no row has a point; fill in x_mm, y_mm, z_mm")
    notices.append(f"{table.path.name}: {gaps.sum()} rows without a point are passed over")
    return table.take(keep)


def _turns(table: CsvTable, order: str) -> Array | None:
    """Orientations (n, 3, 3) of 6D targets from quaternions or angles in an order, nan where a row has none; None where no row
    has one. Raises BadInput: both are given, one is given in part, or a quaternion's length is not one."""
    given = [group for group in (TURN, QUATERNION) if _all(table, group)]
    if len(given) > 1:
        raise BadInput(f"{table.path}: orientations stand there as {', '.join(TURN)} and as {', '.join(QUATERNION)}; remove one")
    if not given:
        return None
    numbers = table.stack(given[0])
    known, part = np.isfinite(numbers).all(axis=1), np.isfinite(numbers).any(axis=1)
    for row in np.flatnonzero(part & ~known)[:1]:  # left out in silence, the rest of the row would be a point
        column = given[0][int(np.argmin(np.isfinite(numbers[row])))]
        raise BadInput(
            f"{table.path}, line {table.line[row]}, column {column}: the cell is empty; fill in the whole turn or none of it"
        )
    if not known.any():
        return None
    turns = np.full((len(table), 3, 3), np.nan)
    if given[0] == TURN:
        turns[known] = rotations_in_order(np.radians(numbers[known]), order)
        return turns
    off = np.where(known, np.abs(np.linalg.norm(numbers, axis=1) - 1.0), 0.0)
    if off.max() > UNIT:
        row = int(np.argmax(off))
        raise table.refuse(row, "qw", f"and qx, qy, qz have length {np.linalg.norm(numbers[row]):g}, not 1; correct the row")
    turns[known] = Rotation.from_quat(np.roll(numbers[known], -1, axis=1)).as_matrix()  # SciPy's scalar comes last
    return turns


def _without_copies(table: CsvTable, notices: list[str], noise: float) -> CsvTable:
    """The table with each reading once, which `notices` tell; noise: the instrument's, mm.

    A copy has the axes, the point and the turn of another row to the last digit. A pose measured anew gives other digits, unless
    the file rounds them away: then a copy is equal in all columns, and without times nobody can tell it from a pose measured
    anew. Raises BadInput where copies differ in what hung where, and where they are many.
    """
    last = _last_digit(table.stack(POINT))
    rounded = last > CHANCE * noise
    told_apart = sorted(table.numbers) if rounded else [*AXES, *POINT, *(c for c in (*TURN, *QUATERNION) if c in table.numbers)]
    words = [table.labels(c)[0] for c in sorted(table.words) if rounded]
    rows = np.column_stack([np.nan_to_num(table.stack(told_apart)), *words])
    _, first, kind = np.unique(rows, axis=0, return_index=True, return_inverse=True)
    first = first[kind.ravel()]
    copies = np.flatnonzero(first != np.arange(len(table)))
    if not len(copies):
        return table
    if not rounded:
        _refuse_contradictions(table, first, copies)
    pairs = [f"line {table.line[k]} repeats line {table.line[first[k]]}" for k in copies]
    told = f"{pairs[0]} in axes and point to the last digit, as {len(copies)} of {len(table)} rows repeat another"
    unsure = rounded and "time_s" not in table.numbers
    anew = f" (the points have steps of {last:g} mm: if poses were measured anew, add the column time_s)" if unsure else ""
    if len(copies) > max(COPIES * len(table), 2):
        raise BadInput(f"{table.path}, {told}; remove the copies{anew}")
    more = f" ({', '.join(pairs[1:LISTED])}{', ..' if len(pairs) > LISTED else ''})" if len(pairs) > 1 else ""
    notices.append(f"{table.path.name}, {told}{more}: no reading comes out so twice, each is used once, the first{anew}")
    return table.take(np.flatnonzero(first == np.arange(len(table))))


def _refuse_contradictions(table: CsvTable, first: Index, copies: Index) -> None:
    """Raises BadInput where a copy tells another load, nest, payload, session or station than the row it repeats."""
    for column in (*WORDS, *LOAD, "load_link", *PLACE):
        values = np.array(table.words.get(column, table.numbers.get(column, np.zeros(len(table)))))
        for k in copies[values[copies] != values[first[copies]]][:1]:
            raise table.refuse(
                int(k),
                column,
                f"but line {table.line[first[k]]}, with the same axes and the same point to the last digit, has "
                f"{shown(str(values[first[k]]))}; remove the row that was not measured",
            )


def _last_digit(points: Array) -> float:
    """The step mm in which all coordinates are given: a power of ten, at least 10^-DECIMALS."""
    for decimals in range(DECIMALS):
        scaled = points * 10.0**decimals
        if (np.abs(scaled - np.round(scaled)) < 1e-9 * np.maximum(np.abs(scaled), 1.0)).all():
            return float(10.0**-decimals)
    return float(10.0**-DECIMALS)


def _all(table: CsvTable, columns: tuple[str, ...]) -> bool:
    return all(c in table.numbers for c in columns)


def _words(table: CsvTable, column: str, known: tuple[str, ...] | None = None, where: str = "") -> tuple[Index, tuple[str, ...]]:
    """Index of each row's word and the words; an absent column means the first known word."""
    if column not in table.words:
        return np.zeros(len(table), np.int64), known or ("",)
    if known is None:
        return table.labels(column)
    names, words = known, table.words[column]
    for row, word in enumerate(words):
        if word not in names:
            raise table.refuse(row, column, f"is not in the cell's [{where}] ({', '.join(names)}); add it there or correct it")
    return np.array([names.index(word) for word in words], np.int64), names


def _signs(table: CsvTable) -> Array | None:
    if not _all(table, APPROACH):
        return None
    signs = table.stack(APPROACH)
    bad = ~np.isin(signs, (-1.0, 0.0, 1.0))
    if bad.any():
        row, axis = np.argwhere(bad)[0]
        raise table.refuse(int(row), APPROACH[axis], "must be -1, 0 or 1, the sign of the axis' last motion")
    return signs


def _links(table: CsvTable) -> Index:
    known = np.arange(7.0)
    links = table.column("load_link", 1.0, lambda v: ~np.isin(v, known), "a link from 0 (base) to 6 (flange)")
    return np.full(len(table), 6) if links is None else links.astype(np.int64)
