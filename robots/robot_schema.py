"""The keys of a robot .toml as users write them: millimetres, degrees, kilograms, with their bounds.

Nothing is converted here; `robots.robot` turns these tables into SI.
"""

from pathlib import Path
from typing import Annotated, Literal

from pydantic import BaseModel, ConfigDict, Field, model_validator

from robots.toml_input import read_toml

Number = Annotated[float, Field(allow_inf_nan=False, strict=True)]
Positive = Annotated[float, Field(gt=0, allow_inf_nan=False, strict=True)]
NotNegative = Annotated[float, Field(ge=0, allow_inf_nan=False, strict=True)]
Vector = tuple[Number, Number, Number]
Six = tuple[Number, Number, Number, Number, Number, Number]
SixPositive = tuple[Positive, Positive, Positive, Positive, Positive, Positive]
SixNotNegative = tuple[NotNegative, NotNegative, NotNegative, NotNegative, NotNegative, NotNegative]
Sign = Literal[-1, 1]


class Table(BaseModel):
    """A TOML table: unknown keys are errors; `source` says where its numbers come from."""

    model_config = ConfigDict(extra="forbid", frozen=True)


class GeometryTable(Table):
    """`[geometry]`: A_i = Rz(theta_i) Tz(d_i) Tx(a_i) Rx(alpha_i) Ry(beta_i), theta_i = sign_i q_i + offset_i."""

    source: str
    sign: tuple[Sign, Sign, Sign, Sign, Sign, Sign]
    theta_deg: Six
    d_mm: Six
    a_mm: Six
    alpha_deg: Six
    beta_deg: Six = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0)


class LimitsTable(Table):
    """`[limits]`, in the controller's axis signs."""

    source: str
    q_min_deg: Six
    q_max_deg: Six
    speed_deg_s: SixPositive
    acceleration_deg_s2: SixPositive
    torque_Nm: SixPositive

    @model_validator(mode="after")
    def _ordered(self) -> "LimitsTable":
        for i, (low, high) in enumerate(zip(self.q_min_deg, self.q_max_deg, strict=True)):
            if low >= high:
                raise ValueError(
                    f"q_min_deg[{i}] = {low:g} must be below q_max_deg[{i}] = {high:g}; exchange or correct the limits "
                    f"of axis {i + 1}"
                )
        return self


class GearsTable(Table):
    """`[gears]`, optional: motor turns per turn of the axis."""

    source: str
    ratio: SixPositive


class StiffnessTable(Table):
    """`[stiffness]`: joint stiffness about the axis, 0 = rigid."""

    source: str
    joint_Nm_per_rad: SixNotNegative


class LinkTable(Table):
    """One link in its MD-H frame (link i after joint i; the base in the base frame)."""

    mass_kg: NotNegative
    com_mm: Vector
    inertia_kg_m2: Six  # xx, yy, zz, xy, xz, yz about the centre of mass

    @model_validator(mode="after")
    def _physical(self) -> "LinkTable":
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


class LinksTable(Table):
    """`[links]`: base and links 1 to 6."""

    source: str
    base: LinkTable
    link1: LinkTable
    link2: LinkTable
    link3: LinkTable
    link4: LinkTable
    link5: LinkTable
    link6: LinkTable


class CapsuleTable(Table):
    """`[[shape]]`: a capsule of a link for collision checks, in the link's MD-H frame; 0 is the base."""

    link: Annotated[int, Field(ge=0, le=6)]
    from_mm: Vector
    to_mm: Vector
    radius_mm: Positive


class RobotTables(Table):
    """The whole file."""

    name: Annotated[str, Field(pattern=r"^[A-Za-z0-9_.-]+$")]
    title: str
    geometry: GeometryTable
    limits: LimitsTable
    gears: GearsTable | None = None
    stiffness: StiffnessTable
    links: LinksTable
    shape: tuple[CapsuleTable, ...] = ()


def read_robot_tables(path: Path) -> RobotTables:
    """Read and check a robot file.

    Raises BadInput, one sentence with file, key, value and remedy: missing or unreadable file, TOML syntax,
    unknown or missing key, wrong type or length, a number that is not finite or out of bounds, limits in the
    wrong order.
    """
    return read_toml(path, RobotTables, "robot")
