"""A calibration on disk: `calibration.toml` for people, covariance in `calibration.npz` beside it."""

import hashlib
import io
import zipfile
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from robots.bounds import MEGABYTE, read_whole
from robots.calibration.parameters import SYMBOLS
from robots.errors import BadInput, shown
from robots.pose import Array
from robots.toml_files import parse_toml, toml_text

SCHEMA = 1
BENDING = "bending_joints"  # of the provenance
_TABLES = ("parameters", "not_identified", "provenance")
LARGEST = 1e12  # of a value or its standard deviation in SI: the stiffest spring has 1e9 N/m
LEAST_SD = 1e-25  # a compliance of 1e-12 rad/(N m)^3 is known to six digits or so
SAME = 1e-6  # relative, of a number that stands in both files
MOST_ARCHIVE = 20 * MEGABYTE  # a covariance of all parameters has 1 MB
_LIST = "robots/calibration/parameters.py"  # of the names that exist
# Most negative eigenvalue of the correlation matrix that rounding explains.
_EIGENVALUE_FLOOR = -1e-8


@dataclass(frozen=True, eq=False)
class Calibration:
    """Estimates of named parameters (SI, radians) with their covariance.

    values (m,), covariance (m, m) in the order of `names` (robots/calibration/parameters.py).
    `not_identified` maps one parameter name, or several separated by spaces (one direction that cannot be
    told apart), to the reason. `provenance` holds residual figures, data hashes, conditions: scalars,
    strings, lists or tables of them. `notices` are sentences for the user about what could not be read in
    full.
    """

    robot: str
    names: tuple[str, ...]
    values: Array
    covariance: Array
    provenance: dict[str, Any] = field(default_factory=dict)
    not_identified: dict[str, str] = field(default_factory=dict)
    notices: tuple[str, ...] = ()

    @property
    def units(self) -> tuple[str, ...]:
        """Unit of each value."""
        return tuple(SYMBOLS[name].unit for name in self.names)

    @property
    def standard_deviation(self) -> Array:
        """One sigma of each value (m,)."""
        return np.sqrt(np.maximum(np.diag(self.covariance), 0.0))

    @property
    def bending_joints(self) -> tuple[int, ...] | None:
        """Joints 1..6 that bent under weight in the fit: its geometry holds with these springs only. None: it does not say."""
        told = self.provenance.get(BENDING)
        return None if told is None else tuple(told)

    @property
    def joint_noise(self) -> float | None:
        """One sigma rad of what moves a joint without being a parameter, as the fit found it. None: it does not say."""
        noise = self.provenance.get("noise")
        told = noise.get("joints_rad") if isinstance(noise, dict) else None
        return float(told) if isinstance(told, int | float) and np.isfinite(told) and told > 0 else None

    @property
    def held_out_error(self) -> float | None:
        """Mean error m of readings that were left out of the fit at random. None: it does not say."""
        told: Any = self.provenance
        for key in ("held_out", "random", "mean_mm"):
            told = told.get(key) if isinstance(told, dict) else None
        return 1e-3 * told if isinstance(told, int | float) and np.isfinite(told) and told > 0 else None


def write_calibration(path: str | Path, calibration: Calibration) -> None:
    """Write `path` (.toml) and the covariance beside it (.npz, no pickled objects).

    Raises BadInput: names unknown or repeated, shapes that do not fit, numbers not finite, covariance not
    symmetric positive semidefinite, a path that does not end in .toml.
    """
    path = Path(path)
    if path.suffix != ".toml":
        raise BadInput(f"{path}: a calibration file must end in .toml; rename it")
    _check(str(path), calibration.robot, calibration.names, calibration.values, calibration.covariance)
    _check_reasons(str(path), calibration.not_identified)
    archive = path.with_suffix(".npz")
    names = np.array(calibration.names, dtype=np.str_)
    values, covariance = (np.asarray(part, float) for part in (calibration.values, calibration.covariance))
    np.savez(archive, names=names, values=values, covariance=covariance)
    parameters = {}
    rows = zip(calibration.names, calibration.values, calibration.standard_deviation, strict=True)
    for name, value, sd in rows:
        unit, meaning = SYMBOLS[name].unit, SYMBOLS[name].meaning
        parameters[name] = {"value": float(value), "sd": float(sd), "unit": unit, "meaning": meaning}
    document = {
        "schema": SCHEMA,
        "robot": calibration.robot,
        "covariance_file": archive.name,
        "covariance_sha256": hashlib.sha256(archive.read_bytes()).hexdigest(),
        "parameters": parameters,
        "not_identified": calibration.not_identified,
        "provenance": calibration.provenance,
    }
    path.write_text(toml_text(document), encoding="utf-8")


def read_calibration(path: str | Path) -> Calibration:
    """Read a calibration; where its .npz is missing the covariance is diagonal and a notice says so.

    Raises BadInput: file unreadable or malformed, unknown parameter, wrong unit, number not finite, the .npz
    is not the one that was written with the .toml, covariance not positive semidefinite, its values or standard deviations
    at odds with the .toml's.
    """
    path = Path(path)
    data = _read_toml(path)
    names, values, sd = _parameters(path, data)
    covariance, notices = _covariance(path, data, names, values, sd)
    _check(str(path), data["robot"], names, values, covariance)
    not_identified = _table(path, data, "not_identified")
    _check_reasons(str(path), not_identified)
    provenance = _table(path, data, "provenance")
    _check_bending(path, provenance.get(BENDING))
    return Calibration(
        robot=data["robot"],
        names=names,
        values=values,
        covariance=covariance,
        provenance=provenance,
        not_identified=not_identified,
        notices=notices,
    )


def _read_toml(path: Path) -> dict[str, Any]:
    _, data = parse_toml(path, "calibration")
    if data.get("schema", SCHEMA) != SCHEMA:
        raise BadInput(f"{path}: schema = {shown(repr(data['schema']))}, this version reads {SCHEMA}; calibrate again")
    if not isinstance(data.get("robot"), str):
        raise BadInput(f"{path}: key 'robot' must name the robot, got {shown(repr(data.get('robot')))}; add it")
    known = {"schema", "robot", "covariance_file", "covariance_sha256", *_TABLES}
    for key in data:
        if key not in known:
            raise BadInput(f"{path}: unknown key '{shown(key)}'; known are {', '.join(sorted(known))}")
    return data


def _table(path: Path, data: dict[str, Any], key: str) -> dict[str, Any]:
    table = data.get(key, {})
    if not isinstance(table, dict):
        raise BadInput(f"{path}: '{key}' must be a table, got {shown(repr(table))}; write it as [{key}]")
    return table


def _parameters(path: Path, data: dict[str, Any]) -> tuple[tuple[str, ...], Array, Array]:
    """Names, values (m,) and standard deviations (m,)."""
    table = _table(path, data, "parameters")
    if not table:
        raise BadInput(f"{path}: no [parameters.NAME] table; calibrate again")
    values, sd = [], []
    for name, entry in table.items():
        if name not in SYMBOLS:
            raise BadInput(f"{path}: unknown parameter '{shown(name)}'; {_LIST} lists the names")
        if not isinstance(entry, dict):
            raise BadInput(f"{path}: [parameters.{name}] = {shown(repr(entry))}, expected a table with value, sd, unit")
        unit = SYMBOLS[name].unit
        if entry.get("unit") != unit:
            found = entry.get("unit")
            raise BadInput(f"{path}: parameters.{name}.unit = {shown(repr(found))}, expected '{unit}'; convert the value")
        values.append(_number(path, name, entry, "value", -LARGEST))
        sd.append(_number(path, name, entry, "sd", 0.0))
    return tuple(table), np.array(values), np.array(sd)


def _number(path: Path, name: str, entry: dict[str, Any], key: str, low: float) -> float:
    value: Any = entry.get(key)
    number = isinstance(value, int | float) and not isinstance(value, bool)
    if not number or not low <= value <= LARGEST or 0.0 < abs(value) < LEAST_SD <= low + LEAST_SD:
        what = f"a finite number from {low:g} to {LARGEST:g}" + ("" if low < 0 else f", zero or at least {LEAST_SD:g}")
        raise BadInput(f"{path}: parameters.{name}.{key} = {shown(repr(value))}, expected {what}; correct it")
    return float(value)


def _covariance(
    path: Path, data: dict[str, Any], names: tuple[str, ...], values: Array, sd: Array
) -> tuple[Array, tuple[str, ...]]:
    """Covariance (m, m) and notices."""
    file = data.get("covariance_file", path.with_suffix(".npz").name)
    if not isinstance(file, str) or Path(file).name != file:
        raise BadInput(f"{path}: covariance_file = {shown(repr(file))} must be a file name beside this file; correct it")
    archive = path.parent / file
    if len(file.encode()) > 255 or not file.isprintable():  # NAME_MAX
        raise BadInput(
            f"{path}: covariance_file = {shown(file)} is longer than a file's name may be, or not printable; correct it"
        )
    if not archive.is_file():
        notice = f"{archive} is missing: the parameters are taken as uncorrelated, predicted deviations are rough"
        return np.diag(sd**2), (notice,)
    wanted = data.get("covariance_sha256")
    content = read_whole(archive, MOST_ARCHIVE, "the archive written with the calibration")
    found = hashlib.sha256(content).hexdigest()
    if wanted is not None and wanted != found:
        raise BadInput(
            f"{archive}: sha256 {found[:12]}.. is not {shown(wanted, 14)} written in {path.name}; restore the pair of "
            "files of one calibration, or delete the .npz to go on with uncorrelated parameters"
        )
    try:
        with zipfile.ZipFile(io.BytesIO(content)) as packed:
            if (size := sum(entry.file_size for entry in packed.infolist())) > MOST_ARCHIVE:
                raise ValueError(f"{size} bytes unpacked")
        with np.load(io.BytesIO(content), allow_pickle=False) as arrays:
            stored, covariance = tuple(arrays["names"].tolist()), np.asarray(arrays["covariance"], float)
            about = np.asarray(arrays["values"], float) if "values" in arrays else None  # earlier versions wrote none
    except Exception as error:  # zip, header and pickle faults have no common class
        raise BadInput(f"{archive}: not a covariance archive ({shown(error, 80)}); calibrate again") from None
    count = len(stored)
    if set(stored) != set(names) or covariance.shape != (count, count) or (about is not None and about.shape != (count,)):
        odd = shown(", ".join(sorted(map(str, set(stored) ^ set(names)))), 80) or "shape"
        raise BadInput(f"{archive}: parameters do not match {path.name} ({odd}); restore the pair of files")
    order = [stored.index(name) for name in names]
    covariance = covariance[np.ix_(order, order)]
    numbers = {"sd": (sd, np.sqrt(np.maximum(np.diag(covariance), 0.0)))}
    if about is not None:
        numbers["value"] = values, about[order]
    for key, (here, there) in numbers.items():
        bad = np.abs(there - here) > SAME * np.maximum(np.abs(there), np.abs(here))
        if bad.any():
            i = int(np.argmax(bad))
            raise BadInput(
                f"{path}: parameters.{names[i]}.{key} = {here[i]:g}, {file} has {there[i]:g}; do not edit one alone: restore "
                "the file, or calibrate again"
            )
    return covariance, ()


def _check(where: str, robot: str, names: tuple[str, ...], values: Array, covariance: Array) -> None:
    """Everything a sound set of estimates satisfies."""
    unknown = [name for name in names if name not in SYMBOLS]
    if unknown or len(set(names)) != len(names):
        what = f"unknown parameter '{unknown[0]}'" if unknown else "a parameter is named twice"
        raise BadInput(f"{where}: {what}; {_LIST} lists the names")
    m = len(names)
    if np.shape(values) != (m,) or np.shape(covariance) != (m, m):
        raise BadInput(
            f"{where}: {m} names, values {np.shape(values)}, covariance {np.shape(covariance)}; give one value and one row each"
        )
    if not (np.isfinite(values).all() and np.isfinite(covariance).all() and np.abs(covariance).max(initial=0.0) <= LARGEST**2):
        raise BadInput(f"{where}: a value or covariance for robot '{shown(robot)}' is not finite; calibrate again")
    sd = np.sqrt(np.maximum(np.diag(covariance), 0.0))
    scale = np.where(sd > 0, sd, 1.0)
    correlation = covariance / np.outer(scale, scale)
    lowest = float(np.linalg.eigvalsh(0.5 * (correlation + correlation.T)).min())
    if np.abs(correlation - correlation.T).max() > 1e-8 or lowest < _EIGENVALUE_FLOOR:
        raise BadInput(
            f"{where}: the covariance is not symmetric positive semidefinite (lowest eigenvalue of the correlation "
            f"{lowest:.2g}, allowed {_EIGENVALUE_FLOOR:g}); calibrate again"
        )


def _check_reasons(where: str, not_identified: dict[str, Any]) -> None:
    for key, reason in not_identified.items():
        wrong = [name for name in key.split() if name not in SYMBOLS]
        if wrong or not key.split() or not isinstance(reason, str):
            raise BadInput(
                f"{where}: not_identified '{shown(key, 80)}' = {shown(repr(reason))}, expected parameter names and a reason"
            )


def _check_bending(path: Path, joints: object) -> None:
    if joints is not None and not (isinstance(joints, list) and all(type(j) is int and 1 <= j <= 6 for j in joints)):
        raise BadInput(
            f"{path}: [provenance] {BENDING} must be a list of joints 1 to 6, as [2, 3], got {shown(repr(joints))}; restore the "
            "file, or calibrate again"
        )
