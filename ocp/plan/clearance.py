"""What must stay free: arm, holder, blade, wheel and floor apart, and the blade off the wheel but for the planned contact.

Distances are coal's on simple convex shapes. In contact the pair of blade and wheel is judged by the surface itself
(`find_secondary_contact`): does the blade touch the wheel anywhere else than the contact model thinks?
"""

import itertools
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import coal
import numpy as np
from numpy.typing import NDArray

from ocp.model.blade_gap import REACH
from ocp.model.cell import Cell, Wheel
from ocp.plan.rules import (
    ARM_MARGIN,
    BLADE_MARGIN,
    FLOOR_BELOW_WHEEL,
    HOLDER_RADIUS,
    HOLDER_SHARE,
    SECONDARY_CONTACT_TOLERANCE,
    UPRIGHT,
)
from robots.errors import BadInput
from robots.kinematics import link_frames
from robots.pose import Array, apply, invert

BASE_PLANE = "plane of the base"
FLAT = 1e-5  # of a blade's size, a micrometre: thinner than that it is a sheet, which numbers of a file make rough
SPARE = 1e-4  # m; distances between shapes are iterated to a hundredth of it
SLACK = 1e-6  # m by which a first look takes more points than count; products of lengths below 10 m are good to 1e-8
SLANT = np.radians(60.0)  # of the other rays from a facet off its normal
ALIKE, ALIKE_NORMAL = 5e-4, 0.25  # m, 1: size of the cells of place and of unit normal in which facets are alike
RAY_START = 2e-4  # m off the facet, so that a ray does not meet its own neighbours


@dataclass(frozen=True)
class Body:
    """A convex shape fixed to a frame: 0..6 = base and links, 7 = wheel and floor (base frame), 6 = flange side."""

    name: str
    frame: int
    shape: coal.CollisionGeometry
    placement: Array

    @cached_property
    def ball(self) -> tuple[Array, float]:
        """Centre (3,) m in the body's frame and radius m of a ball about it; without end for a half space."""
        if isinstance(self.shape, coal.Halfspace):
            return np.zeros(3), np.inf
        self.shape.computeLocalAABB()
        return apply(self.placement, np.asarray(self.shape.aabb_center, float).ravel()), float(self.shape.aabb_radius)


@dataclass(frozen=True)
class BodyPair:
    """Two bodies that must stay `margin` apart; `off_contact` pairs are skipped while grinding."""

    a: int
    b: int
    margin: float
    off_contact: bool = False


@dataclass(frozen=True)
class Clearance:
    """Smallest distance minus margin over a path: value (m), where in the path, between which bodies."""

    value: float
    index: int
    names: tuple[str, str]

    def sentence(self) -> str:
        """Tell it to a user."""
        gap = "overlap" if self.value < 0 else "stay free"
        return f"{self.names[0]} and {self.names[1]} {gap} by {abs(self.value) * 1e3:.1f} mm against the margin"


class CollisionScene:
    """Collision geometry of a cell with a blade; distances of whole joint paths."""

    def __init__(self, cell: Cell, blade_vertices: Array) -> None:
        """`blade_vertices` (n, 3) m in the blade frame."""
        self.cell, self._vertices = cell, blade_vertices
        self._bodies = _bodies(cell, blade_vertices)
        self._pairs = _pairs(self._bodies)
        self._latest: dict[tuple[bytes, bool], tuple[Array, list[tuple[str, str]]]] = {}

    def __reduce__(self) -> tuple[Any, ...]:
        return CollisionScene, (self.cell, self._vertices)

    @cached_property
    def _balls(self) -> tuple[list[int], Array, Array, Array]:
        """Of all bodies: frame, placement (b, 4, 4) in it, centre (b, 3) and radius (b,) m of the ball about it."""
        bodies = self._bodies
        middle, radius = (np.array([body.ball[k] for body in bodies]) for k in (0, 1))
        return [body.frame for body in bodies], np.array([body.placement for body in bodies]), middle, radius

    def clearances(self, q: Array, in_contact: bool) -> tuple[Array, list[tuple[str, str]]]:
        """Distance minus margin of the closest pair at joints q (n, 6): values (n,) m and the bodies' names. Those asked for last
        are at hand: what a pass is solved at is what it is judged at."""
        key = np.asarray(q, float).tobytes(), in_contact
        if key not in self._latest:
            values, names = self._measured(q, in_contact)
            values.flags.writeable = False
            self._latest = {key: (values, names)}
        return self._latest[key]

    def _measured(self, q: Array, in_contact: bool) -> tuple[Array, list[tuple[str, str]]]:
        request = coal.DistanceRequest()
        request.enable_signed_distance = True
        frame, placement, *_ = self._balls
        links = link_frames(self.cell.robot, np.atleast_2d(q))
        frames = np.concatenate([links, np.broadcast_to(np.eye(4), (len(links), 1, 4, 4))], axis=1)[:, frame]
        pairs = [p for p in self._pairs if not (in_contact and p.off_contact)]
        least, poses = self._least(frames, pairs), frames @ placement
        values, names = np.full(len(frames), np.inf), [("", "")] * len(frames)
        for k, nearest in enumerate(np.argsort(least, axis=1, kind="stable")):
            placed: dict[int, coal.Transform3s] = {}
            closest = -1
            for j in nearest:
                if least[k, j] > values[k] + SPARE:
                    break
                pair = pairs[j]
                for i in (pair.a, pair.b):
                    if i not in placed:
                        placed[i] = coal.Transform3s(poses[k, i, :3, :3], poses[k, i, :3, 3])
                a, b = self._bodies[pair.a], self._bodies[pair.b]
                gap = coal.distance(a.shape, placed[pair.a], b.shape, placed[pair.b], request, coal.DistanceResult())
                if (gap - pair.margin, j) < (values[k], closest):
                    values[k], names[k], closest = gap - pair.margin, (a.name, b.name), j
        return values, names

    def _least(self, frames: Array, pairs: list[BodyPair]) -> Array:
        """What distance minus margin (n, pairs) m cannot be less than, by the balls about the bodies, for their frames
        (n, bodies, 4, 4)."""
        _, _, middle, radius = self._balls
        centre = apply(frames, middle)
        a, b = np.array([(pair.a, pair.b) for pair in pairs]).T
        reach = radius[a] + radius[b] + np.array([pair.margin for pair in pairs])
        return np.asarray(np.linalg.norm(centre[:, a] - centre[:, b], axis=2) - reach)

    def clearance(self, q: Array, in_contact: bool) -> Clearance:
        """The smallest of `clearances` over joints q (n, 6); negative means that a margin is broken."""
        values, names = self.clearances(q, in_contact)
        k = int(np.argmin(values))
        return Clearance(float(values[k]), k, names[k])

    def gradient(self, q: Array, in_contact: bool) -> Array:
        """Derivative (6,) m/rad of the clearance at one posture q (6,), by central differences of the distances."""
        step = 1e-4
        values, _ = self.clearances(q + step * np.vstack([np.eye(6), -np.eye(6)]), in_contact)
        return (values[:6] - values[6:]) / (2 * step)

    def off_wheel(self, T_base_blade: Array) -> Array:
        """Distance minus BLADE_MARGIN (n,) m of blade and holder from the wheel at blade poses (n, 4, 4)."""
        request, flange = coal.DistanceRequest(), flange_pose(self.cell, T_base_blade)
        request.enable_signed_distance = True
        (wheel,) = (body for body in self._bodies if body.name == "wheel")
        carried = [body for body in self._bodies if body.name in ("blade", "holder")]
        fixed = coal.Transform3s(wheel.placement[:3, :3], wheel.placement[:3, 3])
        values = np.full(len(flange), np.inf)
        for k, T in enumerate(flange):
            for body in carried:
                at = T @ body.placement
                placed = coal.Transform3s(at[:3, :3], at[:3, 3])
                gap = coal.distance(body.shape, placed, wheel.shape, fixed, request, coal.DistanceResult())
                values[k] = min(values[k], gap - BLADE_MARGIN)
        return values


def _bodies(cell: Cell, vertices: Array) -> list[Body]:
    names = ("base", "column", "upper arm", "forearm", "wrist", "hand", "flange")
    bodies = []
    for link, p0, p1, radius in cell.robot.link_shapes:
        placement, length = _between(np.asarray(p0, float), np.asarray(p1, float))
        shape = coal.Capsule(float(radius), length) if length > 1e-6 else coal.Sphere(float(radius))
        bodies.append(Body(names[link], link, shape, placement))
    T = cell.workpiece.T_flange_blade
    n, offset = cell.workpiece.clamp_normal, cell.workpiece.clamp_offset
    held = vertices[vertices @ n < offset]
    held = held if len(held) else vertices
    root = T[:3, :3] @ held.mean(axis=0) + T[:3, 3]
    placement, length = _between(np.zeros(3), HOLDER_SHARE * root)
    bodies.append(Body("holder", 6, coal.Capsule(HOLDER_RADIUS, max(length - HOLDER_RADIUS, 1e-3)), placement))
    middle = vertices - vertices.mean(axis=0)
    across = np.ptp(middle @ np.linalg.eigh(middle.T @ middle)[1], axis=0)
    if not across.min() > FLAT * across.max():  # coal ends the process
        raise BadInput(f"{cell.workpiece.stl}: the blade's points lie in a plane; give a solid")
    points = coal.StdVec_Vec3s()
    points.extend(list(np.asarray(vertices, float)))
    bodies.append(Body("blade", 6, coal.Convex.convexHull(points, False, ""), T))
    R = _frame_with_z(cell.wheel.axis)
    wheel_placement = np.eye(4)
    wheel_placement[:3, :3], wheel_placement[:3, 3] = R, cell.wheel.centre
    bodies.append(Body("wheel", 7, coal.Cylinder(cell.wheel.radius, cell.wheel.width), wheel_placement))
    if cell.floor is not None:
        bodies.append(Body("floor", 7, coal.Halfspace(cell.up, cell.floor), np.eye(4)))
    if cell.floor is None or cell.up[2] < UPRIGHT:
        # The robot's base plane, or just below the wheel where that hangs lower (a pedestal).
        plane = min(0.0, float(cell.wheel.centre[2]) - cell.wheel.radius - FLOOR_BELOW_WHEEL)
        bodies.append(Body(BASE_PLANE, 7, coal.Halfspace(np.array([0.0, 0.0, 1.0]), plane), np.eye(4)))
    return bodies


def _pairs(bodies: list[Body]) -> list[BodyPair]:
    pairs = []
    for (i, a), (j, b) in itertools.combinations(enumerate(bodies), 2):
        kinds = {a.name, b.name}
        if a.frame == b.frame == 7:
            continue
        if "wheel" in kinds and kinds & {"blade", "holder"}:
            pairs.append(BodyPair(i, j, BLADE_MARGIN, off_contact="blade" in kinds))
            continue
        margin = ARM_MARGIN
        if "wheel" in kinds:
            meet = a.frame >= 1
        elif "floor" in kinds:
            # Over an upright base the column keeps its height, which may be less than the margin.
            meet, margin = a.frame >= 1, 0.0 if a.frame == 1 else ARM_MARGIN
        else:
            meet = a.frame >= 2 if BASE_PLANE in kinds else _far_apart(a, b)
        if meet:
            pairs.append(BodyPair(i, j, margin))
    return pairs


def _far_apart(a: Body, b: Body) -> bool:
    """Bodies of the arm that can meet: four joints apart (the wrist cannot fold onto the
    forearm), or the workpiece and anything up to the forearm."""
    carried = {"holder", "blade"}
    if a.name in carried or b.name in carried:
        return min(a.frame, b.frame) <= 3
    return abs(a.frame - b.frame) >= 4


def _between(p0: Array, p1: Array) -> tuple[Array, float]:
    """Placement of a z-aligned shape from p0 to p1, and its length."""
    axis, length = p1 - p0, float(np.linalg.norm(p1 - p0))
    T = np.eye(4)
    T[:3, 3] = 0.5 * (p0 + p1)
    if length > 1e-9:
        T[:3, :3] = _frame_with_z(axis / length)
    return T, length


def _frame_with_z(z: Array) -> Array:
    x = np.eye(3)[int(np.argmin(np.abs(z)))]
    x = x - z * (z @ x)
    x /= np.linalg.norm(x)
    (a, b, c), (d, e, f) = z.tolist(), x.tolist()  # their product of vectors by NumPy takes longer than all else here
    return np.array([[d, b * f - c * e, a], [e, c * d - a * f, b], [f, a * e - b * d, c]])


def enclosed(vertices: Array, faces: NDArray[np.int64], which: NDArray[np.int64]) -> NDArray[np.bool_]:
    """Of the facets `which` of a closed mesh (vertices (nv, 3) m, faces (nf, 3) turned outward) those that see nothing but the
    part itself, along their normal and slanting off it to six sides: walls of cavities, bores and slots.

    A wheel that touches a facet has its own radius of free room along that facet's normal. Facets of one direction within
    ALIKE of each other see the same: one of them is asked.
    """
    mesh, corners = coal.BVHModelOBBRSS(), coal.StdVec_Vec3s()
    corners.extend(list(np.asarray(vertices, float)))
    triangles = coal.StdVec_Triangle()
    triangles.extend([coal.Triangle(*map(int, face)) for face in faces])
    mesh.beginModel(len(faces), len(vertices))
    mesh.addSubModel(corners, triangles)
    mesh.endModel()
    length = float(np.linalg.norm(np.ptp(vertices, axis=0)))
    ray, request, here = coal.Capsule(1e-6, length), coal.CollisionRequest(), coal.Transform3s()

    def meets(start: Array, direction: Array) -> bool:
        placed = coal.Transform3s(_frame_with_z(direction), start + (RAY_START + 0.5 * length) * direction)
        return bool(coal.collide(mesh, here, ray, placed, request, coal.CollisionResult()))

    a, b, c = (vertices[faces[which, i]] for i in range(3))
    normal = np.cross(b - a, c - a)
    normal /= np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-30)
    turns, middles = np.radians(np.arange(0.0, 360.0, 60.0)), (a + b + c) / 3.0
    like = np.round(np.hstack([middles / ALIKE, normal / ALIKE_NORMAL])).astype(np.int64)
    _, first, group = np.unique(like, axis=0, return_index=True, return_inverse=True)
    found = np.zeros(len(first), bool)
    for k, (middle, n) in enumerate(zip(middles[first], normal[first], strict=True)):
        if not np.any(n) or not meets(middle, n):
            continue
        x, y, _ = _frame_with_z(n).T
        around = (np.cos(SLANT) * n + np.sin(SLANT) * (np.cos(turn) * x + np.sin(turn) * y) for turn in turns)
        found[k] = all(meets(middle, direction) for direction in around)
    return np.asarray(found[group.reshape(-1)])


def flange_pose(cell: Cell, T_base_blade: Array) -> Array:
    """T_base_flange (..., 4, 4) that puts the blade at T_base_blade."""
    return np.asarray(T_base_blade @ invert(cell.workpiece.T_flange_blade))


@dataclass(frozen=True)
class SecondaryContact:
    """Deepest unplanned overlap on a path: depth (m), waypoint index, distance (m) of that point from the contact, how far along
    the wheel's axis it lies from the wheel's middle (m); of every waypoint the depth, depths (n,) m."""

    depth: float
    index: int
    distance: float
    lateral: float
    depths: Array


def find_secondary_contact(
    cell: Cell, points: Array, T_base_blade: Array, contact: Array, curvature: Array, tilt: Array, delta: Array
) -> SecondaryContact:
    """Deepest overlap beyond the local quadratic of each contact.

    points (m, 3) of the blade's surface, blade frame: what lies within the reach of the direct contact is left to it;
    T_base_blade (n, 4, 4); contact (n, 3) planned points in the blade frame; curvature (n, 3) kxx, kyy, kxy relative;
    tilt (n, 2); delta (n,) m. Frames: docs/architecture.md.
    """
    wheel = cell.wheel
    worst, depths = (0.0, 0, 0.0, 0.0), np.zeros(len(T_base_blade))
    square, reach = np.einsum("ij,ij->i", points, points), 0.9 * REACH
    for k, T in enumerate(T_base_blade):
        # Products with the wheel's axis and centre and with the contact leave few points to look at.
        axis, centre = T[:3, :3].T @ wheel.axis, T[:3, :3].T @ (wheel.centre - T[:3, 3])
        beside, off, away = (points @ np.column_stack([axis, centre, contact[k]])).T
        beside = beside - centre @ axis
        near = np.abs(beside) <= 0.5 * wheel.width + SLACK
        near &= square - 2.0 * away + contact[k] @ contact[k] >= (reach - SLACK) ** 2
        near &= square - 2.0 * off + centre @ centre - beside**2 < (wheel.radius - SECONDARY_CONTACT_TOLERANCE + SLACK) ** 2
        if not near.any():
            continue
        lateral, radial, rho = wheel.cylindrical(apply(T, np.vstack([points[near], contact[k]])))
        depth = wheel.radius - rho
        seen = np.linalg.norm(points[near] - contact[k], axis=1) < reach
        near = (np.abs(lateral[:-1]) <= 0.5 * wheel.width) & (depth[:-1] > SECONDARY_CONTACT_TOLERANCE) & ~seen
        if not near.any():
            continue
        e = radial[-1] / np.linalg.norm(radial[-1])
        x = (radial[:-1][near]) @ np.cross(wheel.axis, e)
        y = lateral[:-1][near] - lateral[-1]
        gap = tilt[k, 0] * x + tilt[k, 1] * y
        gap += 0.5 * (curvature[k, 0] * x**2 + 2 * curvature[k, 2] * x * y + curvature[k, 1] * y**2)
        beyond = depth[:-1][near] - np.maximum(delta[k] - gap, 0.0)
        i = int(np.argmax(beyond))
        depths[k] = max(float(beyond[i]), 0.0)
        if beyond[i] > worst[0]:
            worst = (float(beyond[i]), k, float(np.hypot(x[i], y[i])), float(lateral[:-1][near][i]))
    return SecondaryContact(*worst, depths)


def wheel_room(wheel: Wheel, points: Array, T_base_blade: Array) -> Array:
    """Least distance (n,) m of points (k, 3) m of the blade from the wheel, a cylinder, at poses T_base_blade (n, 4, 4); zero or
    less inside, inf without points."""
    room = np.full(len(T_base_blade), np.inf)
    if not len(points):
        return room
    for k, T in enumerate(T_base_blade):
        lateral, _, rho = wheel.cylindrical(apply(T, points))
        beside, off = np.abs(lateral) - 0.5 * wheel.width, rho - wheel.radius
        room[k] = np.where((beside > 0) & (off > 0), np.hypot(beside, off), np.maximum(beside, off)).min()
    return room
