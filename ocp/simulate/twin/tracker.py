"""The virtual laser tracker: where it sees a reflector, with its own noise, its faults and what was planted in it."""

from collections.abc import Sequence

import numpy as np
from scipy.spatial.transform import Rotation

from ocp.model.cell import Cell
from ocp.simulate.twin.arm import Moments, VirtualArm
from ocp.simulate.twin.truth import Truth
from robots.errors import BadInput
from robots.pose import Array, apply

# A gross reading: a beam that was cut, a reflector not seated, a ghost. Distance m, log-evenly, any direction.
GROSS = (3e-4, 1e-2)
TURN_SIGMA = 1.5e-4  # rad, 0.01 deg of a 6D target


def nest_links(cell: Cell, names: Sequence[str]) -> Array:
    """Link (n,) 0..6 of every nest. Raises BadInput: a name that the cell does not have."""
    table = cell.tables.tracker
    known = table.targets if table is not None else {}
    unknown = next((name for name in names if name not in known), None)
    if unknown is not None:
        raise BadInput(f"{cell.path}: target '{unknown}' is not among [tracker.targets] ({', '.join(known) or 'none'})")
    links = {name: 6 if isinstance(target, tuple) else target.link for name, target in known.items()}
    return np.array([links[name] for name in names], np.int64)


def true_points(
    truth: Truth, cell: Cell, arm: VirtualArm, m: Moments, names: Sequence[str], rng: np.random.Generator | None = None
) -> Array:
    """Reflectors (n, 3) m in the tracker's frame, planted effects included and noise not; names: the nest of each instant.

    With rng the joints repeat as well as they do. Tracker effects: a nest that moves at a time, a frame that drifts and
    turns about the head with time, a scale.
    """
    links = arm.links(m, rng)
    nest = np.array([truth.nests[name] for name in names]).reshape(-1, 3)
    label = np.array(names)
    for planted in truth.planted("target_shift"):
        moved = (label == planted.word("target")) & (m.time_s >= planted.number("at_s"))
        nest = nest + np.where(moved[:, None], planted.vector("shift_m"), 0.0)
    on = links[np.arange(len(m)), nest_links(cell, names)]
    points = apply(truth.T_tracker_base, apply(on, nest))
    hours = m.time_s[:, None] / 3600.0
    for planted in truth.planted("tracker_drift"):
        turn = Rotation.from_rotvec(hours * planted.vector("rad_per_h"))
        points = turn.apply(points) + hours * planted.vector("m_per_h")
    return np.asarray(points * (1 + truth.total("tracker_scale", "scale")))


def measure(truth: Truth, cell: Cell, arm: VirtualArm, m: Moments, names: Sequence[str], rng: np.random.Generator) -> Array:
    """Readings (n, 3) m in the tracker's frame: joints repeat, range and two angles scatter, a share is grossly wrong."""
    return instrument(cell, truth.outliers, true_points(truth, cell, arm, m, names, rng), rng)


def instrument_noise(cell: Cell) -> tuple[float, float]:
    """One sigma along the beam m, and of the transverse noise m per metre of range."""
    table = cell.tables.tracker
    um, um_per_m = (8.0, 3.0) if table is None else (table.range_noise_um, table.transverse_noise_um_per_m)
    return 1e-6 * um, 1e-6 * um_per_m


def instrument(cell: Cell, outliers: float, points: Array, rng: np.random.Generator) -> Array:
    """What the instrument reads of points (n, 3) m: azimuth, elevation and range, each with its own noise.

    One sigma along the beam is the cell's range noise; across it, in both angles, range noise plus the transverse noise per
    metre of range, taken as the angle it is (FORMATS, [tracker]).
    """
    along, per_metre = instrument_noise(cell)
    n = len(points)
    flat = np.hypot(points[:, 0], points[:, 1])
    distance = np.hypot(flat, points[:, 2])
    across = (along + per_metre * distance) / distance
    z = rng.normal(size=(n, 3))
    elevation = np.arctan2(points[:, 2], flat) + across * z[:, 1]
    azimuth = np.arctan2(points[:, 1], points[:, 0]) + across * distance / np.maximum(flat, 1e-3) * z[:, 2]
    reach = distance + along * z[:, 0]
    level = reach * np.cos(elevation)
    read = np.stack([level * np.cos(azimuth), level * np.sin(azimuth), reach * np.sin(elevation)], axis=1)
    gross = rng.random(n) < outliers
    direction = rng.normal(size=(n, 3))
    size = np.exp(rng.uniform(np.log(GROSS[0]), np.log(GROSS[1]), n)) / np.linalg.norm(direction, axis=1)
    return np.asarray(np.where(gross[:, None], read + size[:, None] * direction, read))


def measure_turns(
    truth: Truth, cell: Cell, arm: VirtualArm, m: Moments, names: Sequence[str], rng: np.random.Generator | None
) -> tuple[Array, Array]:
    """Orientations (n, 3, 3) of 6D targets in the tracker's frame and which rows (n,) have one; without rng free of noise."""
    links = arm.links(m)
    on = links[np.arange(len(m)), nest_links(cell, names), :3, :3]
    turned = np.array([name in truth.nest_turns for name in names])
    mount = Rotation.from_rotvec([truth.nest_turns.get(name, np.zeros(3)) for name in names]).as_matrix()
    noise = Rotation.from_rotvec(rng.normal(size=(len(m), 3)) * TURN_SIGMA).as_matrix() if rng is not None else np.eye(3)
    return np.asarray(truth.T_tracker_base[:3, :3] @ on @ mount @ noise), turned
