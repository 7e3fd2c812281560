"""Whether the tracker's beam reaches a reflector: segments against the capsules of the arm and against the wheel."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ocp.model.cell import Wheel
from robots.kinematics import link_frames
from robots.pose import Array, apply
from robots.robot import Robot
from robots.tracker_readings import Nest

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
