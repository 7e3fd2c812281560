"""A data set folder: the cell and whatever was measured in it (FORMATS, "A data set folder")."""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from os.path import lexists
from pathlib import Path
from typing import Any

import numpy as np

from ocp.calibrate.force.log import ForceLog, read_force_log, refuse_few_rows, refuse_force_unit, saturation, without_ramps
from ocp.calibrate.tracker import as_in
from ocp.diagnose.joints.channel import HAVE as JOINT_COLUMNS
from ocp.diagnose.joints.channel import seen_by_encoder
from ocp.diagnose.joints.log import JointLog, read_joint_log
from ocp.diagnose.rules import FAR_SHARE, FAR_TURN, FAR_WARMTH, LEAST_READINGS
from ocp.effects.effect import Active
from ocp.effects.engine.readings import shown_in
from ocp.model.cell import Cell, TrackerSetup, files_of, read_cell, read_tracker_setup
from ocp.model.cell_schema import CellTables
from robots.bounds import are_radians
from robots.column_mapping import ColumnMapping, read_column_mapping
from robots.csv_table import OURS
from robots.errors import BadInput
from robots.pose import Array
from robots.robot import left_out_notices
from robots.tracker_readings import BLIND, POINT, Readings, read_readings

CELL, TRACKER, FORCE, JOINTS, BLADE = "cell.toml", "tracker.csv", "force.csv", "joints.csv", "blade.stl"
SEALED = {"tracker": "sealed_tracker.csv", "force": "sealed_force.csv", "joint": "sealed_joints.csv"}
MEASURED = (TRACKER, FORCE, JOINTS)
LOGGED = {"setpoint": "setpoint_N", "feed": "feed_mm_s", "belt": "belt_m_s", "clock": "clock_s"} | {
    "temperature": "temperature_C",
    "wheel_temperature": "wheel_temperature_C",
}
"""Columns of a force log's settings."""


@dataclass(frozen=True)
class DataSet:
    """What a folder holds; None where a signal was not measured.

    setup: the cell as far as tracker and joints need it; cell: with wheel and blade, where force was measured; inputs: files
    that were read; sealed: files of conditions to predict, by signal; notices, and what missing columns blind, in sentences;
    mapping: how the tables became ours.
    """

    folder: Path
    setup: TrackerSetup
    cell: Cell | None
    readings: Readings | None
    log: ForceLog | None
    joints: JointLog | None
    inputs: tuple[Path, ...]
    sealed: dict[str, Path]
    notices: tuple[str, ...]
    blind: tuple[str, ...]
    mapping: ColumnMapping = OURS

    @property
    def believed(self) -> tuple[Active, ...]:
        """Effects that the cell believes, in a force log but those that may have fallen out of step."""
        told = (one.active for one in self.setup.tables.believed)
        return tuple(one for one in told if self.log is None or not one.falls_out_of_step)

    def believed_by(self, signal: str) -> tuple[Active, ...]:
        """Believed effects that a signal's baseline has: it shows them, and its file says what they depend on."""
        if signal == "tracker":
            assert self.readings is not None
            return shown_in(self.believed, self.readings)
        return tuple(a for a in self.believed if seen_by_encoder(a.effect) and JOINT_COLUMNS.issuperset(a.effect.needs))


def read_data_set(folder: str | Path, columns: Path | None = None) -> DataSet:
    """Read and check a folder, its tables by the mapping file `columns` where one is given; sealed files are found, not opened.

    Raises BadInput: no such folder, no cell, no measurement, and every fault of a file, with its line and column.
    """
    folder = Path(folder)
    if not folder.is_dir():
        raise BadInput(f"{folder}: is no folder; give the one that holds {CELL} and {', '.join(MEASURED)}")
    if not (folder / CELL).is_file():
        raise BadInput(f"{folder}: holds no {CELL}; put the cell's file beside the measurements")
    found = [name for name in MEASURED if lexists(folder / name)]  # what is no file is refused by its reader
    if not found:
        raise BadInput(f"{folder}: holds none of {', '.join(MEASURED)}; nothing was measured, so nothing can be diagnosed")
    setup = read_tracker_setup(folder / CELL)
    mapping = OURS if columns is None else read_column_mapping(columns)
    readings = log = joints = cell = None
    if TRACKER in found:
        readings = read_readings(folder / TRACKER, setup.payloads, setup.instrument, mapping=mapping)
        _check_readings(readings)
    if FORCE in found:
        cell = _grinding_cell(folder, setup.tables)
        log = read_force_log(folder / FORCE, mapping=mapping)
        refuse_force_unit(log, cell)
        log = without_ramps(log, cell.flange is not None)
        refuse_few_rows(log)
        if (full := saturation(log)) is not None:
            log = replace(log, notices=(*log.notices, f"{FORCE}, line {full[0]}, column fn_N: {full[1]}"))
    if JOINTS in found:
        joints = read_joint_log(folder / JOINTS, mapping)
    mapping.refuse_idle()
    sealed = {signal: folder / name for signal, name in SEALED.items() if lexists(folder / name)}
    told = [] if setup.calibration is None else list(setup.calibration.notices)
    told += [n for part in (readings, log, joints) if part is not None for n in part.notices] + left_out_notices(setup.robot)
    blind = tuple(n for n in told if blinds(n))
    learnt = {path: path.name.removeprefix("sealed_") for path in sealed.values()}
    orphans = [f"{p.name} is not predicted: there is no {name} to learn from" for p, name in learnt.items() if name not in found]
    return DataSet(
        folder=folder,
        setup=setup,
        cell=cell,
        readings=readings,
        log=log,
        joints=joints,
        inputs=(*files_of(folder / CELL), *(folder / name for name in found), *([] if columns is None else [columns])),
        sealed={s: p for s, p in sealed.items() if learnt[p] in found},
        notices=tuple([n for n in told if n not in blind] + orphans + _believed(setup.tables, log is not None)),
        blind=(*blind, *_not_measured(found)),
        mapping=mapping,
    )


def read_sealed(data: DataSet, signal: str) -> Any:
    """Conditions of a signal's sealed file, in that signal's own form, a tracker's stations numbered as in tracker.csv. Raises
    BadInput as the readers."""
    path = data.sealed[signal]
    if signal == "force":
        return read_force_log(path, True, data.mapping)
    if signal == "joint":
        return read_joint_log(path, data.mapping, sealed=True)
    assert data.readings is not None
    return as_in(read_readings(path, data.setup.payloads, data.setup.instrument, True, data.mapping), data.readings)


def told_beyond(data: DataSet, signal: str, sealed: Any) -> tuple[str, ...]:
    """Sentences on sealed conditions of a signal: columns ignored or lacking, and what lies outside of what was measured."""
    found = [notice for notice in sealed.notices if signal == "tracker" or "were ignored" in notice]
    found += beyond_measured(data.readings, sealed) if signal == "tracker" and data.readings is not None else ()
    found += beyond_log(data.log, sealed) if signal == "force" and data.log is not None else ()
    return tuple(found)


def beyond_measured(measured: Readings, sealed: Readings) -> tuple[str, ...]:
    """Sentences on sealed conditions that lie outside what was measured."""
    file, n = sealed.path.name, len(sealed)
    found = []
    if np.isfinite(sealed.point).any():
        found.append(f"{file}: columns {', '.join(POINT)} were ignored; what is sealed is predicted")
    hung = {measured.payloads[k] for k in np.unique(measured.payload)}
    new = [sealed.payloads[k] for k in np.unique(sealed.payload) if sealed.payloads[k] not in hung]
    if new:
        rows = int(np.isin(sealed.payload, [sealed.payloads.index(name) for name in new]).sum())
        found.append(f"{file}: {rows} of {n} rows carry {', '.join(new)}, never measured: mass and centre are taken as stated")
    warmth = {"temperature_C": (measured.temperature, sealed.temperature, FAR_WARMTH)}
    return (*found, *_outside(file, measured.q, sealed.q, warmth))


def beyond_log(measured: ForceLog, sealed: ForceLog) -> tuple[str, ...]:
    """Sentences on columns that sealed conditions lack and the log has, and on conditions outside what was measured."""
    ranges, lacking = {}, []
    for name, column in LOGGED.items():
        seen, asked = getattr(measured, name), getattr(sealed, name)
        if seen is not None and asked is None and not (name == "setpoint" and measured.setpoint_sd is not None):
            lacking.append(column)
        if seen is None or asked is None:
            continue
        unit = 1e3 if column.endswith("_mm_s") else 1.0
        seen, asked = unit * seen[measured.contact], unit * asked[sealed.contact]
        most = FAR_WARMTH if column.endswith("_C") else max(float(np.ptp(seen)), FAR_SHARE * float(np.abs(seen).max()))
        ranges[column] = seen, asked, most
    file = sealed.path.name
    usual = f"{file}: without {', '.join(lacking)}, which the log has, the cell's usual is taken; its sigma knows nothing of that"
    return (*([usual] if lacking else []), *_outside(file, measured.q, sealed.q, ranges))


def _outside(file: str, q: Array, sealed: Array, ranges: Mapping[str, Any]) -> Iterator[str]:
    """Sentences on postures (n, 6) rad and columns of which some lie farther from the measured ones than the last number."""
    if are_radians(np.degrees(sealed), np.degrees(q)):
        yield f"{file}: all axes lie within {np.degrees(np.abs(sealed).max()):.2g} deg of zero, as if in radians; write degrees"
    every = {f"q{j + 1}_deg": (np.degrees(q[:, j]), np.degrees(sealed[:, j]), FAR_TURN) for j in range(6)} | {**ranges}
    for column, (seen, asked, most) in ((c, r) for c, r in every.items() if r[0] is not None and r[1] is not None):
        rows = int(np.sum((asked < seen.min() - most) | (asked > seen.max() + most))) if len(seen) and len(asked) else 0
        if rows:
            yield (
                f"{file}: {rows} of {len(asked)} rows have {column} outside of what was measured ({seen.min():.4g} to "
                f"{seen.max():.4g}): what is predicted there continues it"
            )


def _believed(tables: CellTables, logged: bool) -> list[str]:
    """What it means that a cell has effects; logged: there is a force log."""
    late = [logged and one.active.falls_out_of_step for one in tables.believed[: len(tables.effects)]]
    named = [f"{t.effect} of joint {t.joint}" if t.joint else t.effect for t in tables.effects]
    names = [name for name, anew in zip(named, late, strict=True) if not anew] + [
        f"a patch over {t.where}" for t in tables.patches
    ]
    told = [f"{CELL} believes {', '.join(names)}: in the baseline, and what is named of it comes on top"] if names else []
    anew = f"{CELL} believes belt_splice: sought anew in {FORCE}, as its knocks may have fallen out of step, and written as found"
    return [*told, anew] if any(late) else told


def _grinding_cell(folder: Path, tables: CellTables) -> Cell:
    """The cell with its wheel and blade; the folder's blade.stl where the cell names none that is there."""
    cell = read_cell(folder / CELL)
    if cell.workpiece.stl is None or not cell.workpiece.stl.is_file():
        blade = folder / BLADE
        if not blade.is_file():
            named = f"workpiece.stl '{tables.workpiece.stl}'" if tables.workpiece and tables.workpiece.stl else BLADE
            raise BadInput(f"{folder}: {named} is missing; {FORCE} needs the blade that was ground")
        cell = replace(cell, workpiece=replace(cell.workpiece, stl=blade))
    return cell


def _check_readings(readings: Readings) -> None:
    postures = len(np.unique(np.round(readings.q, 4), axis=0))
    if len(readings) < LEAST_READINGS:
        raise BadInput(
            f"{readings.path}: {len(readings)} readings are too few to diagnose an arm, at least {LEAST_READINGS} are needed "
            "(150 are good)"
        )
    if postures < LEAST_READINGS // 2:
        raise BadInput(f"{readings.path}: {postures} different postures; spread at least {LEAST_READINGS // 2} over the axes")


def blinds(notice: str) -> bool:
    """Whether a notice says what cannot be seen."""
    return notice in BLIND.values() or any(word in notice for word in ("no column", "no link side"))


def _not_measured(found: list[str]) -> list[str]:
    """What absent signals blind."""
    words = {
        TRACKER: f"no {TRACKER}: the arm's geometry, drift of the base and payload errors are not seen on their own",
        FORCE: f"no {FORCE}: wheel, blade, flange and sensor are not seen",
        JOINTS: f"no {JOINTS}: what lies between motor and link is seen only through the whole arm",
    }
    return [text for name, text in words.items() if name not in found]
