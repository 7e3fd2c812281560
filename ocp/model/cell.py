"""The cell in SI units: robot, blade in its holder, wheel, force flange, process; and what a cell file says of a measurement."""

import os
import tomllib
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from ocp.effects.cell_effects import CellEffect
from ocp.model.calibrated_for import held_in
from ocp.model.cell_schema import (
    CellTables,
    ConditionsTable,
    FlangeTable,
    LinkTarget,
    PayloadTable,
    TrackerTable,
    WheelTable,
    WorkpieceTable,
)
from robots.calibration.store import Calibration, read_calibration
from robots.errors import BadInput
from robots.pose import Array, rotation_from_abc, transform_from_xyzabc
from robots.robot import Robot, load_robot
from robots.toml_files import TomlTable, read_toml
from robots.tracker_readings import Hanging, Instrument, Nest
from trajectories.blade import NamedAerofoil


@dataclass(frozen=True)
class Workpiece:
    """The blade in its holder: `T_flange_blade`, material (Pa, kg/m^3), clamp plane `normal . x < offset` held.

    `aerofoil`: where the cell says that it lies, None where its shape is to tell.
    """

    stl: Path | None
    stl_unit: str
    T_flange_blade: Array
    xyz_sd: float
    abc_sd: float
    youngs_modulus: float
    poisson: float
    density: float
    clamp_normal: Array
    clamp_offset: float
    clamp_stiffness: float
    payload: Hanging
    payload_name: str = ""
    aerofoil: NamedAerofoil | None = None


@dataclass(frozen=True)
class Wheel:
    """Belt grinding wheel in the base frame; lengths m, modulus Pa, angles rad, belt m/s.

    `axis` and `contact_direction` are unit and perpendicular; arc angles count right-handed about `axis`
    from `contact_direction`. Standard deviations: `centre_sd` m, `axis_sd` rad.
    """

    centre: Array
    axis: Array
    contact_direction: Array
    radius: float
    width: float
    cover_thickness: float
    cover_modulus: float
    cover_poisson: float
    arc: tuple[float, float]
    belt_speed: float
    friction: float
    centre_sd: float
    axis_sd: float

    @property
    def travel(self) -> float:
        """Sign of the belt's speed, +1 where it stands."""
        return float(np.sign(self.belt_speed)) or 1.0

    def cylindrical(self, points: Array) -> tuple[Array, Array, Array]:
        """Of points (n, 3) m in the base frame: lateral (n,), outward radial (n, 3) and its length (n,), m."""
        v = points - self.centre
        lateral = v @ self.axis
        radial = v - lateral[:, None] * self.axis
        return lateral, radial, np.linalg.norm(radial, axis=1)

    def outward(self, arc: Array | float) -> Array:
        """Unit radial (..., 3) in the base frame at arc angles (...) rad."""
        side = np.cross(self.axis, self.contact_direction)
        return np.asarray(np.cos(arc)[..., None] * self.contact_direction + np.sin(arc)[..., None] * side)


@dataclass(frozen=True)
class ForceFlange:
    """Force-setting flange: `F (n.a) = setpoint + stiffness * stroke`; N, N/m, m; axis None = along the contact normal.

    What it does in time: bandwidth Hz of the force that it sets (None: at once), delay s of it, friction N against its stroke.
    setpoint_output: analogue output that sets its force, setpoint_scale of it per newton; None: none.
    """

    setpoint: float
    stiffness: float
    stroke: float
    carried_mass: float
    gravity_compensated: bool
    axis: Array | None
    bandwidth: float | None = None
    delay: float = 0.0
    friction: float = 0.0
    setpoint_output: str | None = None
    setpoint_scale: float | None = None

    @property
    def moves_in_time(self) -> bool:
        """Whether the cell says anything of the flange's own motion; else it is taken to be in balance at every instant."""
        return self.bandwidth is not None or self.delay > 0 or self.friction > 0


@dataclass(frozen=True)
class Process:
    """What is wanted: force N, feed m/s, spacing m, freedoms (rad, m), margins m, removal m (None: what force and feed make).

    What belt and metal make of it: Preston's coefficient 1/Pa (depth per pressure and sliding way) with its one sigma, None where
    it is not known."""

    force: float
    feed: float
    pass_spacing: float
    passes: str
    side: str
    tilt_tolerance: float
    turn_tolerance: float
    lateral_tolerance: float
    grinding: str
    root_margin: float
    tip_margin: float
    edge_margin: float
    edge_force: float = 5.0
    removal: float | None = None
    preston: float | None = None
    preston_sd: float | None = None

    @property
    def sigma(self) -> int:
        """+1 where the blade moves with the belt ("down"), -1 against it ("up"); docs/architecture.md."""
        return 1 if self.grinding == "down" else -1


@dataclass(frozen=True)
class Controller:
    """Numbers of tool and base, whether the controller corrects Cartesian targets itself, and the language of its programs, by
    its name in trajectories.dialects."""

    tool_no: int
    base_no: int
    absolute_accuracy: bool
    dialect: str = "krl"


@dataclass(frozen=True)
class RunConditions:
    """What effects depend on while a plan runs: warm and wheel_warm K above the cell's reference, time s of the robot's
    campaign, clock s that the wheel has run, how often every line was ground before."""

    warm: float = 0.0
    wheel_warm: float = 0.0
    time: float = 0.0
    clock: float = 0.0
    ground_before: int = 0


@dataclass(frozen=True)
class Cell:
    """Everything that is believed about the cell; `tables` are the file's own values, for readers of other parts.
    compliant_joints bend under weight: those that bent in the calibration's fit, else those that the file lists."""

    name: str
    path: Path
    robot: Robot
    calibration: Calibration | None
    compliant_joints: tuple[int, ...]
    workpiece: Workpiece
    wheel: Wheel
    flange: ForceFlange | None
    process: Process
    controller: Controller
    tables: CellTables
    effects: tuple[CellEffect, ...] = ()
    conditions: RunConditions = RunConditions()

    @property
    def up(self) -> Array:
        """Against gravity, unit (3,) in the base frame."""
        return -self.robot.gravity_direction

    @property
    def floor(self) -> float | None:
        """Height m of the floor above the base's origin along `up`; None where the cell gives none."""
        return None if self.tables.floor is None else 1e-3 * self.tables.floor.z_mm

    def flange_shares(self, n: Array) -> Array:
        """Shares (k,) of a force along normals n (k, 3) of the blade that the flange's axis takes; one where it has none."""
        if self.flange is None or self.flange.axis is None:
            return np.ones(len(n))
        return np.asarray(np.abs(n @ self.workpiece.T_flange_blade[:3, :3].T @ self.flange.axis))


def read_cell(path: str | Path, blade: str | Path | None = None) -> Cell:
    """Read cell.toml; `blade` replaces `[workpiece].stl`.

    Raises BadInput: as `read_toml`, and where tables needed for grinding are absent, the robot is unknown, or
    the calibration belongs to another robot, or the wheel reaches below the floor.
    """
    path = Path(path)
    tables = read_toml(path, CellTables)
    if tables.workpiece is None or tables.wheel is None:
        missing = "workpiece" if tables.workpiece is None else "wheel"
        raise BadInput(f"{path}: table [{missing}] is missing; only the arm's own calibration and diagnosis do without it")
    robot = _robot(path, tables)
    calibration = _calibration(path, tables, robot)
    cell = Cell(
        name=tables.name,
        path=path,
        robot=robot,
        calibration=calibration,
        compliant_joints=_bending(calibration, tables.robot.compliant_joints),
        workpiece=_workpiece(tables, tables.workpiece, path, Path(blade) if blade is not None else None),
        wheel=_wheel(tables.wheel),
        flange=_flange(tables.force_flange),
        process=Process(**_si(tables.process)),
        controller=Controller(**tables.controller.model_dump()),
        tables=tables,
        effects=tables.believed,
        conditions=_conditions(tables.conditions, tables.reference_temperature_C),
    )
    _refuse_sunken_wheel(cell)
    return cell


def _refuse_sunken_wheel(cell: Cell) -> None:
    """The lowest point of the wheel's rim stands on or above the floor."""
    if cell.floor is None:
        return
    wheel, lean = cell.wheel, abs(float(cell.wheel.axis @ cell.up))
    lowest = float(wheel.centre @ cell.up) - wheel.radius * np.sqrt(max(1.0 - lean**2, 0.0)) - 0.5 * wheel.width * lean
    if lowest < cell.floor:
        raise BadInput(
            f"{cell.path}: the wheel reaches {1e3 * (cell.floor - lowest):.0f} mm below the floor; correct wheel.centre_mm, "
            f"floor.z_mm = {1e3 * cell.floor:g} (height above the base's origin) or robot.gravity_direction"
        )


def _calibration(path: Path, tables: CellTables, robot: Robot) -> Calibration | None:
    """The calibration that a cell file names, as far as it holds there. Raises BadInput: as `read_calibration` and `held_in`, and
    where it is another robot's."""
    if tables.robot.calibration is None:
        return None
    calibration = read_calibration(path.parent / tables.robot.calibration)
    if calibration.robot != robot.name:
        raise BadInput(
            f"{path}: calibration '{tables.robot.calibration}' belongs to robot '{calibration.robot}', the cell has "
            f"'{robot.name}'; calibrate this robot or correct robot.model"
        )
    return held_in(calibration, tables, robot, path)


def _bending(calibration: Calibration | None, listed: tuple[int, ...]) -> tuple[int, ...]:
    """Joints that bend under weight: those of the calibration's fit, which holds with them only, else those listed."""
    told = None if calibration is None else calibration.bending_joints
    return listed if told is None else told


def with_calibration(cell: Cell, calibration: Calibration | None) -> Cell:
    """The cell with another calibration, or none, and those joints bending that bent in its fit."""
    return replace(cell, calibration=calibration, compliant_joints=_bending(calibration, cell.compliant_joints))


def held_by_friction(cell: Cell) -> float:
    """N that the flange's friction holds, its own and a believed effect's: so far off may the contact's force be to either side,
    by which way the stroke last went. 0 without a flange."""
    if cell.flange is None:
        return 0.0
    return cell.flange.friction + sum(abs(float(e.a[0])) for e in cell.effects if e.name == "flange_friction")


def history_notices(cell: Cell, where: str) -> list[str]:
    """Sentence on effects that a cell believes and that depend on what a recording did before; `where`: where they are not."""
    names = sorted({e.name for e in cell.effects if e.active.effect.along is not None})
    return [f"what a recording did before decides of {', '.join(names)} in {cell.path.name}: {where}"] if names else []


def load_notices(cell: Cell) -> list[str]:
    """Sentences on what hangs on the flange where nobody named it, or where it is lighter than a part of it."""
    load, name = cell.workpiece.payload, cell.workpiece.payload_name
    found, file = [], cell.path.name
    if cell.tables.workpiece is None or cell.tables.workpiece.payload is None:
        told = f"'{name}', the first of [payloads], is" if name else "nothing is"
        weight = f"{load.mass:g} kg in the programs' $LOAD"
        found.append(f"{file} names no workpiece.payload: {told} taken to hang on the flange, {weight}")
    carried = 0.0 if cell.flange is None else cell.flange.carried_mass
    if carried > load.mass:
        found.append(
            f"{file}: the force flange alone carries {carried:g} kg, all that hangs on the robot is given {load.mass:g} kg; "
            "correct workpiece.payload or force_flange.carried_mass_kg before anything moves"
        )
    return found


def floor_notices(cell: Cell) -> list[str]:
    """A sentence where no floor could be checked."""
    if cell.floor is not None:
        return []
    return [
        f"{cell.path.name} gives no [floor], so no floor was checked, only the plane that the robot's base stands on; give "
        "floor.z_mm, the height of the floor above the base's origin"
    ]


def _robot(path: Path, tables: CellTables) -> Robot:
    """The robot that a cell file names, mounted as it says, with the stiffness it gives.

    Raises BadInput as `load_robot`, with file and key.
    """
    model = tables.robot.model
    try:
        robot = load_robot(path.parent / model if model.lower().endswith(".toml") else model)
    except BadInput as error:
        raise BadInput(f"{path}, robot.model: {error}") from None
    down = np.array(tables.robot.gravity_direction)
    robot = replace(robot, gravity_direction=down / np.linalg.norm(down))
    given = tables.robot.stiffness_Nm_per_rad
    if given is None:
        return robot
    return replace(robot, stiffness=np.array(given), left_out=tuple(key for key in robot.left_out if key != "stiffness"))


def _conditions(table: ConditionsTable, reference: float) -> RunConditions:
    warm, wheel = (0.0 if t is None else t - reference for t in (table.temperature_C, table.wheel_temperature_C))
    return RunConditions(warm, wheel, table.time_s, table.clock_s, table.ground_before)


def wheel_frame(cell: Cell) -> Array:
    """T_base_wheel (4, 4): origin where the wheel touches at arc zero, x along the belt, y along the axis."""
    wheel = cell.wheel
    T = np.eye(4)
    x = np.cross(wheel.axis, wheel.contact_direction)
    T[:3, :3] = np.stack([x, wheel.axis, wheel.contact_direction], axis=1)
    T[:3, 3] = wheel.centre + wheel.radius * wheel.contact_direction
    return T


# What the unit at the end of a key is in SI; longer ones before those that they end with.
_SI = {
    "_um_mm2_per_N_m": 1e-12,
    "_N_per_mm": 1e3,
    "_mm_s": 1e-3,
    "_m_s": 1.0,
    "_mm": 1e-3,
    "_um": 1e-6,
    "_deg": np.pi / 180,
    "_N": 1.0,
}
_SI |= {"_ms": 1e-3, "_hz": 1.0, "_GPa": 1e9, "_MPa": 1e6, "_kg_m3": 1.0, "_kg": 1.0}


def _si(table: TomlTable) -> dict[str, Any]:
    """Values of a table in SI with the unit taken off the names; lists of numbers with a unit are arrays."""
    found = {}
    for key, value in table.model_dump().items():
        unit = next((unit for unit in _SI if key.endswith(unit)), "")
        if unit and value is not None:
            value = (np.array(value) if isinstance(value, tuple) else value) * _SI[unit]
        found[key.removesuffix(unit)] = value
    return found


def _workpiece(tables: CellTables, table: WorkpieceTable, path: Path, blade: Path | None) -> Workpiece:
    if blade is None and table.stl is not None:
        blade = path.parent / table.stl
    if table.clamp_normal is not None and table.clamp_offset_mm is not None:
        length = float(np.linalg.norm(table.clamp_normal))
        normal, offset = np.array(table.clamp_normal) / length, table.clamp_offset_mm / length
    else:
        normal, offset = np.eye(3)["xyz".index(table.clamp_axis or "z")], float(table.clamp_to_mm or 0.0)
    if table.clamp_side == "above":
        normal, offset = -normal, -offset
    name = tables.hanging
    payload = tables.payloads[name] if name is not None else None
    si = _si(table)
    return Workpiece(
        **{key: si[key] for key in ("stl_unit", "xyz_sd", "youngs_modulus", "density", "clamp_stiffness")},
        stl=blade,
        T_flange_blade=transform_from_xyzabc(si["xyz"], si["abc"]),
        abc_sd=float(si["abc_sd"]),
        poisson=table.poisson_ratio,
        clamp_normal=normal,
        clamp_offset=offset * 1e-3,
        payload=_payload(payload),
        payload_name=name or "",
        aerofoil=_named_aerofoil(table),
    )


def _named_aerofoil(table: WorkpieceTable) -> NamedAerofoil | None:
    if table.aerofoil_axis is None:
        return None
    axis = np.array(table.aerofoil_axis) / np.linalg.norm(table.aerofoil_axis)
    low, high = table.aerofoil_from_mm, table.aerofoil_to_mm
    return NamedAerofoil(axis, -np.inf if low is None else 1e-3 * low, np.inf if high is None else 1e-3 * high)


def payloads_of(tables: CellTables) -> dict[str, Hanging]:
    """What may hang on the flange, by name."""
    return {name: _payload(table) for name, table in tables.payloads.items()}


def _payload(table: PayloadTable | None) -> Hanging:
    return Hanging() if table is None else Hanging(table.mass_kg, np.array(table.com_mm) * 1e-3, np.array(table.inertia_kg_m2))


def _wheel(table: WheelTable) -> Wheel:
    si = _si(table)
    arc = si.pop("contact_arc")
    si.pop("shore_A")
    axis = np.array(table.axis) / np.linalg.norm(table.axis)
    direction = np.array(table.contact_direction)
    direction = direction - axis * (axis @ direction)
    direction /= np.linalg.norm(direction)
    si |= {"axis": axis, "contact_direction": direction, "cover_modulus": 1e6 * table.modulus_MPa}
    return Wheel(**si, arc=(float(arc[0]), float(arc[1])))


def _flange(table: FlangeTable | None) -> ForceFlange | None:
    if table is None:
        return None
    axis = None if table.axis is None else np.array(table.axis) / np.linalg.norm(table.axis)
    return ForceFlange(**_si(table) | {"axis": axis})


def cell_tables_for(source: Path, out: Path, blade: Path | None = None) -> dict[str, Any]:
    """Tables of the cell file `source` for a cell file in the folder `out`.

    Paths of robot, calibration and blade (or of `blade` in its place) are rewritten to be found from `out`.
    """
    tables = tomllib.loads(source.read_text(encoding="utf-8-sig"))
    robot = tables["robot"]
    for key in ("model", "calibration"):
        if key in robot and (source.parent / str(robot[key])).is_file():
            robot[key] = found_from(out, source.parent / str(robot[key]))
    if "workpiece" in tables:
        named = tables["workpiece"].get("stl")
        file = blade if blade is not None else source.parent / named if named is not None else None
        if file is not None:
            tables["workpiece"]["stl"] = found_from(out, file)
    return tables


def found_from(out: Path, file: Path) -> str:
    """A file's path as seen from the folder `out`."""
    try:
        return Path(os.path.relpath(file.resolve(), out.resolve())).as_posix()
    except ValueError:  # on another drive
        return file.resolve().as_posix()


@dataclass(frozen=True)
class TrackerSetup:
    """Robot as believed, payloads by name, instrument, joints believed to bend, and the file's own tables; the calibration that
    was made before, None where there is none."""

    path: Path
    robot: Robot
    payloads: dict[str, Hanging]
    instrument: Instrument
    compliant_joints: tuple[int, ...]
    tables: CellTables
    calibration: Calibration | None = None

    @property
    def hanging(self) -> Hanging:
        """What hangs on the flange while grinding and where nobody says otherwise."""
        return self.payloads.get(self.tables.hanging or "", Hanging())


def read_tracker_setup(path: str | Path) -> TrackerSetup:
    """Read cell.toml for a measurement; wheel and workpiece may be absent. Raises BadInput as `read_toml`, `load_robot`,
    `read_calibration`."""
    path = Path(path)
    tables = read_toml(path, CellTables)
    robot = _robot(path, tables)
    payloads, instrument, listed = payloads_of(tables), _instrument(tables.tracker), tables.robot.compliant_joints
    return TrackerSetup(path, robot, payloads, instrument, listed, tables, _calibration(path, tables, robot))


def named_files(path: Path, tables: CellTables) -> dict[str, Path]:
    """The cell file and the files it names that are there, by their part: cell, robot, calibration, covariance, blade."""
    calibration = tables.robot.calibration
    covariance = str(Path(calibration).with_suffix(".npz")) if calibration is not None and Path(calibration).name else None
    named = {"robot": tables.robot.model, "calibration": calibration, "covariance": covariance}
    named |= {"blade": tables.workpiece.stl if tables.workpiece else None}
    there = {part: path.parent / name for part, name in named.items() if name is not None}
    return {"cell": path} | {part: file for part, file in there.items() if file.is_file()}


def files_of(path: str | Path) -> list[Path]:
    """The cell file and the files it names that are there: robot, calibration and its covariance, blade."""
    return list(named_files(Path(path), read_toml(Path(path), CellTables)).values())


def _instrument(table: TrackerTable | None) -> Instrument:
    if table is None:
        return Instrument()
    nests = {}
    for name, target in table.targets.items():
        entry = target if isinstance(target, LinkTarget) else LinkTarget(xyz_mm=target)
        turn = None if entry.abc_deg is None else rotation_from_abc(np.radians(entry.abc_deg))
        nests[name] = Nest(entry.link, 1e-3 * np.array(entry.xyz_mm), turn)
    return Instrument(
        1e-6 * table.range_noise_um,
        1e-6 * table.transverse_noise_um_per_m,
        1e-3 * table.target_sd_mm,
        nests or None,
        table.rotation,
    )
