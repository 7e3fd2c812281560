"""The postures in which the blade is ground: where a calibration has to be right, and near which many poses are tried."""

from dataclasses import dataclass

import numpy as np

from ocp.model.cell import Cell
from ocp.plan.clearance.collision import CollisionScene, flange_pose
from ocp.plan.passes.posture import contact_poses
from ocp.plan.paths import lay_paths
from ocp.plan.planning import PlanOptions
from robots.errors import Infeasible
from robots.inverse import inverse_branches
from robots.pose import Array, apply, make_transform, rotation_from_abc
from trajectories.passes import BladePath

STATIONS = 3  # contact points looked at on every pass
MOST = 24  # postures of the zone
STEP = 5e-3  # m between waypoints of the passes; only a few of them are used
# A blade where the cell's STL is not at hand: half width, half thickness and span m beyond the clamp plane.
STAND_IN = (0.030, 0.005, 0.110)
AWAY = (0.03, 0.45)  # m off the wheel, where poses near the zone are tried
ASIDE, TWIST = 0.25, np.radians(70.0)  # m and rad (one axis of three), how far they stray


@dataclass(frozen=True)
class GroundBlade:
    """Vertices (n, 3) m in the blade frame, passes, and a notice where a stand-in takes the place of the STL."""

    vertices: Array
    paths: list[BladePath]
    notices: tuple[str, ...] = ()


@dataclass(frozen=True)
class Zone:
    """Grinding postures q (k, 6) rad and the blade's contact point (k, 3) m in the flange frame."""

    q: Array
    point: Array


def ground_blade(cell: Cell) -> GroundBlade:
    """The cell's blade with a few passes, or a plain slab where its STL is not there. Raises BadInput as `lay_paths`."""
    stl = cell.workpiece.stl
    if stl is not None and stl.is_file():
        laid = lay_paths(cell, stl, PlanOptions(step=STEP))
        return GroundBlade(laid.blade.vertices, laid.paths)
    what = f"{stl.name} is not beside the cell" if stl is not None else "the cell names no STL"
    width, half, span = (2e3 * STAND_IN[0], 2e3 * STAND_IN[1], 1e3 * STAND_IN[2])
    return GroundBlade(*_slab(cell), (f"{what}: a slab of {width:g} x {half:g} x {span:g} mm stands for the blade",))


def find_zone(cell: Cell, scene: CollisionScene, blade: GroundBlade) -> Zone:
    """Postures with the blade on the wheel, spread over its passes, free of collisions where such exist.

    Raises Infeasible: no posture within the axis limits reaches the wheel.
    """
    robot, sigma = cell.robot, cell.process.sigma
    turns = cell.process.turn_tolerance * np.array([0.0, -0.5, 0.5])
    chosen = blade.paths[:: max(1, -(-len(blade.paths) * STATIONS // MOST))]
    q, points = [], []
    for path in chosen:
        index = np.unique(np.linspace(0, len(path.s) - 1, STATIONS).round().astype(int))
        arc = np.full(len(turns), float(np.mean(cell.wheel.arc)))
        for k in index:
            T = [contact_poses(cell, path, np.array([k]), arc, turns, d, sigma)[:, 0] for d in (1, -1)]
            posture = _best(cell, scene, flange_pose(cell, np.concatenate(T)))
            if posture is not None:
                q.append(posture)
                points.append(apply(cell.workpiece.T_flange_blade, path.p[k]))
    if not q:
        raise Infeasible(
            "no posture within the axis limits brings the blade to the wheel, so that no grinding zone exists; "
            f"correct wheel.centre_mm or workpiece.xyz_mm of {cell.path.name} (robot {robot.name})"
        )
    return Zone(np.array(q), np.array(points))


def near_zone(cell: Cell, blade: GroundBlade, count: int, rng: np.random.Generator) -> Array:
    """Up to `count` postures (m, 6) rad with the blade near the wheel, turned and shifted at random, all branches."""
    robot, wheel = cell.robot, cell.wheel
    poses = []
    for path in blade.paths:
        share = -(-count // len(blade.paths))
        station = rng.integers(0, len(path.s), share)
        arc, turn = rng.uniform(*wheel.arc, share), rng.uniform(-np.pi, np.pi, share)
        T = np.stack(
            [
                contact_poses(cell, path, np.array([k]), np.array(a), np.array(t), 1, 1)[0]
                for k, a, t in zip(station, arc, turn, strict=True)
            ]
        )
        pivot = apply(T, path.p[station])
        shift = rng.uniform(*AWAY, share)[:, None] * wheel.contact_direction + rng.uniform(-ASIDE, ASIDE, (share, 3))
        R = rotation_from_abc(rng.uniform(-TWIST, TWIST, (share, 3)))
        # Turn about the contact point, then move it.
        poses.append(make_transform(R @ T[:, :3, :3], pivot + shift - (R @ (T[:, :3, :3] @ path.p[station][..., None]))[..., 0]))
    q, reachable = inverse_branches(robot, flange_pose(cell, np.concatenate(poses)))
    rows, branches = np.nonzero(reachable)
    found = q[rows, branches]
    found = found[((found > robot.q_min) & (found < robot.q_max)).all(axis=1)]
    return np.asarray(rng.permutation(found)[:count])


def _best(cell: Cell, scene: CollisionScene, T_flange: Array) -> Array | None:
    """The posture (6,) of flange poses (m, 4, 4) in the middle of the axis ranges, free ones first; None if none."""
    robot = cell.robot
    q, reachable = inverse_branches(robot, T_flange)
    q = q[reachable]
    q = q[((q > robot.q_min) & (q < robot.q_max)).all(axis=1)]
    if not len(q):
        return None
    middle = (np.abs(2 * q - robot.q_min - robot.q_max) / (robot.q_max - robot.q_min)).max(axis=1)
    clear, _ = scene.clearances(q, in_contact=True)
    return np.asarray(q[int(np.argmin(middle + 10.0 * (clear < 0)))])


def _slab(cell: Cell) -> tuple[Array, list[BladePath]]:
    """Corners (8, 3) m of the stand-in and a pass along the span on either side."""
    normal, offset = cell.workpiece.clamp_normal, cell.workpiece.clamp_offset
    wide = np.eye(3)[int(np.argmin(np.abs(normal)))]
    wide = wide - normal * (normal @ wide)
    wide /= np.linalg.norm(wide)
    thick = np.cross(normal, wide)
    half, thin, span = STAND_IN
    outline = [x * half * wide + y * thin * thick for x in (-1, 1) for y in (-1, 1)]
    corners = [point + (offset + z * span) * normal for point in outline for z in (0, 1)]
    s = np.linspace(0.0, 0.6 * span, 9)
    paths = []
    for line, side in enumerate((1.0, -1.0), start=1):
        n = len(s)
        p = side * thin * thick + (offset + 0.2 * span + s)[:, None] * normal
        frame = np.broadcast_to(side * thick, (n, 3)), np.broadcast_to(normal, (n, 3))
        rest = np.zeros((n, 3)), np.full((n, 4), half), np.full(n, 2 * thin)
        speed = np.full(n, cell.process.feed), np.full(n, cell.process.force)
        paths.append(BladePath(line, "convex" if side > 0 else "concave", p, *frame, s, *rest, *speed))
    return np.array(corners), paths
