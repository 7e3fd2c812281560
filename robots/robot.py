"""The nominal robot: geometry, limits, masses, collision shapes, from the catalogue or from a .toml file.

First the keys of that file as users write them (millimetres, degrees, kilograms) with their bounds, then the robot in SI.
"""

import itertools
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Literal

import numpy as np
from pydantic import Field, model_validator

from robots.bounds import Angle, Label, Margin, Mass, Moment, MomentOfInertia, Place, PlaceVector, Size, Spring
from robots.errors import BadInput, shown
from robots.pose import Array
from robots.toml_files import SchemaVersion, TomlTable, read_toml

# Of an axis: deg/s, deg/s^2, N m, motor turns a turn; from a creeping giant to a pick-and-place arm, with room.
Rate = Annotated[float, Field(ge=1e-2, le=1e7, allow_inf_nan=False, strict=True)]
SixAngles = tuple[Angle, Angle, Angle, Angle, Angle, Angle]
SixPlaces = tuple[Place, Place, Place, Place, Place, Place]
SixRates = tuple[Rate, Rate, Rate, Rate, Rate, Rate]
SixSprings = tuple[Spring, Spring, Spring, Spring, Spring, Spring]
Sign = Literal[-1, 1]
MOST_SHAPES = 100  # capsules of an arm: every one is checked against every other at every point of a plan


class GeometryTable(TomlTable):
    """`[geometry]`: A_i = Rz(theta_i) Tz(d_i) Tx(a_i) Rx(alpha_i) Ry(beta_i), theta_i = sign_i q_i + offset_i."""

    source: str
    """Where the numbers are from."""
    sign: tuple[Sign, Sign, Sign, Sign, Sign, Sign]
    """-1 where the controller counts against the right hand about z."""
    theta_deg: SixAngles
    """Offsets of the axes."""
    d_mm: SixPlaces
    """Along z of the frame before."""
    a_mm: SixPlaces
    """Along x."""
    alpha_deg: SixAngles
    """Twist about x."""
    beta_deg: SixAngles = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
    """Twist about y, of nearly parallel axes."""


class LimitsTable(TomlTable):
    """`[limits]`, in the controller's axis signs; accelerations and torques may be left out."""

    source: str
    """Where the numbers are from."""
    q_min_deg: SixAngles
    """Least angle of each axis."""
    q_max_deg: SixAngles
    """Largest angle."""
    speed_deg_s: SixRates
    """Largest speed."""
    acceleration_deg_s2: SixRates | None = None
    """Largest acceleration."""
    torque_Nm: SixRates | None = None
    """Largest torque, link side of the gear."""

    @model_validator(mode="after")
    def _ordered(self) -> "LimitsTable":
        for i, (low, high) in enumerate(zip(self.q_min_deg, self.q_max_deg, strict=True)):
            if low >= high:
                raise ValueError(
                    f"q_min_deg[{i}] = {low:g} must be below q_max_deg[{i}] = {high:g}; exchange or correct the limits "
                    f"of axis {i + 1}"
                )
        return self


class GearsTable(TomlTable):
    """`[gears]`, optional: motor turns per turn of the axis."""

    source: str
    """Where the numbers are from."""
    ratio: SixRates = Field(examples=[[256.857, 269.176, 251.333, 188.855, 190.133, 131.277]])
    """Motor turns per turn of the axis."""


class StiffnessTable(TomlTable):
    """`[stiffness]`: joint stiffness about the axis, 0 = rigid."""

    source: str
    """Where the numbers are from."""
    joint_Nm_per_rad: SixSprings
    """About each axis, 0 = rigid."""


class LinkTable(TomlTable):
    """A link in its MD-H frame (the one after its joint; the base in the base frame)."""

    mass_kg: Mass
    """Its mass."""
    com_mm: PlaceVector
    """Its centre of mass."""
    # xx, yy, zz, xy, xz, yz about the centre of mass
    inertia_kg_m2: tuple[Moment, Moment, Moment, Moment, Moment, Moment] | None = None
    """xx, yy, zz, xy, xz, yz about that centre."""

    @model_validator(mode="after")
    def _physical(self) -> "LinkTable":
        if self.inertia_kg_m2 is None:
            return self
        xx, yy, zz, xy, xz, yz = self.inertia_kg_m2
        minors = (xx * yy - xy**2, xx * zz - xz**2, yy * zz - yz**2)
        determinant = xx * (yy * zz - yz**2) - xy * (xy * zz - yz * xz) + xz * (xy * yz - yy * xz)
        floor = -1e-9 * max(1.0, abs(xx), abs(yy), abs(zz)) ** 3
        if min(xx, yy, zz) < 0 or min(minors) < floor or determinant < floor:
            raise ValueError(
                f"inertia_kg_m2 = {list(self.inertia_kg_m2)} [xx, yy, zz, xy, xz, yz] is not positive semidefinite"
                "; correct the tensor about the centre of mass"
            )
        return self


class LinksTable(TomlTable):
    """`[links]`: base and links 1 to 6."""

    source: str
    """Where the numbers are from."""
    base: LinkTable
    """The base, in the base frame."""
    link1: LinkTable
    """Link after joint 1."""
    link2: LinkTable
    """Link after joint 2."""
    link3: LinkTable
    """Link after joint 3."""
    link4: LinkTable
    """Link after joint 4."""
    link5: LinkTable
    """Link after joint 5."""
    link6: LinkTable
    """Link after joint 6."""


class CapsuleTable(TomlTable):
    """`[[shape]]`: a capsule of a link for collision checks, in the link's MD-H frame; 0 is the base."""

    link: Annotated[int, Field(ge=0, le=6)]
    """Link that it moves with, 0 the base."""
    from_mm: PlaceVector
    """Its ends, in the link's frame."""
    to_mm: PlaceVector
    """Its ends, in the link's frame."""
    radius_mm: Size
    """Its radius."""


class RatedPayloadTable(TomlTable):
    """`[payload]`, optional: what the maker lets hang on the flange, its centre in the flange frame; the load diagram says for a
    payload's centre at a distance from the flange's centre which mass is allowed."""

    source: str
    """Where the numbers are from."""
    rated_kg: Annotated[Mass, Field(gt=0)]
    """Mass allowed."""
    com_mm_at_rated: PlaceVector | None = Field(default=None, examples=[[270, 0, 240]])
    """Its centre there, flange frame."""
    inertia_kg_m2: tuple[MomentOfInertia, MomentOfInertia, MomentOfInertia] | None = Field(
        None, examples=[[60, 60, 60]]
    )  # about that centre
    """Inertia allowed about that centre."""
    diagram: Annotated[tuple[tuple[Margin, Mass], ...], Field(min_length=2, max_length=1000)] | None = Field(
        None, examples=[[[0, 210], [500, 120]]]
    )
    """[mm from the flange's centre to the payload's, kg allowed there], distances growing."""

    @model_validator(mode="after")
    def _falling(self) -> "RatedPayloadTable":
        points = self.diagram or ()
        for (near, more), (far, less) in itertools.pairwise(points):
            if far <= near or less > more:
                raise ValueError(
                    f"diagram: [{far:g}, {less:g}] follows [{near:g}, {more:g}]; distances must grow and masses never, correct it"
                )
        if self.inertia_kg_m2 is not None and self.com_mm_at_rated is None:
            raise ValueError("inertia_kg_m2 says nothing without com_mm_at_rated; give both or neither")
        return self


class RobotTables(TomlTable):
    """The whole file."""

    version: SchemaVersion = 1
    """Version of the format."""
    name: Annotated[str, Field(pattern=r"^[A-Za-z0-9_.-]{1,100}$")]
    """Name in cells and calibrations."""
    title: Label
    """Name in reports."""
    geometry: GeometryTable
    """MD-H chain: A_i = Rz(theta_i) Tz(d_i) Tx(a_i) Rx(alpha_i) Ry(beta_i), theta_i = sign_i q_i + theta_deg_i."""
    limits: LimitsTable
    """Of each axis, controller's signs; without the last two nothing is planned or rehearsed."""
    gears: GearsTable | None = None
    """Gear ratios."""
    stiffness: StiffnessTable | None = None
    """Springs of the joints."""
    links: LinksTable | None = None
    """Masses; without all of them, inertia too, nothing is planned or rehearsed."""
    payload: RatedPayloadTable | None = None
    """What the maker lets hang on the flange."""
    shape: Annotated[tuple[CapsuleTable, ...], Field(max_length=MOST_SHAPES)] = ()
    """Capsules round the links for collision checks; without them nothing is planned or rehearsed."""


def read_robot_tables(path: Path) -> RobotTables:
    """Read and check a robot file.

    Raises BadInput, one sentence with file, key, value and remedy: missing or unreadable file, TOML syntax,
    unknown or missing key, wrong type or length, a number that is not finite or out of bounds, limits in the
    wrong order.
    """
    return read_toml(path, RobotTables, "robot")


# What a robot file for geometry alone may leave out, and what is then not offered.
LEAVES = {
    "limits.acceleration_deg_s2": "nothing that moves in time is planned or rehearsed",
    "limits.torque_Nm": "no torque is checked, so nothing is planned or rehearsed",
    "links": "what the arm's own weight bends is not seen, and nothing is planned or rehearsed",
    "links.inertia_kg_m2": "torques of motion are not known, so nothing is planned or rehearsed",
    "stiffness": "the joints are taken as rigid until readings say otherwise",
    "shape": "no collision of the arm is seen, so no program is written or rehearsed",
}
MOVES = ("limits.acceleration_deg_s2", "limits.torque_Nm", "links", "links.inertia_kg_m2", "shape")
CATALOGUE = Path(__file__).parent / "catalogue"

# Link index 0..6, end points (3,) m in the link's frame, radius m.
Capsule = tuple[int, Array, Array, float]


@dataclass(frozen=True, eq=False)
class RatedPayload:
    """What the maker lets hang on the flange: mass kg; its centre (3,) m in the flange frame and its inertia (3,) kg m^2 about
    it, None where unknown. diagram (k, 2): distance m of a payload's centre from the flange's, kg allowed there, or None."""

    mass: float
    com: Array | None
    inertia: Array | None
    diagram: Array | None


@dataclass(frozen=True, eq=False)
class Robot:
    """A serial arm with six revolute axes, SI units and radians; axes q in the controller's (KUKA's) signs.

    MD-H in the distal Hayati form (PHYSICS 2.2): A_i = Rz(theta_i) Tz(d_i) Tx(a_i) Rx(alpha_i) Ry(beta_i)
    with theta_i = sign_i q_i + mdh[i, 0]. "Link frame i" is the frame after A_i; link frame 0 is the base, 6
    the flange. Two robots are never compared or hashed by value (arrays); functions that cache use the
    arrays' bytes.
    """

    name: str
    title: str
    mdh: Array  # (6, 5) theta offset rad, d m, a m, alpha rad, beta rad
    sign: Array  # (6,)
    q_min: Array  # (6,) rad
    q_max: Array  # (6,) rad
    qd_max: Array  # (6,) rad/s
    qdd_max: Array  # (6,) rad/s^2, inf where unknown
    torque_max: Array  # (6,) N m at the link side of the gear, inf where unknown
    gear_ratio: Array  # (6,) motor turns per turn of the axis, nan where unknown
    link_mass: Array  # (7,) kg: base, links 1..6
    link_com: Array  # (7, 3) m in the link frames
    link_inertia: Array  # (7, 3, 3) kg m^2 about the centre of mass, axes of the link frame
    stiffness: Array  # (6,) N m/rad, 0 = rigid
    link_shapes: tuple[Capsule, ...]
    sources: str
    payload: RatedPayload | None = None  # None: unknown
    left_out: tuple[str, ...] = ()  # keys of LEAVES that the file does not give
    # (3,) unit, base frame; an upright base unless the cell says how it is mounted
    gravity_direction: Array = field(default_factory=lambda: _fixed(np.array([0.0, 0.0, -1.0])))


def catalogue() -> list[str]:
    """Names that `load_robot` knows."""
    return sorted(path.stem for path in CATALOGUE.glob("*.toml"))


def load_robot(name_or_path: str | Path) -> Robot:
    """The robot of a catalogue name, or of a path that ends in .toml.

    Raises BadInput: the name is not in the catalogue, or the file is not a sound robot file.
    """
    text = str(name_or_path)
    if text.lower().endswith(".toml"):
        return _robot(read_robot_tables(Path(name_or_path)))
    if text not in catalogue():
        raise BadInput(
            f"robot '{shown(text)}' is not in the catalogue ({', '.join(catalogue())}); choose one of these or give the path "
            "of a robot .toml file"
        )
    return _robot(read_robot_tables(CATALOGUE / f"{text}.toml"))


def left_out_notices(robot: Robot) -> list[str]:
    """What the robot file leaves out and what is not offered for it."""
    return [f"robot '{robot.name}' gives no {key}: {LEAVES[key]}" for key in robot.left_out]


def refuse_left_out(cell_file: Path, robot: Robot, what: str, needed: Sequence[str] = MOVES) -> None:
    """Raises BadInput where the robot file that a cell names leaves out what a motion needs; what: who needs it."""
    missing = [key for key in robot.left_out if key in needed]
    if missing:
        raise BadInput(
            f"{cell_file}, robot.model: the file of robot '{robot.name}' leaves out {', '.join(missing)}, and {what} needs "
            f"{'them' if len(missing) > 1 else 'it'}; add {'them' if len(missing) > 1 else 'it'} there"
        )


def _robot(tables: RobotTables) -> Robot:
    geometry, limits = tables.geometry, tables.limits
    links = [] if tables.links is None else [getattr(tables.links, name) for name in LinksTable.model_fields if name != "source"]
    unknown, none = np.full(6, np.inf), np.zeros((7, 3))
    accelerations, torques = limits.acceleration_deg_s2, limits.torque_Nm
    given = (
        accelerations,
        torques,
        tables.links,
        all(link.inertia_kg_m2 for link in links) or None,
        tables.stiffness,
        tables.shape or None,
    )
    rows = [
        np.radians(geometry.theta_deg),
        np.array(geometry.d_mm) * 1e-3,
        np.array(geometry.a_mm) * 1e-3,
        np.radians(geometry.alpha_deg),
        np.radians(geometry.beta_deg),
    ]
    blocks = [(name, getattr(tables, name)) for name in ("geometry", "limits", "gears", "stiffness", "links", "payload")]
    sources = [f"{name}: {block.source}" for name, block in blocks if block is not None]
    return Robot(
        name=tables.name,
        title=tables.title,
        mdh=_fixed(np.stack(rows, axis=1)),
        sign=_fixed(np.array(geometry.sign, float)),
        q_min=_fixed(np.radians(limits.q_min_deg)),
        q_max=_fixed(np.radians(limits.q_max_deg)),
        qd_max=_fixed(np.radians(limits.speed_deg_s)),
        qdd_max=_fixed(unknown if accelerations is None else np.radians(accelerations)),
        torque_max=_fixed(unknown if torques is None else np.array(torques)),
        gear_ratio=_fixed(np.array(tables.gears.ratio) if tables.gears is not None else np.full(6, np.nan)),
        link_mass=_fixed(np.array([link.mass_kg for link in links]) if links else none[:, 0]),
        link_com=_fixed(np.array([link.com_mm for link in links]) * 1e-3 if links else none),
        link_inertia=_fixed(np.array([_tensor(link) for link in links]) if links else np.zeros((7, 3, 3))),
        stiffness=_fixed(np.zeros(6) if tables.stiffness is None else np.array(tables.stiffness.joint_Nm_per_rad)),
        left_out=tuple(key for key, value in zip(LEAVES, given, strict=True) if value is None),
        link_shapes=tuple(
            (c.link, _fixed(np.array(c.from_mm) * 1e-3), _fixed(np.array(c.to_mm) * 1e-3), c.radius_mm * 1e-3)
            for c in tables.shape
        ),
        sources="\n".join(sources),
        payload=None if tables.payload is None else _rated(tables.payload),
    )


def _rated(table: RatedPayloadTable) -> RatedPayload:
    com, inertia, diagram = table.com_mm_at_rated, table.inertia_kg_m2, table.diagram
    return RatedPayload(
        mass=table.rated_kg,
        com=None if com is None else _fixed(np.array(com) * 1e-3),
        inertia=None if inertia is None else _fixed(np.array(inertia)),
        diagram=None if diagram is None else _fixed(np.array(diagram) * [1e-3, 1.0]),
    )


def _tensor(link: LinkTable) -> Array:
    if link.inertia_kg_m2 is None:
        return np.zeros((3, 3))
    xx, yy, zz, xy, xz, yz = link.inertia_kg_m2
    return np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])


def _fixed(array: Array) -> Array:
    """The array, no longer writable: a robot is shared by every part of a run."""
    array = np.ascontiguousarray(array, float)
    array.setflags(write=False)
    return array
