"""Does anything hit: arm against wheel, floor and itself, holder and blade against wheel and floor, along a driven program.

Links are the robot's capsules, the wheel a cylinder, the holder a slender rod, the floor a plane across gravity: MuJoCo measures
their distances. Blade and wheel are looked at by points of the blade's surface, because an aerofoil is hollow and a hull of it is
not.
"""

from dataclasses import dataclass
from itertools import combinations

import mujoco
import numpy as np
import trimesh
from scipy.spatial.transform import Rotation

from ocp.model.cell import Cell
from ocp.simulate.twin.controller import Index
from ocp.simulate.twin.plan_knowledge import AWAY
from ocp.simulate.twin.truth import Truth
from robots.errors import Infeasible
from robots.pose import Array, invert
from trajectories.blade import Blade

NAMES = ("base", "column", "upper arm", "forearm", "wrist", "hand", "flange")
HZ, SLOW_HZ = 40.0, 10.0  # samples a second that are looked at on the way (20 mm at 0.8 m/s) and at the wheel
# The cell file does not describe the holder: a rod half-way from the flange to the held part of the blade stands for it.
HOLDER_RADIUS, HOLDER_SHARE = 0.025, 0.5
TOUCH = 5e-4  # m of blade inside the wheel that counts as a hit off contact
DEEP = 3e-3  # m beyond the planned interference, where blade and wheel are meant to touch
NEARBY = 0.02  # m between blade and wheel up to which their distance is told
POINTS = 2e-3  # m between points of the blade's surface
FAR = 2.0  # m; distances beyond are not measured out
REACH = 1.4  # m that a shape of a link reaches from its frame at most


@dataclass(frozen=True)
class WheelBody:
    """The wheel as it really stands: centre m, unit axis, base frame; radius, width m."""

    centre: Array
    axis: Array
    radius: float
    width: float


def true_wheel(cell: Cell, truth: Truth) -> WheelBody:
    """The cell's wheel as it stands."""
    axis = Rotation.from_rotvec(truth.wheel_axis_turn).apply(cell.wheel.axis)
    return WheelBody(
        cell.wheel.centre + truth.wheel_shift, np.asarray(axis), cell.wheel.radius + truth.wheel_radius, cell.wheel.width
    )


def refuse_hits(
    cell: Cell, blade: Blade, wheel: WheelBody, T_flange_blade: Array, links: Array, phase: Index, depth: Array, where: list[str]
) -> Array:
    """How deep (n,) m blade and undeformed wheel overlap, the flange at stroke 0; -inf where they are far from each other.

    Raises Infeasible, naming what hits what, where in the program and by how much.

    links (n, 7, 4, 4) of base and links; phase (n,) of the plan (`plan_knowledge`); depth (n,) m of interference planned; where
    (n,): each sample's place in words.
    """
    inside = _refuse_blade(blade, wheel, links[:, 6] @ T_flange_blade, phase, depth, where)
    scene = _Scene(cell, blade, wheel, T_flange_blade)
    turned = Rotation.from_matrix((links[1:, :, :3, :3] @ links[:-1, :, :3, :3].swapaxes(-1, -2)).reshape(-1, 3, 3)).magnitude()
    way = np.linalg.norm(np.diff(links[..., :3, 3], axis=0), axis=2) + REACH * turned.reshape(-1, 7)
    nearer = np.append(0.0, 2 * way.max(axis=1))
    for k in range(len(links)):
        found = scene.hit(links[k], nearer[k])
        if found is not None:
            a, b, by = found
            raise Infeasible(f"{where[k]}: {a} and {b} overlap by {1e3 * by:.1f} mm on the virtual cell; plan another way")
    return inside


def _refuse_blade(blade: Blade, wheel: WheelBody, T: Array, phase: Index, depth: Array, where: list[str]) -> Array:
    """The blade inside the wheel: not at all off contact, not much deeper than planned in contact. As `refuse_hits`."""
    points = surface_points(blade)
    middle = points.mean(axis=0)
    reach = float(np.linalg.norm(points - middle, axis=1).max()) + float(np.hypot(wheel.radius, wheel.width / 2))
    near = np.linalg.norm(T[:, :3, :3] @ middle + T[:, :3, 3] - wheel.centre, axis=1) < reach + NEARBY
    deepest = np.full(len(T), -np.inf)
    for k in np.flatnonzero(near):
        back = invert(T[k])
        centre, axis = back[:3, :3] @ wheel.centre + back[:3, 3], back[:3, :3] @ wheel.axis
        v = points - centre
        across = v @ axis
        inside = np.minimum(
            wheel.radius - np.sqrt(np.maximum((v * v).sum(axis=1) - across**2, 0)), wheel.width / 2 - np.abs(across)
        )
        worst = deepest[k] = float(inside.max())
        allowed = TOUCH if phase[k] == AWAY else DEEP + float(np.nan_to_num(depth[k]))
        if worst > allowed:
            x, y, z = 1e3 * points[int(np.argmax(inside))]
            raise Infeasible(
                f"{where[k]}: the blade is {1e3 * worst:.1f} mm inside the wheel at ({x:.0f}, {y:.0f}, {z:.0f}) mm of the blade "
                f"(allowed {1e3 * allowed:.1f} there) on the virtual cell; check the registration or plan another way"
            )
    return deepest


def surface_points(blade: Blade) -> Array:
    """Points (n, 3) m all over the surface, at most POINTS apart."""
    vertices, _ = trimesh.remesh.subdivide_to_size(blade.vertices, blade.faces, POINTS, max_iter=20)
    cell = np.floor(vertices / (0.5 * POINTS)).astype(np.int64)
    _, first = np.unique(cell, axis=0, return_index=True)
    return np.asarray(vertices[np.sort(first)])


def height_over_floor(cell: Cell, links: Array) -> Array:
    """Heights (n,) m of the arm's lowest moving point over the cell's floor, links (n, 7, 4, 4); inf where it gives none."""
    lowest, up = np.full(len(links), np.inf), -cell.robot.gravity_direction
    if cell.tables.floor is not None:
        for link, p0, p1, radius in cell.robot.link_shapes:
            for end in (p0, p1) if link >= 1 else ():
                lowest = np.minimum(lowest, (links[:, link, :3, :3] @ end + links[:, link, :3, 3]) @ up - radius)
        lowest = lowest - 1e-3 * cell.tables.floor.z_mm
    return lowest


class _Scene:
    """Shapes on frames that are put where the arm is; distances of the pairs that may meet."""

    def __init__(self, cell: Cell, blade: Blade, wheel: WheelBody, T_flange_blade: Array) -> None:
        spec = mujoco.MjSpec()
        bodies = [spec.worldbody.add_body(name=f"link{i}", mocap=True) for i in range(7)]
        geoms: list[tuple[str, str, int]] = []
        for i, (link, p0, p1, radius) in enumerate(cell.robot.link_shapes):
            _capsule(bodies[link], f"shape{i}", p0, p1, radius)
            geoms.append((f"shape{i}", NAMES[link], link))
        root = _root(cell, blade, T_flange_blade)
        end = HOLDER_SHARE * root
        length = float(np.linalg.norm(end))
        if length > 2 * HOLDER_RADIUS:
            _capsule(bodies[6], "holder", np.zeros(3), end * (1 - HOLDER_RADIUS / length), HOLDER_RADIUS)
            geoms.append(("holder", "the holder", 6))
        mesh = spec.add_mesh(name="blade")
        mesh.uservert, mesh.userface = blade.vertices.ravel(), blade.faces.ravel().astype(np.int32)
        turn = Rotation.from_matrix(T_flange_blade[:3, :3]).as_quat(scalar_first=True)
        bodies[6].add_geom(name="blade", type=mujoco.mjtGeom.mjGEOM_MESH, meshname="blade", pos=T_flange_blade[:3, 3], quat=turn)
        half = 0.5 * wheel.width * wheel.axis
        ends = [*wheel.centre - half, *wheel.centre + half]
        spec.worldbody.add_geom(name="wheel", type=mujoco.mjtGeom.mjGEOM_CYLINDER, size=[wheel.radius, 0, 0], fromto=ends)
        geoms += [("blade", "the blade", 6), ("wheel", "the wheel", -1)]
        if cell.tables.floor is not None:
            up, height = -cell.robot.gravity_direction, 1e-3 * cell.tables.floor.z_mm
            level = Rotation.align_vectors(up[None], [[0.0, 0.0, 1.0]])[0].as_quat(scalar_first=True)
            plane = mujoco.mjtGeom.mjGEOM_PLANE
            spec.worldbody.add_geom(name="floor", type=plane, size=[0, 0, 1], pos=height * up, quat=level)
            geoms.append(("floor", "the floor", -2))
        self._model = spec.compile()
        self._data = mujoco.MjData(self._model)
        number = {g: mujoco.mj_name2id(self._model, mujoco.mjtObj.mjOBJ_GEOM, g[0]) for g in geoms}
        self._pairs = [(number[a], number[b], a[1], b[1]) for a, b in combinations(geoms, 2) if _may_meet(a, b)]
        self._gap = np.zeros(len(self._pairs))

    def hit(self, frames: Array, nearer: float) -> tuple[str, str, float] | None:
        """The first pair that overlaps, and by how much (m), with the links at frames (7, 4, 4).

        nearer: m by which any two shapes may have come nearer since the frames before; pairs still apart are not measured.
        """
        self._gap -= nearer
        due = np.flatnonzero(self._gap <= 0)
        if not len(due):
            return None
        self._data.mocap_pos[:] = frames[:, :3, 3]
        self._data.mocap_quat[:] = Rotation.from_matrix(frames[:, :3, :3]).as_quat(scalar_first=True)
        mujoco.mj_kinematics(self._model, self._data)
        for i in due:
            a, b, first, second = self._pairs[i]
            self._gap[i] = mujoco.mj_geomDistance(self._model, self._data, a, b, FAR, None)
            if self._gap[i] < 0:
                return first, second, -float(self._gap[i])
        return None


def _capsule(body: "mujoco.MjsBody", name: str, p0: Array, p1: Array, radius: float) -> None:
    if np.linalg.norm(np.asarray(p1) - p0) < 1e-6:
        body.add_geom(name=name, type=mujoco.mjtGeom.mjGEOM_SPHERE, size=[radius, 0, 0], pos=p0)
    else:
        body.add_geom(name=name, type=mujoco.mjtGeom.mjGEOM_CAPSULE, size=[radius, 0, 0], fromto=[*p0, *p1])


def _root(cell: Cell, blade: Blade, T_flange_blade: Array) -> Array:
    """Middle of the held part, flange frame."""
    held = blade.vertices[blade.vertices @ cell.workpiece.clamp_normal < cell.workpiece.clamp_offset]
    middle = (held if len(held) else blade.vertices).mean(axis=0)
    return np.asarray(T_flange_blade[:3, :3] @ middle + T_flange_blade[:3, 3])


def _may_meet(a: tuple[str, str, int], b: tuple[str, str, int]) -> bool:
    """Neighbours overlap by construction, base and wheel stand, blade and wheel are looked at elsewhere."""
    names, carried = {a[0], b[0]}, {"holder", "blade"}
    if "floor" in names:
        return max(a[2], b[2]) >= 1
    if "wheel" in names:
        return "blade" not in names and max(a[2], b[2]) >= 1
    if names == carried:
        return False
    if names & carried:
        return min(a[2], b[2]) <= 3
    return abs(a[2] - b[2]) >= 4
