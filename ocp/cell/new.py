"""The text of a new cell file: the template with numbers that suit the robot and the blade, the wheel where most of the blade can
be reached; and where it may stand, its axis and direction kept."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from ocp.model.cell import Cell, read_cell
from ocp.plan.clearance import flange_pose
from ocp.plan.passes.posture import contact_poses, keeps_ranges, posture_grid
from ocp.plan.paths import PlanOptions, lay_paths
from robots.inverse import ArmFamily, arm_family, inverse_branches, planned_family
from robots.pose import Array, abc_from_rotation
from robots.robot import Robot
from trajectories.blade import AerofoilShape, Blade
from trajectories.passes import BladePath

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
    postures = "in postures that `grindplan poses --cell cell.toml` chooses"
    if family is None:
        postures = "in some sixty postures, all axes over their ranges"
    texts = {
        "postures": postures,
        "title": robot.title,
        "name": name,
        "model": model,
        "load": f"{load:.1f}",
        "load_z": load_z,
        "weight": weight,
    }
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


PROBED = 16  # contacts of the blade that every place is tried with
ACROSS, UP = 25, 21  # places of the wheel along its direction and along the vertical
SPAN = 0.5  # of the arm's length, to either side of where the wheel stands
EVERY_ARC, EVERY_TURN = 2, 4  # of the planner's grid of places on the arc and of turns


@dataclass(frozen=True)
class WheelRegion:
    """Places (n, 3) m of the wheel's centre in the base frame, in a plane that holds its direction and the vertical, and the
    share (n,) of the blade's contacts that the arm reaches there within its ranges, collisions aside; across (n,) and up (n,) m:
    the places in that plane, from the base."""

    centre: Array
    share: Array
    across: Array
    up: Array


def arm_length(family: ArmFamily) -> float:
    """From axis 1 to the wrist, stretched, m."""
    return abs(family.a1) + family.a2 + family.l3


def wheel_region(cell: Cell, paths: list[BladePath], length: float) -> WheelRegion:
    """The share of probed contacts that can be reached with the wheel in each place of a grid about its own, up to SPAN of the
    arm's `length`. Raises BadInput: the arm has no closed inverse."""
    flange = _flanges(cell, paths)
    away = -cell.wheel.contact_direction
    away = away - cell.up * (away @ cell.up)
    sideways = np.linalg.norm(away) > 1e-6
    away = away / np.linalg.norm(away) if sideways else np.cross(cell.wheel.axis, cell.up)
    x, z = np.meshgrid(np.linspace(-SPAN, SPAN, ACROSS) * length, np.linspace(-SPAN, SPAN, UP) * length, indexing="ij")
    shift = x.ravel()[:, None] * away + z.ravel()[:, None] * cell.up
    share = np.array([reached_share(cell, flange, d) for d in shift])
    centre = cell.wheel.centre + shift
    return WheelRegion(centre, share, centre @ away, centre @ cell.up)


def nearest_whole(region: WheelRegion, wanted: Array) -> Array:
    """Of the places from which most is reached, the one farthest inside of them, of several the nearest to `wanted` (3,)."""
    most = region.share > region.share.max() - 1e-9
    inside = np.array([np.linalg.norm(region.centre[~most] - c, axis=1).min() if (~most).any() else 0.0 for c in region.centre])
    room = min(0.1 * float(np.ptp(region.across)), float(inside[most].max()))
    good = np.flatnonzero(most & (inside >= room - 1e-9))
    return np.asarray(region.centre[good[np.argmin(np.linalg.norm(region.centre[good] - wanted, axis=1))]])


def _flanges(cell: Cell, paths: list[BladePath]) -> Array:
    """Flange poses (probes, options, 4, 4) that lay contacts spread over all paths on the wheel."""
    arcs, turns = posture_grid(cell)
    arc, turn = (grid.ravel() for grid in np.meshgrid(arcs[::EVERY_ARC], turns[::EVERY_TURN], indexing="ij"))
    contacts = [(path, k) for path in paths for k in range(len(path.s))]
    found = []
    for i in np.linspace(0, len(contacts) - 1, PROBED).round().astype(int):
        path, k = contacts[i]
        ways = [contact_poses(cell, path, np.array([k]), arc, turn, direction, cell.process.sigma) for direction in (1, -1)]
        found.append(np.concatenate(ways)[:, 0])
    return flange_pose(cell, np.stack(found))


def reached_share(cell: Cell, flange: Array, shift: Array) -> float:
    """Share of probes, flange poses (probes, options, 4, 4), that some posture within the ranges reaches once all are moved."""
    T = flange.copy()
    T[..., :3, 3] += shift
    q, reachable = inverse_branches(cell.robot, T.reshape(-1, 4, 4))
    sound = reachable & keeps_ranges(cell, np.where(reachable[..., None], q, 0.0))
    return float(sound.reshape(len(flange), -1).any(axis=1).mean())
