"""The text of a new cell file: the template with numbers that suit the robot and the blade."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from ocp.cell.placing import arm_length, nearest_whole, wheel_region
from ocp.model.cell import read_cell
from ocp.plan.paths import PlanOptions, lay_paths
from robots.errors import BadInput
from robots.inverse import ArmFamily, arm_family
from robots.pose import Array, abc_from_rotation
from robots.robot import Robot
from trajectories.blade import AerofoilShape, Blade

_TEMPLATE, _GRINDING = (Path(__file__).parent / name for name in ("template.toml", "grinding.toml"))
STANDOFF = 0.2  # m from the flange to where the blade begins: room for a holder
WHEEL_AT = np.array([0.63, 0.0, 0.333])  # of the arm's length: where a KR 210 has its wheel at hand
LOAD, WEIGHT = 0.12, 0.43  # of the rated load: holder and blade, and what is hung on to make the joints give way
UNRATED = 200.0  # kg that an arm of 2.7 m is taken to carry where its file does not say
HELD_BLOCK, HELD_BLADE = 0.6, 0.08  # share of a root block that a clamp holds, of the whole length where there is no block
STEP = 3e-3  # m between waypoints that the wheel's place is looked for with


@dataclass(frozen=True)
class HeldAt:
    """A blade on the flange: xyz (3,) m and rotation (3, 3) of its frame, clamp plane normal . x < offset (m)."""

    xyz: Array
    R: Array
    clamp_normal: Array
    clamp_offset: float


def planned_family(robot: Robot) -> ArmFamily | None:
    """The closed inverse that planning needs, None where the arm has none."""
    try:
        return arm_family(robot)
    except BadInput:
        return None


def held_upright(blade: Blade, shape: AerofoilShape) -> HeldAt:
    """The blade with its root to the flange, STANDOFF away, its span along its z axis; by right angles alone where it can."""
    span = shape.frame.axis
    near = np.abs(span).argmax()
    if abs(span[near]) > np.cos(np.radians(20.0)):
        span = np.eye(3)[near] * np.sign(span[near])
    R = Rotation.align_vectors(np.eye(3)[2:], span[None])[0].as_matrix()
    R = np.where(np.abs(R) < 1e-12, 0.0, R)
    placed = blade.vertices @ R.T
    middle = 0.5 * (placed.min(axis=0) + placed.max(axis=0))
    xyz = np.round(np.array([-middle[0], -middle[1], STANDOFF - placed[:, 2].min()]), 3)
    along = blade.vertices @ span
    low, high = float(along.min()), float(along.max())
    block = float(shape.frame.c0 @ span) - low
    held = HELD_BLOCK * block if shape.frame.block[0] and block > 0 else HELD_BLADE * (high - low)
    return HeldAt(xyz, R, span, np.floor(1e3 * (low + held)) * 1e-3)


def new_cell_text(name: str, model: str, robot: Robot, held: HeldAt | None, stl: str, centre: Array | None = None) -> str:
    """The cell file; held None: without a blade and a wheel, for an arm that cannot be planned."""
    family = planned_family(robot)
    length = 2.7 if family is None else arm_length(family)
    rated = UNRATED * (length / 2.7) ** 2 if robot.payload is None else robot.payload.mass
    load = max(round(2 * LOAD * rated) / 2, 0.5)
    small = load < 15.0  # a small arm has a small wheel
    grinding = ""
    if held is not None:
        at = _wheel_at(length) if centre is None else centre
        grinding = (
            _filled(
                _GRINDING,
                stl=stl,
                xyz=_numbers(1e3 * held.xyz),
                abc=_numbers(np.degrees(abc_from_rotation(held.R))),
                clamp_normal=_numbers(held.clamp_normal, 4),
                clamp_offset=f"{1e3 * held.clamp_offset:.1f}",
                centre=_numbers(1e3 * at, 0),
                axis="[0, 1, 0]",
                direction="[-1, 0, 0]",
                radius="40.0",
                width="15.0",
                carried=f"{min(5.0, load):.1f}" if not small else f"{0.5 * load:.1f}",
            ).rstrip("\n")
            + "\n"
        )
    load_z = "160" if not small else "120"
    weight = f"{max(round(WEIGHT * rated), 1):.1f}"
    texts = {"title": robot.title, "name": name, "model": model, "load": f"{load:.1f}", "load_z": load_z, "weight": weight}
    return _filled(_TEMPLATE, **texts, grinding=grinding)


def _wheel_at(length: float) -> Array:
    return np.round(length * WHEEL_AT / 0.05) * 0.05


def placed_wheel(cell_file: Path, stl: Path) -> Array:
    """Where the wheel of a cell file may stand so that all of the blade is reached, near to where it is. Raises BadInput."""
    cell = read_cell(cell_file, stl)
    laid = lay_paths(cell, stl, PlanOptions(even=False, step=STEP))
    region = wheel_region(cell, laid.paths, arm_length(arm_family(cell.robot)))
    return np.round(nearest_whole(region, cell.wheel.centre), 3)


def _filled(file: Path, **texts: str) -> str:
    text = file.read_text(encoding="utf-8")
    for key, value in texts.items():
        text = text.replace("{" + key + "}", value)
    return text


def _numbers(values: Array, digits: int = 3) -> str:
    return "[" + ", ".join(f"{v + 0.0:.{digits}f}".rstrip("0").rstrip(".") if digits else f"{v + 0.0:.0f}" for v in values) + "]"
