"""What a cell file says of a measurement: robot, payloads, the tracker and its reflector nests, in SI."""

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from ocp.model.cell import robot_of
from ocp.model.cell_schema import CellTables, LinkTarget, TrackerTable
from robots.pose import rotation_from_abc
from robots.robot import Robot
from robots.toml_files import read_toml
from robots.tracker_readings import Hanging, Instrument, Nest


@dataclass(frozen=True)
class TrackerSetup:
    """Robot as believed, payloads by name, instrument, joints believed to bend, and the file's own tables."""

    path: Path
    robot: Robot
    payloads: dict[str, Hanging]
    instrument: Instrument
    compliant_joints: tuple[int, ...]
    tables: CellTables


def read_tracker_setup(path: str | Path) -> TrackerSetup:
    """Read cell.toml for a measurement; wheel and workpiece may be absent. Raises BadInput as `read_toml`, `load_robot`."""
    path = Path(path)
    tables = read_toml(path, CellTables)
    robot = robot_of(path, tables)
    if tables.robot.stiffness_Nm_per_rad is not None:
        robot = replace(robot, stiffness=np.array(tables.robot.stiffness_Nm_per_rad))
    payloads = {name: Hanging(p.mass_kg, 1e-3 * np.array(p.com_mm)) for name, p in tables.payloads.items()}
    return TrackerSetup(path, robot, payloads, _instrument(tables.tracker), tables.robot.compliant_joints, tables)


def files_of(path: str | Path) -> list[Path]:
    """The cell file and the files it names that are there: blade, robot, calibration."""
    path = Path(path)
    tables = read_toml(path, CellTables)
    named = [tables.robot.model, tables.robot.calibration, tables.workpiece.stl if tables.workpiece else None]
    return [path, *(path.parent / name for name in named if name is not None and (path.parent / name).is_file())]


def _instrument(table: TrackerTable | None) -> Instrument:
    if table is None:
        return Instrument()
    nests = {}
    for name, target in table.targets.items():
        entry = target if isinstance(target, LinkTarget) else LinkTarget(xyz_mm=target)
        turn = None if entry.abc_deg is None else rotation_from_abc(np.radians(entry.abc_deg))
        nests[name] = Nest(entry.link, 1e-3 * np.array(entry.xyz_mm), turn)
    return Instrument(
        1e-6 * table.range_noise_um, 1e-6 * table.transverse_noise_um_per_m, 1e-3 * table.target_sd_mm, nests or None
    )
