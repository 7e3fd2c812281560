"""Postures in which a reading could be taken: inside the limits, free of collisions, strong enough, seen by the tracker.

The grinding zone, in which the blade is ground, is where a calibration has to be right, and near which many poses are tried.
Whether the tracker's beam reaches a reflector: segments against the capsules of the arm and against the wheel.
"""

from dataclasses import dataclass

import coal
import numpy as np
from numpy.typing import NDArray

from ocp.model.cell import Cell, Wheel
from ocp.plan.clearance import Body, BodyPair, CollisionScene, _between, flange_pose
from ocp.plan.passes.posture import contact_poses
from ocp.plan.paths import PlanOptions, lay_paths
from ocp.plan.rules import ARM_MARGIN
from ocp.poses.rules import AXIS_MARGIN, BRACKET_RADIUS, HOLDING_SHARE, WRIST_RANGE
from robots.errors import Infeasible
from robots.gravity import weight_torques
from robots.inverse import inverse_branches
from robots.kinematics import link_frames
from robots.pose import Array, apply, make_transform, rotation_from_abc
from robots.robot import Robot
from robots.tracker_readings import Hanging, Nest
from trajectories.passes import BladePath

Mask = NDArray[np.bool_]

BEAM = 0.010  # m, half a beam with its room: what passes closer to a body is taken to be blocked
BALL = 0.040  # m before the reflector's centre that its own nest and ball take


@dataclass(frozen=True)
class Rod:
    """A capsule fixed to link `link` that blocks the beam: ends (3,) m in the link's frame, radius m."""

    link: int
    start: Array
    end: Array
    radius: float


@dataclass(frozen=True)
class Sight:
    """What lets a reading be taken: reach (shortest, longest) m, acceptance rad of the reflector about its nest's direction
    or None; `rods` besides the arm's own capsules."""

    reach: tuple[float, float] = (1.0, 20.0)
    acceptance: float | None = None
    rods: tuple[Rod, ...] = ()


def blade_rod(T_flange_blade: Array, vertices: Array) -> Rod:
    """The rod about a blade with vertices (n, 3) m in its own frame, along its longest direction."""
    points = apply(T_flange_blade, vertices)
    centre = points.mean(axis=0)
    axis = np.linalg.svd(points - centre, full_matrices=False)[2][0]
    along = (points - centre) @ axis
    radius = np.linalg.norm(points - centre - along[:, None] * axis, axis=1).max()
    low, high = min(along.min() + radius, 0.0), max(along.max() - radius, 0.0)
    return Rod(6, centre + low * axis, centre + high * axis, float(radius))


def visible(robot: Robot, wheel: Wheel, sight: Sight, nest: Nest, tracker: Array, q: Array) -> Mask:
    """Which postures q (n, 6) let a tracker head at (3,) m in the base frame see a nest."""
    assert nest.place is not None
    frames = link_frames(robot, q)
    ball = apply(frames[:, nest.link], nest.place)
    beam = ball - tracker
    distance = np.linalg.norm(beam, axis=1)
    ok = (distance >= sight.reach[0]) & (distance <= sight.reach[1])
    if sight.acceptance is not None:
        out = frames[:, nest.link, :3, :3] @ nest_direction(nest)
        ok &= np.einsum("ij,ij->i", out, -beam) >= np.cos(sight.acceptance) * distance
    end = tracker + beam * np.maximum(1.0 - BALL / np.maximum(distance, BALL), 0.0)[:, None]
    bodies = [Rod(link, a, b, r) for link, a, b, r in robot.link_shapes]
    for rod in (*bodies, *sight.rods):
        a, b = apply(frames[:, rod.link], rod.start), apply(frames[:, rod.link], rod.end)
        inside = segment_distance(ball, ball, a, b) < rod.radius  # the nest is bolted to this very body
        ok &= inside | (segment_distance(np.broadcast_to(tracker, end.shape), end, a, b) > rod.radius + BEAM)
    return np.asarray(ok & ~meets_wheel(wheel, tracker, end))


def nest_direction(nest: Nest) -> Array:
    """Where a nest is taken to look (3,), in its link's frame: away from the link's z axis; along it if it sits on it."""
    assert nest.place is not None
    across = nest.place * np.array([1.0, 1.0, 0.0])
    length = float(np.linalg.norm(across))
    return across / length if length > 1e-3 else np.array([0.0, 0.0, 1.0])


def segment_distance(p0: Array, p1: Array, q0: Array, q1: Array) -> Array:
    """Shortest distance (n,) m between segments p0 p1 and q0 q1 (n, 3), which may be points.

    Closest points of the two lines, clamped to one segment after the other (Ericson, Real-Time Collision Detection, 5.1.9).
    """
    u, v, w = p1 - p0, q1 - q0, p0 - q0
    a, e, f = _dot(u, u), _dot(v, v), _dot(v, w)
    b, c = _dot(u, v), _dot(u, w)
    tiny = 1e-18
    denominator = a * e - b * b
    s = np.where(denominator > tiny, np.clip((b * f - c * e) / np.maximum(denominator, tiny), 0.0, 1.0), 0.0)
    t = np.where(e > tiny, (b * s + f) / np.maximum(e, tiny), 0.0)
    clamped = np.clip(t, 0.0, 1.0)
    s = np.where(a > tiny, np.clip((b * clamped - c) / np.maximum(a, tiny), 0.0, 1.0), 0.0)
    return np.asarray(np.linalg.norm(w + u * s[:, None] - v * clamped[:, None], axis=1))


def meets_wheel(wheel: Wheel, start: Array, end: Array) -> Mask:
    """Which segments from start (3,) to end (n, 3) pass through the wheel's cylinder, widened by BEAM."""
    u = end - start
    along, offset = u @ wheel.axis, float((start - wheel.centre) @ wheel.axis)
    half = 0.5 * wheel.width + BEAM
    with np.errstate(divide="ignore", invalid="ignore"):
        ends = np.stack([(-half - offset) / along, (half - offset) / along])
    flat = np.abs(along) < 1e-12
    low = np.where(flat, 0.0 if abs(offset) <= half else 2.0, np.clip(ends.min(axis=0), 0.0, None))
    high = np.where(flat, 1.0, np.clip(ends.max(axis=0), None, 1.0))
    ru = u - along[:, None] * wheel.axis
    r0 = (start - wheel.centre) - offset * wheel.axis
    nearest = np.clip(-(ru @ r0) / np.maximum(_dot(ru, ru), 1e-18), low, np.maximum(high, low))
    radial = np.linalg.norm(r0 + nearest[:, None] * ru, axis=1)
    return np.asarray((low <= high) & (radial < wheel.radius + BEAM))


def _dot(a: Array, b: Array) -> Array:
    return np.asarray(np.einsum("ij,ij->i", a, b))


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
        laid = lay_paths(cell, stl, PlanOptions(step=STEP, even=False))
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
        rest = np.zeros((n, 3)), np.full((n, 4), half)
        speed = np.full(n, cell.process.feed), np.full(n, cell.process.force)
        paths.append(BladePath(line, "convex" if side > 0 else "concave", p, *frame, s, *rest, *speed))
    return np.array(corners), paths


RANDOM, NEAR = 2000, 1000  # postures tried: anywhere, and with the blade near the wheel
# m from the robot and above the floor (unknown: on the arm's side of the base): where the tracker is taken to stand
STAND = (3.5, 1.5)
AZIMUTHS = 24
SAMPLE = 600  # postures on which stands are compared


@dataclass(frozen=True)
class CandidatePoses:
    """Postures q (m, 6) rad with the signs (m, 6) of their first approach, `near` (m,) those close to the wheel, `seen` (m, k)
    which of the k nests the tracker sees."""

    q: Array
    sign: Array
    near: Mask
    seen: Mask


def free_postures(
    cell: Cell, scene: CollisionScene, blade: GroundBlade, payloads: list[Hanging], approach: float, rng: np.random.Generator
) -> tuple[Array, Array, Mask]:
    """Postures (m, 6) rad, the signs (m, 6) of their first approach, and which are near the wheel.

    They are free from `approach` rad before to as much behind on every axis. The signs are drawn at random, so that what
    backlash does in one axis is not mistaken for another's. Raises Infeasible: hardly any posture is free.
    """
    robot = cell.robot
    margin = AXIS_MARGIN + approach
    low, high = robot.q_min + margin, robot.q_max - margin
    wrist = np.array([np.inf, np.inf, np.inf, WRIST_RANGE, np.inf, WRIST_RANGE])
    anywhere = rng.uniform(np.maximum(low, -wrist), np.minimum(high, wrist), (RANDOM, 6))
    close = near_zone(cell, blade, NEAR, rng)
    q, near = np.vstack([anywhere, close]), np.arange(RANDOM + len(close)) >= RANDOM
    ok = ((q >= low) & (q <= high)).all(axis=1)
    for load in payloads:
        torque = weight_torques(robot, q, load.mass, load.com)
        ok &= (np.abs(torque) <= HOLDING_SHARE * robot.torque_max).all(axis=1)
    q, near = q[ok], near[ok]
    sign = rng.choice([-1.0, 1.0], q.shape)
    free = np.ones(len(q), bool)
    for part in (0.0, -1.0, 1.0, -0.5, 0.5):
        rows = np.flatnonzero(free)
        free[rows] = scene.clearances(q[rows] + part * approach * sign[rows], in_contact=False)[0] >= 0
    if free.sum() < 10:
        raise Infeasible(
            f"only {int(free.sum())} of {len(q)} postures tried are free of collisions; check wheel, workpiece and targets "
            f"of {cell.path.name}"
        )
    return q[free], sign[free], near[free]


def visible_nests(cell: Cell, sight: Sight, nests: list[Nest], tracker: Array, q: Array) -> Mask:
    """Which nests (n, k) a tracker at (3,) m sees at postures q (n, 6)."""
    return np.stack([visible(cell.robot, cell.wheel, sight, nest, tracker, q) for nest in nests], axis=1)


def choose_stand(cell: Cell, sight: Sight, nests: list[Nest], q: Array, rng: np.random.Generator) -> Array:
    """The tracker's place (3,) m around the robot, `STAND` away, from which most readings of postures q (n, 6) are seen."""
    sample = q if len(q) <= SAMPLE else q[rng.choice(len(q), SAMPLE, replace=False)]
    angle = 2 * np.pi * np.arange(AZIMUTHS) / AZIMUTHS
    up = cell.up
    across = np.eye(3)[0 if abs(up[0]) < 0.9 else 1]
    across = across - up * (up @ across)
    across /= np.linalg.norm(across)
    height = STAND[1] * up[2] if cell.floor is None else cell.floor + STAND[1]
    stands = STAND[0] * (np.outer(np.cos(angle), across) + np.outer(np.sin(angle), np.cross(up, across))) + height * up
    counts = [int(visible_nests(cell, sight, nests, stand, sample).sum()) for stand in stands]
    return np.asarray(stands[int(np.argmax(counts))])


class MeasuringScene(CollisionScene):
    """A `CollisionScene` with a rod from the flange to every nest it carries; rods may meet column, arm, wheel and floor.

    Nests on other links are taken to sit close to them.
    """

    def __init__(self, cell: Cell, blade_vertices: Array, nests: dict[str, Nest]) -> None:
        """`blade_vertices` (n, 3) m in the blade frame; `nests` by name."""
        super().__init__(cell, blade_vertices)
        fixed = list(range(len(self._bodies)))
        for name, nest in nests.items():
            if nest.link != 6 or nest.place is None:
                continue
            placement, length = _between(np.zeros(3), nest.place)
            self._bodies.append(Body(f"reflector {name}", 6, coal.Capsule(BRACKET_RADIUS, max(length, 1e-3)), placement))
            mine = len(self._bodies) - 1
            for i in fixed:
                if self._bodies[i].frame <= 3 or self._bodies[i].frame == 7:
                    self._pairs.append(BodyPair(i, mine, ARM_MARGIN))
