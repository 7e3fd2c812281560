"""The keys of cell.toml as users write them: millimetres, degrees, MPa, with their bounds.

Nothing here is converted; `ocp.model.cell` turns these tables into SI.
"""

from typing import Annotated, Any, Literal

from pydantic import ConfigDict, Field, model_validator

from ocp.effects.cell_effects import CellEffect, effect_of, patch_effect_of
from ocp.effects.patch import MOST_FEATURES
from robots.bounds import (
    AngleSpread,
    AngleVector,
    Direction,
    FileName,
    Force,
    Label,
    Margin,
    Mass,
    Micrometres,
    MomentOfInertia,
    Number,
    OffsetVector,
    Place,
    PlaceVector,
    Seconds,
    Spread,
    Spring,
    Temperature,
    Turn,
)
from robots.errors import shown
from robots.pose import ROTATION_ORDERS
from robots.toml_files import SchemaVersion, TomlTable

# um mm^2 / (N m): steel on felt takes some 0.01, a coarse belt on titanium some 10, a file on chalk less than 1e6.
Preston = Annotated[float, Field(ge=1e-6, le=1e6, allow_inf_nan=False, strict=True)]

# Counts: a joint's springs are six; every payload, nest and effect is a block of unknowns in a fit.
MOST_PAYLOADS, MOST_NESTS, MOST_EFFECTS = 200, 1000, 100

ROUNDED, LAST_DIGIT = 1.05, 1.5e-3  # of moments of inertia of a flat body, 1 + 1 = 2: two digits, or three decimals


class RobotTable(TomlTable):
    """`[robot]`."""

    model: FileName
    """Of the catalogue, or a robot file's path."""
    calibration: FileName | None = Field(default=None, examples=["calibration/calibration.toml"])
    """Path of its calibration.toml."""
    stiffness_Nm_per_rad: tuple[Spring, Spring, Spring, Spring, Spring, Spring] | None = None
    """Springs of the joints, 0 = rigid; without it the robot file's."""
    compliant_joints: Annotated[tuple[Annotated[int, Field(ge=1, le=6, strict=True)], ...], Field(max_length=6)] = (2, 3)
    """Joints that bend under weight; calibration fits their springs and may add others (`bending_joints`). Under contact force
    all springs give."""
    gravity_direction: Direction = (0.0, 0.0, -1.0)  # base frame; of any length
    """Where weight points, base frame: [0, 0, 1] under a ceiling, [1, 0, 0] on a wall with the x axis down."""

    @model_validator(mode="after")
    def _mounted(self) -> "RobotTable":
        if sum(c * c for c in self.gravity_direction) < 1e-12:
            raise ValueError("gravity_direction has length zero; [0, 0, -1] is an upright base, [0, 0, 1] one under a ceiling")
        if len(set(self.compliant_joints)) < len(self.compliant_joints):
            raise ValueError("compliant_joints names a joint twice; name each once")
        return self


class FloorTable(TomlTable):
    """`[floor]`: height of the floor above the origin of the robot's base, along the vertical; negative where the base stands
    higher than the floor, or hangs."""

    z_mm: Place = Field(examples=[-400])
    """Vertical height above the origin of the robot's base; negative below it."""


class PayloadTable(TomlTable):
    """`[payloads.NAME]`."""

    mass_kg: Mass
    """Its mass."""
    com_mm: OffsetVector = (0.0, 0.0, 0.0)
    """Its centre of mass, flange frame."""
    inertia_kg_m2: tuple[MomentOfInertia, MomentOfInertia, MomentOfInertia] = (0.0, 0.0, 0.0)
    """Moments of inertia there, flange axes."""

    @model_validator(mode="after")
    def _physical(self) -> "PayloadTable":
        moments = sorted(self.inertia_kg_m2)
        if (
            moments[2] > ROUNDED * (moments[0] + moments[1]) + LAST_DIGIT
        ):  # x + y - z is twice the body's integral of z^2, about any axes
            raise ValueError(
                f"inertia_kg_m2 = {list(self.inertia_kg_m2)}: no body has one moment above the sum of the two others; correct "
                "them (kg m^2 about the centre of mass), or leave all three out"
            )
        return self


class ControllerTable(TomlTable):
    """`[controller]`."""

    dialect: Literal["krl"] = "krl"
    """Language of the programs."""
    tool_no: Annotated[int, Field(ge=1, le=128, strict=True)] = 1
    """Number of TOOL_DATA, the blade's frame."""
    base_no: Annotated[int, Field(ge=1, le=128, strict=True)] = 1
    """Number of BASE_DATA, the wheel's frame."""
    absolute_accuracy: bool = False
    """Whether it corrects Cartesian targets itself."""


class WorkpieceTable(TomlTable):
    """`[workpiece]`."""

    payload: Label | None = None
    """Which of [payloads] hangs there while grinding; without it the first."""
    stl: FileName | None = None
    """The blade: STL, PLY, OBJ or STEP."""
    stl_unit: Literal["mm", "m", "in"] = "mm"
    """Unit of its numbers."""
    xyz_mm: OffsetVector
    """Origin of the blade's frame on the flange."""
    abc_deg: AngleVector = (0.0, 0.0, 0.0)
    """Its turn there, KUKA's A, B, C."""
    xyz_sd_mm: Spread = 0.3
    """One sigma of that place, each direction."""
    abc_sd_deg: AngleSpread = 0.05
    """One sigma of its turn, each angle."""
    # From rubber to diamond (1220 GPa).
    youngs_modulus_GPa: Annotated[float, Field(ge=1e-3, le=2000, strict=True)] = 114.0
    """Of the blade."""
    # Beyond these bulk or shear modulus vanishes, and the stiffness matrix with it.
    poisson_ratio: Annotated[float, Field(ge=-0.95, le=0.495, strict=True)] = 0.34
    """Of the blade."""
    # From cork to osmium (22 590).
    density_kg_m3: Annotated[float, Field(ge=10, le=3e4, strict=True)] = 4430.0
    """Of the blade."""
    clamp_axis: Literal["x", "y", "z"] | None = None
    """Axis of the blade's frame across the clamp plane."""
    clamp_to_mm: Place | None = None
    """Where that plane stands along clamp_axis."""
    clamp_side: Literal["below", "above"] = "below"
    """Which side of the plane is held."""
    clamp_normal: Direction | None = Field(default=None, examples=[[0, 0.1, 1]])
    """Instead of clamp_axis: direction across the plane, blade frame."""
    clamp_offset_mm: Number | None = Field(default=None, examples=[10])
    """With clamp_normal: the plane is normal . x = offset."""
    # A jaw of rubber or softer; infinite: rigid.
    clamp_stiffness_N_per_mm: Annotated[float, Field(ge=1, strict=True)] = float("inf")
    """Spring of the fixture."""
    aerofoil_axis: Direction | None = Field(default=None, examples=[[0, 0, 1]])
    """The span, blade frame, where the shape does not tell."""
    aerofoil_from_mm: Place | None = Field(default=None, examples=[12])
    """Only what lies between counts, along aerofoil_axis."""
    aerofoil_to_mm: Place | None = Field(default=None, examples=[118])
    """Only what lies between counts, along aerofoil_axis."""

    @model_validator(mode="after")
    def _one_clamp(self) -> "WorkpieceTable":
        by_axis = self.clamp_axis is not None and self.clamp_to_mm is not None
        by_plane = self.clamp_normal is not None and self.clamp_offset_mm is not None
        if by_axis == by_plane:
            raise ValueError("give the clamp either as clamp_axis with clamp_to_mm or as clamp_normal with clamp_offset_mm")
        if self.clamp_normal is not None and sum(c * c for c in self.clamp_normal) < 1e-12:
            raise ValueError("clamp_normal has length zero; give the direction across the clamp plane")
        return self

    @model_validator(mode="after")
    def _one_aerofoil(self) -> "WorkpieceTable":
        low, high = self.aerofoil_from_mm, self.aerofoil_to_mm
        if self.aerofoil_axis is None:
            if low is not None or high is not None:
                raise ValueError("aerofoil_from_mm and aerofoil_to_mm count along aerofoil_axis; give that direction too")
        elif sum(c * c for c in self.aerofoil_axis) < 1e-12:
            raise ValueError("aerofoil_axis has length zero; give the direction of the aerofoil's span in the blade frame")
        if low is not None and high is not None and low >= high:
            raise ValueError(f"aerofoil_from_mm {low:g} must be below aerofoil_to_mm {high:g}")
        return self


class WheelTable(TomlTable):
    """`[wheel]`."""

    centre_mm: PlaceVector
    """Its middle, base frame."""
    centre_sd_mm: Spread = 0.3
    """One sigma of it, each direction."""
    axis: Direction
    """The axle's direction, base frame, either sense."""
    axis_sd_deg: AngleSpread = 0.05
    """One sigma of it."""
    # From a mandrel to a wheel of 4 m; a cover from a lacquer to solid rubber, from foam to steel.
    radius_mm: Annotated[float, Field(ge=1, le=2000, strict=True)]
    """Outer radius, belt included."""
    width_mm: Annotated[float, Field(ge=0.5, le=1000, strict=True)]
    """Width of the contact face."""
    cover_thickness_mm: Annotated[float, Field(ge=0.1, le=1000, strict=True)]
    """Of the soft cover."""
    cover_modulus_MPa: Annotated[float, Field(ge=0.01, le=2e5, strict=True)] | None = Field(default=None, examples=[2.1])
    """Its modulus; this or shore_A."""
    shore_A: Annotated[float, Field(ge=20, le=95, strict=True)] | None = None
    """Its hardness."""
    cover_poisson: Annotated[float, Field(ge=0, le=0.495, strict=True)] = 0.47
    """Its Poisson's ratio."""
    contact_arc_deg: tuple[Number, Number] = (-30.0, 30.0)
    """Where the blade may touch, [low, high] from contact_direction, right-handed about axis."""
    contact_direction: Direction
    """From centre to contact, base frame, across axis."""
    # No belt holds together above; 0.35 is usual of friction, 2 is glue.
    belt_speed_m_s: Annotated[float, Field(ge=-300, le=300, strict=True)] = 20.0
    """Of the belt, positive right-handed about axis."""
    friction: Annotated[float, Field(ge=0, le=2, strict=True)] = 0.35
    """Coefficient, belt on blade."""

    @property
    def modulus_MPa(self) -> float:
        """Of the cover; from Shore A by PHYSICS 3.4: log10 E[MPa] = 0.0235 S - 0.6403."""
        if self.cover_modulus_MPa is not None:
            return self.cover_modulus_MPa
        assert self.shore_A is not None
        return float(10 ** (0.0235 * self.shore_A - 0.6403))

    @model_validator(mode="after")
    def _sound(self) -> "WheelTable":
        if (self.cover_modulus_MPa is None) == (self.shore_A is None):
            raise ValueError("give exactly one of cover_modulus_MPa and shore_A")
        if self.cover_thickness_mm >= self.radius_mm:
            raise ValueError(f"cover_thickness_mm {self.cover_thickness_mm:g} must be below radius_mm {self.radius_mm:g}")
        if not -180 <= self.contact_arc_deg[0] < self.contact_arc_deg[1] <= 180:
            raise ValueError("contact_arc_deg must be [low, high] with -180 <= low < high <= 180")
        for name in ("axis", "contact_direction"):
            if sum(c * c for c in getattr(self, name)) < 1e-12:
                raise ValueError(f"{name} has length zero")
        a, c = self.axis, self.contact_direction
        cross = (a[1] * c[2] - a[2] * c[1], a[2] * c[0] - a[0] * c[2], a[0] * c[1] - a[1] * c[0])
        lengths = sum(v * v for v in a) * sum(v * v for v in c)
        if sum(v * v for v in cross) < 0.25 * lengths:
            raise ValueError("contact_direction must stand across axis (here within 30 deg of it)")
        return self


OUTPUTS = frozenset(f"ANOUT[{k}]" for k in range(1, 33))  # the analogue outputs of KRL's $ANOUT


class FlangeTable(TomlTable):
    """`[force_flange]`."""

    setpoint_N: Force = 20.0
    """Force that it is set to."""
    # Air behind a piston to a solid block.
    stiffness_N_per_mm: Annotated[float, Field(ge=1e-3, le=1e6, strict=True)]
    """Force over stroke at a constant setting."""
    stroke_mm: Annotated[float, Field(ge=0.01, le=1000, strict=True)]
    """Whole travel between its stops."""
    carried_mass_kg: Mass = 0.0
    """Mass that it carries: holder and blade."""
    gravity_compensated: bool = True
    """Whether it corrects for that weight itself."""
    axis: Direction | None = Field(default=None, examples=[[1, 0, 0]])
    """Direction in which it gives, flange frame; without it the contact's normal."""
    # From a bellows filled through a long hose to faster than any valve; without it the force is set at once.
    bandwidth_hz: Annotated[float, Field(ge=0.1, le=1e4, strict=True)] | None = Field(default=None, examples=[10])
    """Corner (-3 dB) of the low-pass from setting to force; without it at once."""
    delay_ms: Annotated[float, Field(ge=0, le=1000, allow_inf_nan=False, strict=True)] = 0.0
    """From a setting to the force's first change."""
    friction_N: Force = 0.0
    """Coulomb friction against the stroke."""
    # Scale: output, which reaches from -1 to 1, per newton.
    setpoint_output: Label | None = Field(default=None, examples=["ANOUT[1]"])
    """ANOUT[1] to ANOUT[32]; not driven yet."""
    setpoint_scale: Annotated[float, Field(ge=1e-6, le=1, strict=True)] | None = Field(default=None, examples=[0.01])
    """Output (-1 to 1) per newton."""

    @model_validator(mode="after")
    def _output(self) -> "FlangeTable":
        if self.setpoint_output is not None and self.setpoint_output not in OUTPUTS:
            raise ValueError(
                f"setpoint_output '{shown(self.setpoint_output)}' is no analogue output; name one of ANOUT[1] to ANOUT[32]"
            )
        if (self.setpoint_output is None) != (self.setpoint_scale is None):
            raise ValueError("setpoint_output and setpoint_scale (output per newton) belong together; give both or neither")
        if self.setpoint_scale is not None and self.setpoint_N * self.setpoint_scale > 1:
            asked = self.setpoint_N * self.setpoint_scale
            raise ValueError(f"setpoint_N times setpoint_scale is {asked:g}, an analogue output reaches 1; give a smaller scale")
        return self

    @model_validator(mode="after")
    def _axis(self) -> "FlangeTable":
        if self.axis is not None and sum(c * c for c in self.axis) < 1e-12:
            raise ValueError("axis has length zero; omit it to let the flange act along the contact normal")
        return self


class ProcessTable(TomlTable):
    """`[process]`."""

    force_N: Annotated[float, Field(ge=0.01, le=1000, allow_inf_nan=False, strict=True)] = 20.0
    """Wanted force."""
    # Slower a line of a blade takes hours, faster than any arm's path; lines nearer than 0.1 mm cover nothing anew.
    feed_mm_s: Annotated[float, Field(ge=0.1, le=5000, strict=True)] = 40.0
    """Of the contact over the blade."""
    pass_spacing_mm: Annotated[float, Field(ge=0.1, le=1000, strict=True)] = 6.0
    """Largest distance of neighbouring lines."""
    passes: Literal["spanwise", "chordwise"] = "spanwise"
    """Direction of the lines."""
    side: Literal["convex", "concave", "both"] = "both"
    """Which side is ground."""
    tilt_tolerance_deg: Annotated[float, Field(ge=0, le=45, strict=True)] = 3.0
    """Of the blade, about the belt's direction and the axle."""
    turn_tolerance_deg: Turn = 30.0
    """Of the feed, from the belt's direction."""
    lateral_tolerance_mm: Margin = 10.0
    """Of the contact, from the wheel's middle."""
    grinding: Literal["down", "up"] = "down"
    """Down: the blade moves with the belt; up: against it."""
    root_margin_mm: Margin = 5.0
    """Left free at root and tip."""
    tip_margin_mm: Margin = 5.0
    """Left free at root and tip."""
    edge_margin_mm: Margin = 3.0
    """Left free at leading and trailing edge."""
    edge_force_N: Force = 5.0
    """Lines begin as far out on the margin as a patch under this force stays on the blade."""
    # What is wanted of all passes together; a belt that takes off 2 mm mills.
    removal_um: Annotated[float, Field(ge=0.01, le=2000, allow_inf_nan=False, strict=True)] | None = Field(
        default=None, examples=[20]
    )
    """Depth wanted of all passes together; without it what force and feed make."""
    preston_um_mm2_per_N_m: Preston | None = Field(default=None, examples=[0.05])
    """Preston's coefficient, depth over pressure and sliding way, as `ocp.update --removal` writes it."""
    preston_sd_um_mm2_per_N_m: Preston | None = Field(default=None, examples=[0.002])
    """Its one sigma."""

    @model_validator(mode="after")
    def _preston(self) -> "ProcessTable":
        if self.preston_sd_um_mm2_per_N_m is not None and self.preston_um_mm2_per_N_m is None:
            raise ValueError("preston_sd_um_mm2_per_N_m belongs to preston_um_mm2_per_N_m, which is missing; add it")
        return self


class LinkTarget(TomlTable):
    """A reflector nest on a link, or a 6D target."""

    link: Annotated[int, Field(ge=0, le=6, strict=True)] = 6
    """Link that carries it, 0 the base, 6 the flange."""
    xyz_mm: OffsetVector = Field(examples=[[150, -50, 250]])
    """Its place in that link's frame."""
    abc_deg: AngleVector | None = Field(default=None, examples=[[0, 90, 0]])
    """Its turn there, of a 6D target."""


class TrackerTable(TomlTable):
    """`[tracker]`."""

    range_noise_um: Micrometres = 8.0
    """One sigma along the beam."""
    transverse_noise_um_per_m: Micrometres = 3.0
    """One sigma across it, per metre of distance."""
    target_sd_mm: Spread = 1.0
    """One sigma of the nests' places."""
    rotation: Literal[ROTATION_ORDERS] = "zyx_intrinsic"  # type: ignore[valid-type]
    """Order of a 6D target's angles rx, ry, rz."""
    targets: dict[Label, OffsetVector | LinkTarget] = Field(default_factory=dict, max_length=MOST_NESTS)
    """Nests by name: [x, y, z] mm on the flange, or a table."""


class EffectTable(TomlTable):
    """`[[effects]]`: an effect of the catalogue with its keys (docs/effects.md)."""

    model_config = ConfigDict(extra="allow", frozen=True, strict=False, use_attribute_docstrings=True)

    effect: str = Field(examples=["backlash"])
    """Its name; its own keys stand beside it."""
    joint: Annotated[int, Field(ge=1, le=6, strict=True)] | None = Field(default=None, examples=[5])
    """Where it acts at one joint."""
    sd: dict[str, Any] = Field(default_factory=dict, examples=[{"half_width_rad": 4e-6}])
    """One sigma by key."""

    @model_validator(mode="after")
    def _known(self) -> "EffectTable":
        effect_of(self.model_dump())
        return self


class PatchTable(TomlTable):
    """`[[patches]]`: a correction that has no name, as a diagnosis writes it (`ocp.effects.patch`)."""

    signal: Literal["tracker", "force"] = Field(examples=["tracker"])
    """That it was learnt from."""
    where: Label = Field(examples=["q3"])
    """What it varies with, in words."""
    kernel: Label = Field(examples=["joint"])
    """How it enters: a turn of a joint, a tilt of its axis, the tracker's frame or beam, the contact's force, its reading."""
    joint: Annotated[int, Field(ge=1, le=6, strict=True)] | None = Field(default=None, examples=[3])
    """Where it acts at one joint."""
    features: Annotated[tuple[str, ...], Field(min_length=1, max_length=MOST_FEATURES)] = Field(
        examples=[["wave 1 q3", "wave 2 q3"]]
    )
    """Formulas of the conditions."""
    weights: tuple[float, ...] = Field(examples=[[2e-4, -1e-4]])
    """Of the features, rad, m or N."""
    covariance: tuple[tuple[float, ...], ...] = Field(examples=[[[1e-11, 0], [0, 1e-11]]])
    """Their covariance."""
    range: dict[str, tuple[float, float]] = Field(default_factory=dict, examples=[{"q3": [-0.5, 2.5]}])
    """Least and most measured of every condition."""
    about: tuple[float, float, float] | None = Field(default=None, examples=[[0.4, 3.2, 3.4]])
    """Of a beam's patch: mean azimuth rad, distance over ground m, distance m."""
    formula: str = Field(default="", examples=["0.2 mrad at joint 3"])
    """The sum in words."""
    promise: str = Field(default="", examples=["0.42 of the gap, 0.35 to 0.48"])
    """Shrinkage promised."""

    @model_validator(mode="after")
    def _whole(self) -> "PatchTable":
        patch_effect_of(self.model_dump())
        return self


class ConditionsTable(TomlTable):
    """`[conditions]`: what the cell's effects depend on, as it will be when the plan runs."""

    temperature_C: Temperature | None = Field(default=None, examples=[27])
    """Of the structure; without it the reference."""
    wheel_temperature_C: Temperature | None = Field(default=None, examples=[35])
    """Of the wheel's cover; without it the reference."""
    time_s: Seconds = 0.0
    """Since the tracker's campaign began."""
    clock_s: Seconds = 0.0
    """That the wheel has run since the first force log."""
    # A thousand passes take the blade away.
    ground_before: Annotated[int, Field(ge=0, le=1000, strict=True)] = 0
    """How often every line was ground."""


class CellTables(TomlTable):
    """The whole of cell.toml."""

    version: SchemaVersion = 1
    """Version of the format."""
    name: Label = "cell"
    """In reports."""
    reference_temperature_C: Temperature = 20.0
    """At which the cell's numbers hold."""
    robot: RobotTable
    """The arm."""
    payloads: dict[Label, PayloadTable] = Field(default_factory=dict, max_length=MOST_PAYLOADS)
    """What may hang on the flange, by name."""
    controller: ControllerTable = ControllerTable()
    """The robot's controller."""
    workpiece: WorkpieceTable | None = None
    """Blade and holder; without it nothing is planned."""
    wheel: WheelTable | None = None
    """Without it nothing is planned."""
    force_flange: FlangeTable | None = None
    """Device that sets the force; without it the holder is screwed on rigidly."""
    floor: FloorTable | None = None
    """Without it only the plane of the base is kept free."""
    process: ProcessTable = ProcessTable()
    """What is wanted."""
    tracker: TrackerTable | None = None
    """The laser tracker and its nests."""
    effects: Annotated[tuple[EffectTable, ...], Field(max_length=MOST_EFFECTS)] = ()
    """Believed effects (docs/effects.md)."""
    patches: Annotated[tuple[PatchTable, ...], Field(max_length=MOST_EFFECTS)] = ()
    """Corrections that a diagnosis writes (`ocp.effects.patch`)."""
    conditions: ConditionsTable = ConditionsTable()
    """What effects depend on, as it will be when the plan runs."""

    @property
    def believed(self) -> tuple[CellEffect, ...]:
        """Effects and patches of the cell."""
        named = (effect_of(table.model_dump()) for table in self.effects)
        return (*named, *(patch_effect_of(table.model_dump()) for table in self.patches))

    @property
    def hanging(self) -> str | None:
        """Name of the payload that hangs on the flange while grinding; None: there are none."""
        named = self.workpiece.payload if self.workpiece else None
        return named or next(iter(self.payloads), None)

    @model_validator(mode="after")
    def _payload_known(self) -> "CellTables":
        named = self.workpiece.payload if self.workpiece else None
        if named is not None and named not in self.payloads:
            known = ", ".join(sorted(self.payloads)) or "none"
            raise ValueError(f"workpiece.payload '{shown(named)}' is not among [payloads] ({shown(known, 200)})")
        return self
