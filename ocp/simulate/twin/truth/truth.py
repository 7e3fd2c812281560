"""What a virtual cell really is: everything that differs from what is believed, drawn from one seed.

Each part has a stream of random numbers of its own (`numpy.random.SeedSequence.spawn`), so that planting an effect, or
drawing one part more, leaves the rest of a machine as it was.
"""

from collections.abc import Sequence
from typing import Literal

import numpy as np
from scipy.spatial.transform import Rotation

from ocp.model.cell import Cell
from ocp.simulate.twin.truth.believed import believed_truth
from ocp.simulate.twin.truth.machine import SENSOR_SIGMA, Truth, believed_payloads
from ocp.simulate.twin.truth.planting import Planted
from robots.errors import BadInput
from robots.pose import Array, make_transform

__all__ = ["Mode", "Truth", "draw_truth"]

Mode = Literal["drawn", "believed", "sampled"]

# One sigma of what a cell is off. Placement: about 1.1 mm at the tool (PHYSICS 2.6). Springs and their scatter: PHYSICS 2.5.
PLACEMENT = (1.9e-4, 1.9e-4)  # m, rad of every link's frame
STIFFNESS, MASS_SD = 0.2, 0.01  # relative: evenly within this, one sigma
COVER_SD, BLADE_SD, FLANGE_SD, FLANGE_OFFSET_SD = 0.10, 0.05, 0.05, 0.2  # relative, relative, relative, N
SENSOR_BIAS_SD = 0.2  # N
# What no calibration finds: gear ripple and play of good gears, drawn evenly up to these; rad (PHYSICS 2.6: a real robot ends
# at 0.03-0.09 mm).
RIPPLE, PLAY, REPEATABILITY = 1.5e-5, 1.0e-5, 1.0e-5
RIPPLE_ORDERS = (3, 120)
OUTLIERS = 0.01  # share of readings
_PARTS = ("placement", "stiffness", "mass", "ripple", "play", "tracker", "nests", "wheel", "blade", "factors", "sensor", "sample")


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
        return believed_truth(cell, seed, tuple(effects), rng["sample"] if mode == "sampled" else None, *tracker)
    piece, wheel = cell.workpiece, cell.wheel
    unit, axis = _normal(rng["wheel"], 6) * size, wheel.axis
    held = _normal(rng["blade"], 6) * size
    factor = np.maximum(1 + size * _normal(rng["factors"], 3) * [COVER_SD, BLADE_SD, FLANGE_SD], 0.3)
    ripple = rng["ripple"].uniform(0, 1, (6, 3)) * [RIPPLE * size, 1.0, 2 * np.pi]
    ripple[:, 1] = rng["ripple"].integers(*RIPPLE_ORDERS, 6)
    turn = unit[3:] * wheel.axis_sd
    return Truth(
        seed=seed,
        mdh=cell.robot.mdh.copy(),
        placement=_normal(rng["placement"], (6, 6)) * np.repeat(PLACEMENT, 3) * size,
        stiffness=cell.robot.stiffness * (1 + size * rng["stiffness"].uniform(-STIFFNESS, STIFFNESS, 6)),
        bends=np.array([float(weight_bends == "all" or j in cell.compliant_joints) for j in range(1, 7)]),
        mass_scale=1 + size * _normal(rng["mass"], 7) * MASS_SD,
        payloads=believed_payloads(cell),
        ripple=ripple,
        play=rng["play"].uniform(0, PLAY, 6) * size,
        repeatability=REPEATABILITY,
        T_tracker_base=tracker[0],
        nests=tracker[1],
        nest_turns=tracker[2],
        wheel_shift=unit[:3] * wheel.centre_sd,
        wheel_axis_turn=turn - axis * (axis @ turn),
        blade_shift=held[:3] * piece.xyz_sd,
        blade_turn=held[3:] * piece.abc_sd,
        cover_scale=float(factor[0]),
        blade_scale=float(factor[1]),
        flange_scale=float(factor[2]),
        flange_offset=float(size * _normal(rng["factors"], 1)[0] * FLANGE_OFFSET_SD),
        sensor_bias=float(size * _normal(rng["sensor"], 1)[0] * SENSOR_BIAS_SD),
        sensor_sigma=SENSOR_SIGMA,
        outliers=OUTLIERS,
        effects=tuple(effects),
    )


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
