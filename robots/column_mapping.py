"""A table made by others as one of ours: which column is which, in which unit, sign and zero (FORMATS, "Mapping").

    separator = ";"                 # default ","
    decimal = ","                   # default "."
    rotation = "xyz_intrinsic"      # of rx_deg, ry_deg, rz_deg, as in [tracker]

    [q1_deg]                        # a column of ours
    from = "shoulder_pan_joint"     # theirs; a list is summed; [] with an offset is a constant; default: the same name
    unit = "rad"                    # theirs; default: ours
    sign = -1                       # or a list, one for each of `from`
    offset = 90.0                   # added after that, in our unit

Some units are no factors: a time as a date of digits ("%Y%m%d%H%M%S", as strptime has it) is seconds since the first row, of
sealed conditions since that of the readings;
"step_deg" or "step_rad" of approach1 .. approach6 is the sign by which an angle changed since the row before, for campaigns that
say where they drove but not from where.
"""

import re
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from datetime import datetime
from pathlib import Path
from typing import Any

import numpy as np
from pydantic import Field, ValidationError, field_validator

from robots.bounds import COLUMNS
from robots.errors import LONGEST_SHOWN, BadInput, shown
from robots.pose import ROTATION_ORDERS, Array
from robots.toml_files import TomlTable, parse_toml

_LENGTH = {"mm": 1.0, "m": 1e3, "cm": 10.0, "um": 1e-3, "in": 25.4}
_ANGLE = {"deg": 1.0, "rad": 180.0 / np.pi, "mrad": 0.18 / np.pi, "arcmin": 1.0 / 60.0, "arcsec": 1.0 / 3600.0, "rev": 360.0}
_FORCE = {"N": 1.0, "kN": 1e3, "mN": 1e-3}
_SPEED, _TURNING = (
    {f"{u}/{t}": f / seconds for u, f in units.items() for t, seconds in (("s", 1.0), ("min", 60.0))}
    for units in (_LENGTH, _ANGLE)
)
_TIME = {"s": 1.0, "ms": 1e-3, "us": 1e-6, "min": 60.0, "h": 3600.0}
# Units of a column by the end of its name, longer ends first; what one of theirs is of ours.
UNITS: dict[str, dict[str, float]] = {
    "_deg_s": _TURNING | {"rpm": 6.0},
    "_mm_s": _SPEED,
    "_m_s": {u: 1e-3 * f for u, f in _SPEED.items()},
    "_Nm": {"Nm": 1.0, "kNm": 1e3, "Nmm": 1e-3},
    "_mm": _LENGTH,
    "_um": {u: 1e3 * f for u, f in _LENGTH.items()},
    "_deg": _ANGLE,
    "_N": _FORCE,
    "_s": _TIME,
    "_C": {"C": 1.0, "K": 1.0, "F": 5.0 / 9.0},
}
ZERO = {"K": -273.15, "F": -160.0 / 9.0}  # deg C at zero of the scale
APPROACH, MOVED = "approach", 0.01  # deg: less is no motion of an axis
STEPS = {"step_deg": 1.0, "step_rad": 180.0 / np.pi}
NAMES = ("target", "payload", "session", "station", "run")  # columns of words
OTHERS = (*NAMES, "contact", "load_link")  # columns without a unit
SEALED = "sealed "
SEPARATORS = (",", ";", "\t", "|", " ")


class MappedColumn(TomlTable):
    """Where a column of ours comes from: sum of sign times theirs in our unit, and offset."""

    source: tuple[str, ...] | None = Field(default=None, alias="from")
    unit: str | None = None
    sign: tuple[float, ...] = (1.0,)
    offset: float = Field(default=0.0, ge=-1e9, le=1e9)

    @property
    def signs(self) -> tuple[float, ...]:
        """One for each of their columns."""
        return self.sign if self.source is None or len(self.sign) > 1 else self.sign * len(self.source)

    def sources_of(self, name: str) -> tuple[str, ...]:
        """Their columns of which our column `name` is made: itself where none is named."""
        return (name,) if self.source is None else self.source

    def sign_of(self, name: str) -> dict[str, float]:
        """Sign of each of them."""
        return dict(zip(self.sources_of(name), self.signs, strict=True))

    @field_validator("source", "sign", mode="before")
    @classmethod
    def _listed(cls, value: Any) -> Any:
        return (value,) if isinstance(value, str | int | float) and not isinstance(value, bool) else value

    @field_validator("sign")
    @classmethod
    def _signs(cls, value: tuple[float, ...]) -> tuple[float, ...]:
        if not value or any(abs(v) != 1.0 for v in value):
            raise ValueError("sign must be 1 or -1, or a list of these, one for each of from")
        return value


class _MappingTables(TomlTable):
    """The keys that are no column."""

    separator: str = ","
    decimal: str = "."
    rotation: str | None = None


@dataclass(frozen=True)
class ColumnMapping:
    """A mapping file: separator, decimal sign, order of rotations (None: the cell's), tables by our column."""

    path: Path | None = None
    separator: str = ","
    decimal: str = "."
    rotation: str | None = None
    columns: dict[str, MappedColumn] = field(default_factory=dict)
    zeros: dict[str, float] = field(default_factory=dict)
    asked: set[str] = field(default_factory=set)  # columns of ours that a table which was read may have, of all such tables
    made: set[str] = field(default_factory=set)  # those of its tables that made something in one of them

    def of_file(self, path: Path, header: Sequence[str]) -> "ColumnMapping":
        """What of it is for a file with this header: a table whose columns the file lacks makes nothing, and what the file has
        under our name is taken as ours. Raises BadInput: part of a table's columns is there."""
        made = {}
        for name, column in self.columns.items():
            sources = self.sources_of(name)
            lacking = [s for s in sources if s not in header]
            if lacking and len(lacking) < len(sources):
                raise BadInput(
                    f"{path}: column {shown(', '.join(lacking))} is missing, which {self.path} makes {name} of; correct one of "
                    "them"
                )
            if not lacking:
                made[name] = column
        self.made.update(made, (name for name in self.columns if name in header))
        return replace(self, columns=made)

    def refuse_idle(self) -> None:
        """Raises BadInput, when all tables were read: one of a column that they may have made nothing in any. A misspelt name
        would leave out what is optional: a load would count as none, all payloads as the first."""
        for name in self.columns:
            if name in self.asked - self.made:
                lacking = shown(", ".join(self.sources_of(name)))
                raise BadInput(
                    f"{self.path}: {name} is made of {lacking}, which no table read here has; correct from, or take {name} out"
                )

    def header(self, header: Sequence[str]) -> list[str]:
        """Our names of what the file that it is for holds: its columns that no table uses, then those that tables make."""
        used = {s for name in self.columns for s in self.sources_of(name)}
        return [*(h for h in header if h not in used and h not in self.columns), *self.columns]

    def sources_of(self, name: str) -> tuple[str, ...]:
        """Their columns of which a column of ours is made; one that is in no table is its own."""
        return self.columns[name].sources_of(name) if name in self.columns else (name,)

    def values(self, name: str, theirs: Sequence[Array], n: int) -> Array:
        """A column (n,) of ours from theirs (n,) each."""
        column = self.columns[name]
        unit = column.unit or ""
        total: Array = sum((s * v for s, v in zip(column.signs, theirs, strict=True)), np.zeros(n))
        if unit in STEPS:
            step = STEPS[unit] * np.diff(total, prepend=total[:1])
            return np.where(np.abs(step) > MOVED, np.sign(step), 0.0)
        factors = _units_of(name)
        return np.asarray(total * factors.get(unit, 1.0) + ZERO.get(unit, 0.0) * bool(factors) + column.offset)

    def zero(self, kind: str, first: float) -> float:
        """What dates of a kind of table count from, s: its first one, of "sealed KIND" that of KIND read before, so that readings
        and sealed conditions have one clock."""
        if kind.startswith(SEALED):
            return self.zeros.get(kind.removeprefix(SEALED), first)
        self.zeros[kind] = first
        return first

    def seconds(self, name: str) -> str:
        """The form of a column of dates; empty where it is none."""
        unit = self.columns[name].unit or "" if name in self.columns else ""
        return unit if "%" in unit else ""


def seconds_of(text: str, form: str) -> float:
    """Seconds of a date in the form of strptime. Raises ValueError."""
    return (datetime.strptime(text, form) - datetime(1970, 1, 1)).total_seconds()


def read_column_mapping(path: str | Path) -> ColumnMapping:
    """Read a mapping file.

    Raises BadInput: as `parse_toml`; an unknown key, separator or unit; signs that are none or not one for each source.
    """
    path = Path(path)
    _, data = parse_toml(path, "mapping")
    plain = {key: value for key, value in data.items() if not isinstance(value, dict)}
    tables = {key: value for key, value in data.items() if isinstance(value, dict)}
    head = _checked(path, "", _MappingTables, plain)
    if head.separator not in SEPARATORS:
        raise BadInput(f"{path}: separator = '{shown(head.separator)}' is none of , ; tab | and blank; correct it")
    if head.decimal not in (".", ",") or head.decimal == head.separator:
        raise BadInput(f"{path}: decimal = '{shown(head.decimal)}' must be a point or a comma, another sign than separator")
    if head.rotation is not None and head.rotation not in ROTATION_ORDERS:
        raise BadInput(f"{path}: rotation = '{shown(head.rotation)}' is none of {', '.join(ROTATION_ORDERS)}")
    columns = {name: _checked(path, name, MappedColumn, table) for name, table in tables.items()}
    for name, column in columns.items():
        _check_column(path, name, column)
    _check_steps(path, columns)
    return ColumnMapping(path, head.separator, head.decimal, head.rotation, columns)


def _checked(path: Path, name: str, schema: Any, table: dict[str, Any]) -> Any:
    try:
        return schema.model_validate(table)
    except ValidationError as error:
        fault = error.errors()[0]
        key = ".".join(str(k) for k in (name, *fault["loc"]) if k != "")
        known = ", ".join(f.alias or k for k, f in schema.model_fields.items())
        what = f"is no key of a mapping; known here: {known}" if fault["type"] == "extra_forbidden" else fault["msg"]
        raise BadInput(f"{path}: {shown(key, 80)} = {shown(repr(fault.get('input')))}: {what}; correct it") from None


def _check_column(path: Path, name: str, column: MappedColumn) -> None:
    """Raises BadInput: unit, signs or offset that this column cannot have."""
    if not (_units_of(name) or name in OTHERS or name in COLUMNS or name.startswith(APPROACH)):
        raise BadInput(
            f"{path}: [{shown(name)}] is no column of tracker.csv, force.csv or joints.csv; docs/formats.md lists them"
        )
    sources = 1 if column.source is None else len(column.source)
    if len(column.sign) not in (1, sources):
        raise BadInput(f"{path}: {name}.sign has {len(column.sign)} signs for {sources} columns; give one, or one for each")
    units = [*_units_of(name)] + ["%Y%m%d%H%M%S"] * (name == "time_s") + [*STEPS] * name.startswith(APPROACH)
    dated = column.unit is not None and _is_date_form(column.unit) and name == "time_s" and sources == 1
    if column.unit is not None and column.unit not in units and not dated:
        known = f"give one of {', '.join(units)}" if units else "it has none; leave the key out"
        raise BadInput(f"{path}: {name}.unit = '{shown(column.unit)}' is no unit of {name}; {known}")
    if (dated or name in NAMES) and (column.offset or column.sign != (1.0,)):
        kind = "dates" if dated else "words"
        raise BadInput(f"{path}: {name} is of {kind}, which have no sign and no offset; leave these keys out")


def _check_steps(path: Path, columns: dict[str, MappedColumn]) -> None:
    """Raises BadInput: the steps of an axis are taken from the columns of its angle, in another unit or sense of turn."""
    for k in range(1, 7):
        step, angle = columns.get(f"{APPROACH}{k}"), columns.get(f"q{k}_deg")
        if step is None or angle is None or step.unit not in STEPS:
            continue
        moved, turned = step.sign_of(f"{APPROACH}{k}"), angle.sign_of(f"q{k}_deg")
        if not moved or moved.keys() != turned.keys():
            continue
        unit = angle.unit or "deg"
        if (f"step_{unit}" in STEPS and step.unit != f"step_{unit}") or moved != turned:
            raise BadInput(
                f"{path}: {APPROACH}{k} is of the columns of q{k}_deg, but not in its unit ({unit}) and sign "
                f"({', '.join(f'{sign:g}' for sign in angle.sign)}); a motion has those of its axis: correct {APPROACH}{k}"
            )


def _is_date_form(form: str) -> bool:
    """Whether a form of dates reads what it writes."""
    try:
        seconds_of(datetime(2021, 5, 3, 12, 10, 7).strftime(form), form)
    except (ValueError, re.error):  # strptime makes a pattern of it; a letter twice is a group twice
        return False
    return "%" in form and len(form) <= LONGEST_SHOWN


def _units_of(name: str) -> dict[str, float]:
    """Units of a column of ours; {} where it has none."""
    return next((units for end, units in UNITS.items() if name.endswith(end)), {})
