"""What a virtual cell really is: everything that differs from what is believed, drawn from one seed, or exactly what is believed.

Each part has a stream of random numbers of its own (`numpy.random.SeedSequence.spawn`), so that planting an effect, or
drawing one part more, leaves the rest of a machine as it was. A cell that is as believed has its calibration folded in; names of
the parameters are the product's list (robots/calibration/parameters.py), written out here a second time because the virtual
cell shares nothing with the model.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Literal

import numpy as np
from scipy.spatial.transform import Rotation

from ocp.model.cell import Cell
from ocp.simulate.twin.planting import Planted
from robots.errors import BadInput
from robots.pose import Array, make_transform

SENSOR_SIGMA = 0.3  # N, one sigma of a force reading
# 1/Pa, of a cell that tells none: 17 um at 20 N, 20 m/s of belt, 40 mm/s of feed and 6 mm from line to line.
USUAL_PRESTON = 1e-11


@dataclass(frozen=True, eq=False, kw_only=True)
class Truth:
    """A virtual cell, SI and radians.

    mdh (6, 5) design numbers; placement (6, 6): shift m and turn (rotation vector) rad of link i's frame against its design
    place, in that frame's axes; stiffness (6,) N m/rad (0 rigid), bends (6,) whether weight bends the joint (under contact all
    springs give); mass_scale (7,) and mass_shift (7, 3) m of base and links: how heavy, and where their centres are in the link's
    frame against what is believed; payloads: mass kg and centre (3,) m by name. ripple (6, k, 3) amplitude rad, order, phase of k
    lines a gear; play (6,) half width rad; repeatability rad. T_tracker_base; nests: places (3,) m in their links' frames,
    nest_turns: rotation vectors of 6D targets. wheel_shift m and wheel_axis_turn (rotation vector) in base axes; blade_shift m
    and blade_turn (rotation vector) in flange axes, wheel_radius m, on top of the cell's. cover_scale, blade_scale,
    flange_scale: factors on stiffness, 1 = as in the cell; flange_offset N. preston 1/Pa: depth that a pressure grinds per way
    of belt. sensor N; outliers: share of gross tracker readings; tails: degrees of freedom of Student's law that the tracker's
    noise follows, inf: normal.
    """

    seed: int
    mdh: Array
    placement: Array = field(default_factory=lambda: np.zeros((6, 6)))
    stiffness: Array
    bends: Array
    mass_scale: Array = field(default_factory=lambda: np.ones(7))
    mass_shift: Array = field(default_factory=lambda: np.zeros((7, 3)))
    payloads: dict[str, tuple[float, Array]]
    ripple: Array = field(default_factory=lambda: np.zeros((6, 1, 3)))
    play: Array = field(default_factory=lambda: np.zeros(6))
    repeatability: float = 0.0
    T_tracker_base: Array
    nests: dict[str, Array]
    nest_turns: dict[str, Array]
    wheel_shift: Array
    wheel_axis_turn: Array
    blade_shift: Array
    blade_turn: Array
    cover_scale: float
    blade_scale: float
    flange_scale: float
    flange_offset: float
    sensor_bias: float
    wheel_radius: float = 0.0
    preston: float = USUAL_PRESTON
    sensor_sigma: float = SENSOR_SIGMA
    outliers: float = 0.0
    tails: float = np.inf
    effects: tuple[Planted, ...]

    def planted(self, effect: str) -> list[Planted]:
        """The planted effects of a name."""
        return [p for p in self.effects if p.effect == effect]

    def total(self, effect: str, key: str) -> float:
        """Sum of a key over the planted effects of a name; 0 without any."""
        return sum((p.number(key) for p in self.planted(effect)), 0.0)


Tracker = tuple[Array, dict[str, Array], dict[str, Array]]
_MDH = ("th", "d", "a", "al", "be")


def believed_truth(
    cell: Cell, seed: int, effects: tuple[Planted, ...], sample: np.random.Generator | None, tracker: Tracker
) -> Truth:
    """The cell with its calibration's values, moved by one sample of the covariance where `sample` is given; tracker: where it
    stands, its nests and their turns.

    Only the cell's compliant joints bend under weight, as the planner has it; under contact all listed springs give.
    Raises BadInput: a sample is asked of a cell without calibration.
    """
    known = _values(cell, sample)
    robot, flange, axis = cell.robot, cell.flange, cell.wheel.axis
    mdh = np.array([[known.get(f"{s}{i + 1}", robot.mdh[i, k]) for k, s in enumerate(_MDH)] for i in range(6)])
    own = np.divide(1.0, robot.stiffness, out=np.zeros(6), where=robot.stiffness > 0)
    compliance = np.maximum([known.get(f"c{i + 1}", own[i]) for i in range(6)], 0.0)
    u, v = _across(axis)
    stiffness = flange.stiffness if flange is not None else 1.0
    return Truth(
        seed=seed,
        mdh=mdh,
        stiffness=np.divide(1.0, compliance, out=np.zeros(6), where=compliance > 0),
        bends=np.array([float(j in cell.compliant_joints) for j in range(1, 7)]),
        payloads=_payloads(cell, known),
        T_tracker_base=tracker[0],
        nests=tracker[1],
        nest_turns=tracker[2],
        wheel_shift=_vector(known, "wheel_x", "wheel_y", "wheel_z"),
        wheel_radius=known.get("wheel_radius", 0.0),
        wheel_axis_turn=known.get("wheel_axis_u", 0.0) * u + known.get("wheel_axis_v", 0.0) * v,
        blade_shift=_vector(known, "blade_x", "blade_y", "blade_z"),
        blade_turn=_vector(known, "blade_c", "blade_b", "blade_a"),
        cover_scale=1 + known.get("cover_stiffness_scale", 0.0),
        blade_scale=1 + known.get("blade_stiffness_scale", 0.0),
        flange_scale=known.get("flange_stiffness", stiffness) / stiffness,
        flange_offset=known.get("flange_setpoint_offset", 0.0),
        sensor_bias=known.get("sensor_bias", 0.0),
        preston=cell.process.preston or USUAL_PRESTON,
        effects=effects,
    )


def _values(cell: Cell, sample: np.random.Generator | None) -> dict[str, float]:
    """The calibration's values by name, sampled where asked."""
    calibration = cell.calibration
    if calibration is None:
        if sample is not None:
            raise BadInput(f"{cell.path}: the cell has no calibration to draw a sample from; name one in [robot].calibration")
        return {}
    values = np.asarray(calibration.values, float)
    if sample is not None:
        # Scaled to a correlation matrix first: lengths and compliances differ by orders of magnitude.
        sd = np.maximum(calibration.standard_deviation, 1e-300)
        w, V = np.linalg.eigh(calibration.covariance / np.outer(sd, sd))
        values = values + sd * (V @ (np.sqrt(np.maximum(w, 0.0)) * sample.normal(size=len(values))))
    return {name: float(value) for name, value in zip(calibration.names, values, strict=True)}


def _vector(known: dict[str, float], *names: str) -> Array:
    return np.array([known.get(name, 0.0) for name in names])


def _payloads(cell: Cell, known: dict[str, float]) -> dict[str, tuple[float, Array]]:
    """Mass kg and centre (3,) m in the flange frame of the cell's payloads; the one that grinds as calibrated."""
    payloads = {name: (table.mass_kg, 1e-3 * np.array(table.com_mm)) for name, table in cell.tables.payloads.items()}
    if (name := cell.tables.hanging) is not None:
        mass, com = payloads[name]
        centre = np.array([known.get(f"payload_com_{x}", com[k]) for k, x in enumerate("xyz")])
        payloads[name] = (max(known.get("payload_mass", mass), 0.0), centre)
    return payloads


def _across(axis: Array) -> tuple[Array, Array]:
    """Two unit vectors u, v across the wheel's axis with u x v = axis, u nearest to the first base axis most across it.

    What `wheel_axis_u` and `wheel_axis_v` of a calibration turn about.
    """
    nearest = np.zeros(3)
    nearest[int(np.argmin(np.abs(axis)))] = 1.0
    u = nearest - (nearest @ axis) * axis
    u = u / np.sqrt(u @ u)
    return u, np.cross(axis, u)


Mode = Literal["drawn", "believed", "sampled"]

# One sigma of what a cell is off. Placement: about 1.1 mm at the tool (PHYSICS 2.6). Springs and their scatter: PHYSICS 2.5.
PLACEMENT = (1.9e-4, 1.9e-4)  # m, rad of every link's frame
STIFFNESS, MASS_SD = 0.2, 0.01  # relative: evenly within this, one sigma
COVER_SD, BLADE_SD, FLANGE_SD, FLANGE_OFFSET_SD = 0.10, 0.05, 0.05, 0.2  # relative, relative, relative, N
SENSOR_BIAS_SD = 0.2  # N
PRESTON_SD = 0.2  # relative, where the cell tells no sd: belts of one grit, new and worn
# What no calibration finds: gear ripple and play of good gears, drawn evenly up to these; rad (PHYSICS 2.6: a real robot ends
# at 0.03-0.09 mm).
RIPPLE, PLAY, REPEATABILITY = 1.5e-5, 1.0e-5, 1.0e-5
RIPPLE_ORDERS = (3, 120)
OUTLIERS = 0.01  # share of readings
_PARTS = "placement stiffness mass ripple play tracker nests wheel blade factors sensor sample belt".split()


def draw_truth(
    cell: Cell,
    seed: int,
    effects: Sequence[Planted] = (),
    mode: Mode = "drawn",
    size: float = 1.0,
    weight_bends: Literal["all", "believed"] = "all",
) -> Truth:
    """A virtual cell. Modes:

    "drawn": the nominal cell, whatever its calibration says, with manufacturing and registration errors and small background
    effects, all times `size`. "believed": the cell as believed, calibration included, with nothing but
    noise. "sampled": believed, with one sample of the calibration's covariance.
    weight_bends: in "drawn", whether weight bends all six joints, as in reality, or those alone that the cell believes in: then
    a machine with nothing planted holds no joint_compliance that a diagnosis would rightly name.
    Raises BadInput: "sampled" without a calibration, or an effect on a target that the cell does not have.
    """
    rng = dict(zip(_PARTS, (np.random.default_rng(s) for s in np.random.SeedSequence(seed).spawn(len(_PARTS))), strict=True))
    tracker = (_head(rng["tracker"]), *_nests(cell, rng["nests"], size if mode == "drawn" else 0.0))
    _refuse_unknown_targets(cell, effects)
    if mode != "drawn":
        return believed_truth(cell, seed, tuple(effects), rng["sample"] if mode == "sampled" else None, tracker)
    piece, wheel = cell.workpiece, cell.wheel
    unit, axis = _normal(rng["wheel"], 6) * size, wheel.axis
    held = _normal(rng["blade"], 6) * size
    belt, belt_sd = _stated_preston(cell)
    belt = belt or USUAL_PRESTON
    belt_sd = belt_sd or PRESTON_SD * belt
    factor = np.maximum(1 + size * _normal(rng["factors"], 3) * [COVER_SD, BLADE_SD, FLANGE_SD], 0.3)
    ripple = rng["ripple"].uniform(0, 1, (6, 3)) * [RIPPLE * size, 1.0, 2 * np.pi]
    ripple[:, 1] = rng["ripple"].integers(*RIPPLE_ORDERS, 6)
    turn = unit[3:] * wheel.axis_sd
    return replace(
        believed_truth(replace(cell, calibration=None), seed, tuple(effects), None, tracker),
        placement=_normal(rng["placement"], (6, 6)) * np.repeat(PLACEMENT, 3) * size,
        stiffness=cell.robot.stiffness * (1 + size * rng["stiffness"].uniform(-STIFFNESS, STIFFNESS, 6)),
        bends=np.array([float(weight_bends == "all" or j in cell.tables.robot.compliant_joints) for j in range(1, 7)]),
        mass_scale=1 + size * _normal(rng["mass"], 7) * MASS_SD,
        ripple=ripple[:, None],
        play=rng["play"].uniform(0, PLAY, 6) * size,
        repeatability=REPEATABILITY,
        wheel_shift=unit[:3] * wheel.centre_sd,
        wheel_axis_turn=turn - axis * (axis @ turn),
        blade_shift=held[:3] * piece.xyz_sd,
        blade_turn=held[3:] * piece.abc_sd,
        **dict(zip(("cover_scale", "blade_scale", "flange_scale"), factor.tolist(), strict=True)),
        flange_offset=float(size * _normal(rng["factors"], 1)[0] * FLANGE_OFFSET_SD),
        sensor_bias=float(size * _normal(rng["sensor"], 1)[0] * SENSOR_BIAS_SD),
        preston=max(belt + size * float(_normal(rng["belt"], 1)[0]) * belt_sd, 0.1 * belt),
        outliers=OUTLIERS,
    )


def _stated_preston(cell: Cell) -> tuple[float, float]:
    """Preston's coefficient and its sd as whoever wrote the cell has them, zero where untold: what an update found of the belt is
    no part of the machine."""
    known = getattr(cell.calibration, "provenance", {}).get("update")
    if known is None:
        return cell.process.preston or 0.0, cell.process.preston_sd or 0.0
    stated = known.get("stated_preston", [0.0, 0.0])
    return float(stated[0]), float(stated[1])


def _normal(rng: np.random.Generator, shape: int | tuple[int, ...]) -> Array:
    """Normal numbers cut at 2.5 sigma: a machine beyond would not have passed its acceptance."""
    return np.clip(rng.normal(size=shape), -2.5, 2.5)


def _head(rng: np.random.Generator) -> Array:
    """T_tracker_base (4, 4): the head 2.5 to 5 m in front of the robot, roughly levelled, turned anyhow."""
    distance, azimuth, height = rng.uniform(2.5, 5.0), rng.uniform(-0.9, 0.9), rng.uniform(0.8, 1.8)
    head = np.array([distance * np.cos(azimuth), distance * np.sin(azimuth), height])
    R = Rotation.from_euler("zyx", [rng.uniform(-np.pi, np.pi), *rng.uniform(-0.1, 0.1, 2)]).as_matrix()
    return make_transform(R, -R @ head)


def _nests(cell: Cell, rng: np.random.Generator, size: float) -> tuple[dict[str, Array], dict[str, Array]]:
    """Places (3,) m of the reflector nests as they are, and turns of 6D targets, as rotation vectors (3,) rad."""
    places: dict[str, Array] = {}
    turns: dict[str, Array] = {}
    tracker = cell.tables.tracker
    if tracker is None:
        return places, turns
    for name, target in tracker.targets.items():
        place = np.array(target if isinstance(target, tuple) else target.xyz_mm) * 1e-3
        places[name] = place + size * _normal(rng, 3) * tracker.target_sd_mm * 1e-3
        turn = size * _normal(rng, 3) * 2e-3  # rad; a mount set by eye on a ruled plate
        if not isinstance(target, tuple) and target.abc_deg is not None:
            given = Rotation.from_euler("ZYX", target.abc_deg, degrees=True)
            turns[name] = (given * Rotation.from_rotvec(turn)).as_rotvec()
    return places, turns


def _refuse_unknown_targets(cell: Cell, effects: Sequence[Planted]) -> None:
    known = list(cell.tables.tracker.targets) if cell.tables.tracker is not None else []
    for effect in effects:
        named = effect.values.get("target")
        if named is not None and named not in known:
            raise BadInput(
                f"effect '{effect.effect}': the cell has no target '{named}'; choose from [tracker.targets] "
                f"({', '.join(known) or 'none'})"
            )
