"""What a file may hold: its size, and the least and most of every number by its unit, each with the reason.

A number outside is a slip (a unit, a lost decimal point) or an attack; inside, no later step overflows or asks for more memory
than there is. Keys of TOML files take the types below, columns of CSV files the table COLUMNS.
"""

import stat
from collections.abc import Callable
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from pydantic import AfterValidator, Field

from robots.errors import BadInput, shown

MEGABYTE = 1_000_000
AMONG = 30.0  # deg beyond the others' range


def read_whole(path: Path, most: int, what: str) -> bytes:
    """The bytes of a file of at most `most` bytes; what: the kind of file that the path should have led to.

    Raises BadInput: absent, unreadable, no regular file (a device never ends), larger than `most`.
    """
    try:
        status = path.stat()
        if stat.S_ISREG(status.st_mode) and status.st_size > most:
            raise BadInput(f"{path}: has {status.st_size / MEGABYTE:.1f} MB, the limit is {most / MEGABYTE:g} MB; give {what}")
        if not stat.S_ISREG(status.st_mode) and not stat.S_ISDIR(status.st_mode):
            raise BadInput(f"{path}: is a device or a pipe; give the path of {what}")
        return path.read_bytes()
    except (OSError, ValueError) as error:  # ValueError: a NUL in the name
        reason = getattr(error, "strerror", None) or error
        raise BadInput(f"{shown(path, 300)}: cannot be read ({reason}); give the path of {what}") from None


def refuse_outside(*limits: tuple[str, float | None, float, float, str]) -> None:
    """Raises BadInput: an option lies outside its least and most; each with its unit, None where it was not given."""
    for option, value, low, high, unit in limits:
        if value is not None and not low - 1e-12 * abs(low) <= value <= high + 1e-12 * abs(high):
            raise BadInput(f"{option} {value:.10g} must lie between {low:.10g} and {high:.10g} {unit}".rstrip())


def are_radians(angles: Any, others: Any) -> bool:
    """Whether angles (n, k) deg of axes make one turn of radians at most, and as such lie among `others` (m, k) deg of the same
    axes, which turn far: no arm works with all axes folded to zero, but a column of radians looks so."""
    if not (len(angles) and len(others)):
        return False
    far, meant = np.abs(others).max(), np.degrees(angles)
    among = (meant > others.min(axis=0) - AMONG) & (meant < others.max(axis=0) + AMONG)
    return bool(np.abs(angles).max() <= 2.0 * np.pi and far > np.degrees(1.0) and among.all())


def _between(least: float, most: float) -> Any:
    return Field(ge=least, le=most, allow_inf_nan=False, strict=True)


def _zero_or_from(least: float) -> Callable[[float], float]:
    """A check: what is neither zero nor at least this is so small that dividing by it means nothing."""

    def check(value: float) -> float:
        if 0.0 < value < least:
            raise ValueError(f"{value:g} must be 0 or at least {least:g}")
        return value

    return check


# What has no narrower type: far beyond every physical quantity in its file's unit, small enough to be squared and cubed.
Number = Annotated[float, _between(-1e12, 1e12)]

Place = Annotated[float, _between(-1e5, 1e5)]  # mm: 100 m; no cell is larger and no laser tracker measures farther
Offset = Annotated[float, _between(-1e4, 1e4)]  # mm: 10 m; nothing held by an arm reaches farther
Size = Annotated[float, _between(0.01, 1e4)]  # mm: from a foil to 10 m
Margin = Annotated[float, _between(0.0, 1e4)]  # mm: at most what is on an arm
Spread = Annotated[float, _between(0.0, 1e3), AfterValidator(_zero_or_from(1e-6))]  # mm: one sigma, 1e-6 is an atom's size
Angle = Annotated[float, _between(-3600.0, 3600.0)]  # deg: ten turns; no axis of an arm counts more
Turn = Annotated[float, _between(0.0, 180.0)]  # deg
AngleSpread = Annotated[float, _between(0.0, 90.0), AfterValidator(_zero_or_from(1e-7))]  # deg: 1e-7 is a nanometre at 0.5 m
Share = Annotated[float, _between(-1e6, 1e6)]  # of a direction of any length
Mass = Annotated[float, _between(0.0, 1e5), AfterValidator(_zero_or_from(1e-6))]  # kg: a hundred tonnes; the largest links
Moment = Annotated[float, _between(-1e6, 1e6)]  # kg m^2
MomentOfInertia = Annotated[Moment, Field(ge=0)]
Spring = Annotated[float, _between(0.0, 1e11), AfterValidator(_zero_or_from(1.0))]  # N m/rad: 1 is a wrist of rubber, 0 rigid
Temperature = Annotated[float, _between(-100.0, 1000.0)]  # C: nothing here grinds beyond
Seconds = Annotated[float, _between(0.0, 1e10)]  # s: 300 years, so that clocks of computers are in
Micrometres = Annotated[float, _between(0.0, 1e6), AfterValidator(_zero_or_from(1e-4))]  # um: below 1e-4 no instrument sees
Force = Annotated[float, _between(0.0, 1e5), AfterValidator(_zero_or_from(1e-4))]  # N: ten tonnes
PlaceVector = tuple[Place, Place, Place]
OffsetVector = tuple[Offset, Offset, Offset]
AngleVector = tuple[Angle, Angle, Angle]
Direction = tuple[Share, Share, Share]


def _file_name(name: str) -> str:
    """A name that a file system takes: no part above 255 bytes (NAME_MAX), 1000 characters in all."""
    if len(name) > 1000 or any(len(part.encode()) > 255 for part in name.split("/")):
        raise ValueError(f"{shown(name)} is longer than a file's name may be")
    return name


def _printable(text: str) -> str:
    """What reports and the terminal show as it stands."""
    if not text.isprintable():
        raise ValueError(f"'{shown(text)}' holds a character that cannot be printed; take it out")
    return text


LONGEST_LABEL = 200  # characters of a name that reports print
FileName = Annotated[str, Field(min_length=1), AfterValidator(_printable), AfterValidator(_file_name)]
Label = Annotated[str, Field(max_length=LONGEST_LABEL), AfterValidator(_printable)]

MOST_CSV_BYTES = 64 * MEGABYTE  # a day of a force log at 25 Hz has 40 MB
MOST_CSV_VALUES = 8_000_000  # rows times columns; as text they take 500 MB
MOST_CSV_LINE = 20_000  # characters: 60 columns have 1500

# Least and most of a column's numbers by its name, else by the longest ending that fits, with the reason.
COLUMNS: dict[str, tuple[float, float, str]] = {
    "depth_um": (0.0, 2000.0, "from nothing to what a belt mills rather than grinds"),
    "sigma_um": (1e-4, 1e6, "one sigma between an atom's size and a metre"),
    "sigma_rot_deg": (1e-7, 90.0, "one sigma of an angle"),
    "sigma_fn_N": (1e-6, 1e5, "one sigma of a force"),
    "sigma_ft_N": (1e-6, 1e5, "one sigma of a force"),
    **dict.fromkeys(("nx", "ny", "nz", "tx", "ty", "tz", "qw", "qx", "qy", "qz"), (-1e3, 1e3, "a part of a unit vector")),
    **dict.fromkeys(("line", "ground_before"), (-1e6, 1e6, "a count")),
    "feed_mm_s": (-1e5, 1e5, "100 m/s is faster than any arm"),
    "force_N": (-1e5, 1e5, "ten tonnes"),
    "setpoint_N": (-1e5, 1e5, "ten tonnes"),
    "temperature_C": (-100.0, 200.0, "no arm is hotter while it works; kelvin lie above"),
    "wheel_temperature_C": (-100.0, 250.0, "no cover holds more; kelvin lie above"),
    "_mm": (-1e5, 1e5, "100 m, farther than a tracker measures"),
    "_um": (-1e8, 1e8, "100 m"),
    "_deg": (-3600.0, 3600.0, "ten turns of an axis"),
    "_deg_s": (-1e5, 1e5, "no axis is faster"),
    "_deg_s2": (-1e7, 1e7, "no axis is faster"),
    "_N": (-1e7, 1e7, "a thousand tonnes"),
    "_Nm": (-1e7, 1e7, "more than any gear holds"),
    "_m_s": (-300.0, 300.0, "no belt is faster: what a cell may say; metres per minute lie above"),
    "_s": (-1e10, 1e10, "300 years"),
    "": (-1e9, 1e9, "no column holds more"),
}


def column_bounds(column: str) -> tuple[float, float, str]:
    """Least, most and the reason for the numbers of a column."""
    fitting = [name for name in COLUMNS if column == name or (name[:1] in ("", "_") and column.endswith(name))]
    return COLUMNS[column if column in COLUMNS else max(fitting, key=len)]
