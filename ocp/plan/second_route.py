"""The force of a written program by a second route, sharing nothing with the model that planned it but the rule by which contacts
between neighbours that tell them are left out.

Joints come from the text read back and interpolated as a controller would; kinematics are elementary motions in NumPy,
gravity torques Pinocchio's at the converged bent posture, Jacobians finite differences, and the wheel contact is the
Signorini problem solved directly instead of the table. Of a cell's effects the formulas are the library's, the numbers that go
into them are this route's.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline, PchipInterpolator, interp1d

from ocp.contact.wheel.cover import Cover
from ocp.contact.wheel.signorini import Contact, LocalShape, solve_force
from ocp.effects.engine.evaluate import (
    ARM_LAYOUT,
    CONTACT_LAYOUT,
    ArmPlace,
    ArmRows,
    ContactPlace,
    added_overlap,
    arm_shift,
    loaded,
)
from ocp.model.blade_gap import SurfaceCloud, SurfaceShape, contact_stations, solved_where_needed, surface_shape
from ocp.model.cell import Cell
from ocp.plan.rules import FLANGE_FORCE_TOLERANCE, RIGID_FORCE_TOLERANCE
from robots.gravity import GRAVITY
from robots.pose import Array, apply
from robots.reference_kinematics import elementary_forward, elementary_frames
from robots.rigid_body import inverse_dynamics
from robots.robot import Robot
from trajectories.passes import BladePath

FIXED_POINT_STEPS = 4
DIFFERENCE = 1e-6  # rad, central differences of the contact point
STATION_SPACING = 2.8e-3  # m between contacts solved; not the planner's stations
FORCE_SPACING = 1.0  # N between contacts solved where the planned force changes
STATION_MISS = 0.05  # of what the force may be off by: a contact is left out between two where it adds no more than that
FORCE_STEPS = 8  # Newton steps on the force at a station, until one is below the next line; two do where nothing turns over
PROBE = 0.05  # N, over which the change of what effects add is taken
LEAST_RATE = 0.2  # of the chain's m/N without effects: none makes it stiffer than that
FORCE_STEP_ENOUGH = 0.1  # N; the law is so smooth that what is left after it is below 1e-3 N


@dataclass(frozen=True)
class BelievedRobot:
    """The arm as the second route takes it, by value: calibrated MD-H, compliance (6,) rad/(N m), payload kg and m."""

    robot: Robot
    compliance: Array
    payload_mass: float
    payload_com: Array

    def torque(self, q: Array) -> Array:
        """Load torque (m, 6) N m of weight at postures q (m, 6), positive along +q."""
        still = np.zeros_like(q)
        return -np.asarray(inverse_dynamics(self.robot, self.payload_mass, self.payload_com, q, still, still))

    def bending(self, cell: Cell) -> Array:
        """Compliance (6,) rad/(N m) of the joints that bend under weight, zero of the others."""
        return self.compliance * np.array([float(j in cell.compliant_joints) for j in range(1, 7)])


def believed_robot(cell: Cell, mdh: Array, compliance: Array, payload_mass: float, payload_com: Array) -> BelievedRobot:
    """The cell's robot with calibrated MD-H (6, 5)."""
    return BelievedRobot(replace(cell.robot, mdh=mdh), compliance, payload_mass, payload_com)


@dataclass(frozen=True)
class VerifiedPass:
    """Force (m,) N along a pass at times (m,) s, arc length s (m,) m, and the one that was planned; interference (m,) m; force
    up to which the flange stands at its outer stop, where nothing of it yields, zero without one."""

    time: Array
    s: Array
    force: Array
    delta: Array
    planned: Array
    stopped: Array


def verify_pass(
    cell: Cell,
    believed: BelievedRobot,
    cover: Cover,
    cloud: SurfaceCloud,
    path: BladePath,
    compliance: Array,
    time: Array,
    q: Array,
    s: Array,
    conditions: Mapping[str, Array] | None = None,
    planned: Array | None = None,
) -> VerifiedPass:
    """Force along a pass whose joints q (m, 6) at `time` (m,) were read back; the contact is planned at arc length s (m,).

    `compliance` (n, 3) m/N is the blade's in (n, t, b) at the waypoints of `path`; `planned` (m,) N: the force that is
    meant there, by default the path's; `conditions`: what the cell's effects
    depend on there, by name, (n, k) each (`ocp.effects.engine.symbolic.CONDITIONS`).
    """
    point, n, t = _on_path(path, s)
    seen = at_stations(conditions, path.s, s)
    q_real, T_flange, weight = _postures(cell, believed, q, seen)
    T = T_flange @ cell.workpiece.T_flange_blade
    p = apply(T, point)
    n_base, t_base = (np.einsum("kij,kj->ki", T[:, :3, :3], v) for v in (n, t))
    wheel = cell.wheel
    v = p - wheel.centre
    lateral = v @ wheel.axis
    radial = v - lateral[:, None] * wheel.axis
    rho = np.linalg.norm(radial, axis=1)
    e = radial / rho[:, None]
    delta = wheel.radius - rho

    planned = np.interp(s, path.s, path.force) if planned is None else planned
    at = _stations(path, s, planned)
    waypoint = np.abs(path.s - s[at, None]).argmin(axis=1)
    J = _jacobian(cell, believed, q_real[at], point[at])
    shapes = [_local_shape(cell, path, int(w), n_base[k], t_base[k], e[k], lateral[k]) for k, w in zip(at, waypoint, strict=True)]
    pushed = [
        _linear_compliance(cell, believed, J, e[at], n_base[at], t_base[at], compliance[waypoint], mu)
        for mu in (wheel.friction, 1.0, 0.0)
    ]
    here, levers = {name: value[at] for name, value in seen.items()}, np.einsum("ij,ijk->ik", e[at], J)
    placed = q[at], point[at], n[at], t[at], T[at], e[at], lateral[at], levers, weight[at]
    contacts = StationContacts(cell, *placed, shapes, here)
    chain = partial(_tangents, cover, cloud, contacts, delta[at], planned[at], pushed)

    def off(stations: NDArray[np.int64], *both: Array) -> Array:
        expected, found = ((delta[at[stations]] - overlap) / rise for overlap, rise in (one.T for one in both))
        return np.abs(expected - found)

    chain(np.flatnonzero([one.kxx <= 0 for one in shapes]))  # too hollow for the wheel: none of these is passed over
    limit = RIGID_FORCE_TOLERANCE if cell.flange is None else FLANGE_FORCE_TOLERANCE
    chosen, tangents = solved_where_needed(s[at], chain, off, STATION_MISS * limit)
    # Where the chain's tangent meets no force varies smoothly, whatever the force; the overlap is judged at every millisecond.
    overlap, rise = PchipInterpolator(s[at[chosen]], tangents)(s).T
    force = (delta - overlap) / rise
    stopped = np.interp(s, s[at], [_stopped(cell, T[k], n_base[k]) for k in at])
    return VerifiedPass(time, s, np.maximum(force, 0.0), delta, planned, stopped)


def _on_path(path: BladePath, s: Array) -> tuple[Array, Array, Array]:
    """Points (m, 3) m, unit normals and feeds (m, 3) of a path at arc lengths s (m,) m, blade frame."""
    p, n, t = (CubicSpline(path.s, of)(s) for of in (path.p, path.n, path.t))
    n = n / np.linalg.norm(n, axis=1, keepdims=True)
    t = t - n * np.sum(t * n, axis=1, keepdims=True)
    return p, n, t / np.linalg.norm(t, axis=1, keepdims=True)


def _stations(path: BladePath, s: Array, planned: Array) -> NDArray[np.int64]:
    """Rows at which contacts may be solved: some millimetres apart, and where the planned force (m,) N has changed by another
    FORCE_SPACING."""
    apart = np.searchsorted(s, np.clip(path.s[contact_stations(path.s, STATION_SPACING)], s[0], s[-1]))
    changed = np.cumsum(np.abs(np.diff(planned, prepend=planned[0])))
    steps = np.flatnonzero(np.diff(np.floor(changed / FORCE_SPACING)))
    return np.unique(np.clip(np.append(apart, steps), 0, len(s) - 1))


def _tangents(
    cover: Cover,
    cloud: SurfaceCloud,
    contacts: "StationContacts",
    delta: Array,
    planned: Array,
    pushed: Sequence[Array],
    stations: NDArray[np.int64],
) -> Array:
    """Of some stations (k,) the overlap at which the chain's tangent meets no force, m, and its m/N, (k, 2). delta (m,) m and
    planned (m,) N of all contacts, pushed: their `_linear_compliance` with the cell's friction, with 1 and with 0."""
    tangents, beside = [], None
    for i in stations:
        one, linear = contacts.only(int(i)), [of[i] for of in pushed]
        shape = surface_shape(one.cell.wheel, cloud, one.shapes[0], one.T[0], one.p[0])
        F, rate, beside = _equilibrium(one.cell, cover, shape, one, float(delta[i]), float(planned[i]), linear, beside)
        tangents.append((delta[i] - F * rate, rate))
    return np.array(tangents)


def gaps(
    cell: Cell, believed: BelievedRobot, path: BladePath, at: int, compliance: Array, q: Array, conditions: Mapping[str, Array]
) -> Array:
    """How far (m,) m the wheel is from where it would touch the blade's waypoint `at` of `path` at commanded joints q (m, 6): the
    flange stands out free. compliance (3,) m/N of the blade there; `conditions` of the effects, by name, (m, k) each."""
    seen, wheel = dict(conditions), cell.wheel
    q_real, T_flange, weight = _postures(cell, believed, q, seen)
    T, p, n, t = T_flange @ cell.workpiece.T_flange_blade, path.p[at], path.n[at], path.t[at]
    lateral, radial, rho = wheel.cylindrical(apply(T, p))
    e, n_base, t_base = radial / rho[:, None], T[:, :3, :3] @ n, T[:, :3, :3] @ t
    held = [_flange(cell, pose, normal) for pose, normal in zip(T, n_base, strict=True)]
    push = np.array([share for share, _ in held])
    preload, give, half = np.array([spring for _, spring in held]).reshape(-1, 3).T
    out = -np.minimum(preload * give, half) * push
    left = rho - wheel.radius + out
    if not cell.effects:
        return np.asarray(left)
    shapes = [_local_shape(cell, path, at, *of) for of in zip(n_base, t_base, e, lateral, strict=True)]
    p, n, t, blade = (np.broadcast_to(one, (len(q), 3)) for one in (p, n, t, compliance))
    J = _jacobian(cell, believed, q_real, p)
    samples = StationContacts(cell, q, p, n, t, T, e, lateral, np.einsum("ij,ijk->ik", e, J), weight, shapes, seen)
    rigid = _linear_compliance(cell, believed, J, e, n_base, t_base, blade, wheel.friction)
    none = np.zeros(len(q))
    parts, slopes = np.column_stack([out, none, none, none]), np.column_stack([push**2 * give, none, rigid[:, :2]])
    return np.asarray(left - samples.overlap(none, parts, slopes, none, 0.0 * rigid[:, 2:]))


def _postures(cell: Cell, believed: BelievedRobot, q: Array, seen: dict[str, Array]) -> tuple[Array, Array, Array]:
    """Bent joints (m, 6), flange poses (m, 4, 4) and torques of the weight (m, 6) N m at commanded joints q (m, 6), with the
    cell's effects."""
    q_real = bent(cell, believed, q)
    if not cell.effects:
        return q_real, elementary_forward(believed.robot, q_real), believed.torque(q_real)
    return moved_arm(cell, believed, q, q_real, seen)


def bent(cell: Cell, believed: BelievedRobot, q: Array) -> Array:
    """Joints (m, 6) bent by gravity at the converged posture; q commanded (m, 6)."""
    bends, real = believed.bending(cell), q.copy()
    for _ in range(FIXED_POINT_STEPS):
        real = q + bends * believed.torque(real)
    return real


def at_stations(conditions: Mapping[str, Array] | None, of: Array, s: Array) -> dict[str, Array]:
    """Conditions (n, k) at arc lengths `of` (n,), between them at s (m,)."""
    found = {}
    for name, values in (conditions or {}).items():
        found[name] = np.asarray(interp1d(of, values, axis=0, bounds_error=False, fill_value=(values[0], values[-1]))(s))
    return found


def moved_arm(cell: Cell, arm: BelievedRobot, q: Array, q_real: Array, seen: Mapping[str, Array]) -> tuple[Array, Array, Array]:
    """Bent joints (m, 6), flange poses (m, 4, 4) and torques of the weight (m, 6) N m with the cell's effects; q commanded,
    q_real as the believed arm bends."""
    m, bends = len(q), arm.bending(cell)
    payload = np.concatenate([[arm.payload_mass], arm.payload_com])
    frames = elementary_frames(arm.robot, q_real)
    blocks = {"q": q, "q_real": q_real, "tau": arm.torque(q_real), "c": bends, "payload": payload, "hung": 0.0}
    blocks |= {"frames": frames[:, :, :3, :].reshape(m, 84)}
    blocks |= {name: seen[name] for name in ("approach", "speed", "warm", "time")}
    rows = ArmRows(ArmPlace.of(arm.robot, (cell.workpiece.payload_name,)), ARM_LAYOUT.stack(m, blocks))
    active = [e.active for e in cell.effects]
    shift = arm_shift(active, rows)
    dq, real = shift.joints[0, :, :, 0], q_real
    for _ in range(FIXED_POINT_STEPS):
        real = q + dq + bends * arm.torque(real)
    frames = elementary_frames(arm.robot, real)
    T, at = frames[:, 6].copy(), frames[..., :3, 3].copy()
    for link in sorted(shift.twists):
        motion = shift.twists[link][0, :, :, 0]
        v, w = motion[:, :3], motion[:, 3:]
        turned = T[:, :3, 3] - at[:, link]
        T[:, :3, 3] += v + np.cross(w, turned)
        T[:, :3, :3] += np.cross(w[:, :, None], T[:, :3, :3], axis=1)
        for i in range(link + 1, 7):
            at[:, i] += v + np.cross(w, at[:, i] - at[:, link])
        at[:, link] += v
    return real, T, loaded(active, rows).block("tau")


@dataclass(frozen=True)
class StationContacts:
    """m contacts of a pass: commanded joints q (m, 6), points, normals and feeds (m, 3) in the blade frame, T_base_blade (m, 4,
    4), radials e (m, 3), lateral (m,) m, levers (m, 6) m/rad of the joints along e, torques of the weight
    (m, 6) N m, the local shapes, numbers (m, k) of the cell's conditions there."""

    cell: Cell
    q: Array
    p: Array
    n: Array
    t: Array
    T: Array
    e: Array
    lateral: Array
    levers: Array
    weight: Array
    shapes: Sequence[LocalShape]
    seen: Mapping[str, Array]

    def only(self, i: int) -> "StationContacts":
        """One of them."""
        cut = {name: value[i : i + 1] for name, value in vars(self).items() if name not in ("cell", "seen")}
        return replace(self, **cut, seen={name: value[i : i + 1] for name, value in self.seen.items()})

    def overlap(self, F: Array, parts: Array, slopes: Array, friction_deflection: Array, joint_push: Array) -> Array:
        """Overlap (m,) m that the cell's effects add at forces F (m,) N; parts (m, 4) m and slopes (m, 4) m/N of flange, wheel,
        blade, robot; friction_deflection (m,) m: by how much more the parts give way per unit of friction; joint_push (m, 6) of
        `ContactContext`."""
        cell, wheel, R, m = self.cell, self.cell.wheel, self.T[:, :3, :3], len(self.T)
        clamp, start = cell.workpiece, cell.wheel.contact_direction
        R_flange, normal = R @ clamp.T_flange_blade[:3, :3].T, np.einsum("kij,kj->ki", R, self.n)
        push = normal
        if cell.flange is not None and cell.flange.axis is not None:
            push = R_flange @ cell.flange.axis
            push = push * np.sign(np.sum(push * normal, axis=1, keepdims=True))
        belt = np.cross(wheel.axis, self.e)
        heading = -np.einsum("kij,kj->ki", R, self.t) * cell.process.sigma * wheel.travel
        blocks: dict[str, Any] = {name: value for name, value in self.seen.items() if name not in ("approach", "speed")}
        blocks |= {"F": F, "parts": parts, "slopes": slopes, "normal_stiffness": 1.0 / slopes.sum(axis=1)}
        blocks |= {"friction_deflection": friction_deflection, "clamp_deflection": F / clamp.clamp_stiffness}
        blocks |= {
            "joint_push": joint_push,
            "joint_lever": self.levers,
            "tau": self.weight,
            "q": self.q,
            "p": self.p,
            "n": self.n,
            "t": self.t,
            "e": self.e,
            "axis": wheel.axis,
            "lateral": self.lateral,
        }
        blocks |= {"belt_direction": belt, "n_base": normal, "push_axis": push}
        blocks |= {"R_flange": R_flange.reshape(m, 9), "R_blade": R.reshape(m, 9)}
        blocks |= {"curvature": np.array([[one.kxx, one.kyy, one.kxy] for one in self.shapes])}
        blocks |= {"tilt": np.array([[one.tilt_x, one.tilt_y] for one in self.shapes])}
        blocks |= {"arc": np.arctan2(np.cross(start, self.e) @ wheel.axis, self.e @ start)}
        blocks |= {"turn": np.arctan2(heading @ wheel.axis, np.sum(heading * belt, axis=1))}
        blocks |= {"lever": np.abs(self.p @ clamp.clamp_normal - clamp.clamp_offset)}
        active = [e.active for e in cell.effects]
        place = ContactPlace(wheel.radius, wheel.friction, tuple(cell.robot.gravity_direction))
        return added_overlap(active, place, CONTACT_LAYOUT.stack(m, blocks), cell.flange is None)


def _equilibrium(
    cell: Cell,
    cover: Cover,
    shape: SurfaceShape,
    sample: StationContacts,
    delta: float,
    F: float,
    linear: list[Array],
    beside: Contact | None,
) -> tuple[float, float, Contact]:
    """Force N at an overlap delta m, by Newton from F, and m/N of the whole chain; linear: `_linear_compliance` with the
    cell's friction, with 1 and with 0; beside: a contact solved nearby. Returns the contact too."""
    push, stroke = _flange(cell, sample.T[0], sample.T[0, :3, :3] @ sample.n[0])
    rigid, push_of = np.split(linear[0], [2])
    rubbed = float(np.sum(linear[1][:2] - linear[2][:2]))
    for _ in range(FORCE_STEPS):
        contact = beside = solve_force(cover, F, shape, beside)
        free = (F * push - stroke[0]) * stroke[1]
        x = float(np.clip(free, -stroke[2], stroke[2]))  # at its stops the flange is rigid
        parts = (x * push, contact.indentation, *(F * rigid))
        slopes = (push**2 * stroke[1] * (x == free), 1.0 / contact.stiffness, *rigid)
        more, rate = 0.0, float(sum(slopes))
        if cell.effects:
            ends = []  # what effects add goes with the force
            for at in (F, F + PROBE):
                there = np.array(parts) + (at - F) * np.array(slopes)
                given = (np.array([value]) for value in (at, there, slopes, at * rubbed, at * push_of))
                ends.append(float(sample.overlap(*given)[0]))
            more = ends[0]
            rate = max(rate - (ends[1] - ends[0]) / PROBE, LEAST_RATE * rate)
        step = (delta + more - sum(parts)) / rate
        F = max(F + step, 0.05 * F)
        if abs(step) < FORCE_STEP_ENOUGH:
            break
    return F, rate, contact


def _local_shape(cell: Cell, path: BladePath, k: int, n: Array, t: Array, e: Array, lateral: float) -> LocalShape:
    wheel = cell.wheel
    belt, axis = np.cross(wheel.axis, e), wheel.axis
    b = np.cross(n, t)
    A = np.array([[t @ belt, b @ belt], [t @ axis, b @ axis]])
    k_tt, k_bb, k_tb = path.curvature[k]
    K = A @ np.array([[k_tt, k_tb], [k_tb, k_bb]]) @ A.T
    return LocalShape(
        kxx=K[0, 0] + 1 / wheel.radius,
        kyy=K[1, 1],
        kxy=K[0, 1],
        lateral=float(lateral),
        tilt_x=-float(n @ belt) / float(n @ e),
        tilt_y=-float(n @ axis) / float(n @ e),
        heading=(float(t @ belt), float(t @ axis)),
    )


def _jacobian(cell: Cell, believed: BelievedRobot, q: Array, p: Array) -> Array:
    """How the contact points p (m, 3) in the blade frame move with the joints q (m, 6), (m, 3, 6) m/rad."""
    nudged = q[:, None] + DIFFERENCE * np.vstack([np.eye(6), -np.eye(6)])
    T = elementary_forward(believed.robot, nudged).reshape(-1, 12, 4, 4) @ cell.workpiece.T_flange_blade
    points = apply(T, p[:, None])
    return np.asarray((points[:, :6] - points[:, 6:]) / (2 * DIFFERENCE)).swapaxes(1, 2)


def _linear_compliance(
    cell: Cell, believed: BelievedRobot, J: Array, e: Array, n: Array, t: Array, blade: Array, friction: float
) -> Array:
    """Displacement of contacts per newton (m, 8): m/N from the blade with its fixture, and from joints (PHYSICS 3.1); and
    torques N m about the joints per newton.

    J (m, 3, 6) of `_jacobian`; e, n, t (m, 3): outward radial, normal and feed in the base frame; blade (m, 3) m/N: its
    compliance c_nn, c_nt, c_nb there.
    """
    f = e + friction * np.cross(cell.wheel.axis, e) * np.sign(cell.wheel.belt_speed)
    along = [np.einsum("ij,ij->i", f, v) for v in (-n, t, np.cross(n, t))]
    held = np.einsum("ij,ji->i", blade, np.array(along))
    push = np.einsum("ijk,ij->ik", J, f)
    give = (np.einsum("ij,ijk->ik", e, J) * push) @ believed.compliance
    return np.column_stack([held + 1.0 / cell.workpiece.clamp_stiffness, give, push])


def _stopped(cell: Cell, T_base_blade: Array, n: Array) -> float:
    """Normal force N up to which the flange stands at its outer stop, zero where it stands free before or is none."""
    share, (preload, give, half) = _flange(cell, T_base_blade, n)
    return max(preload - half / give, 0.0) / share if give > 0.0 else 0.0


def _flange(cell: Cell, T_base_blade: Array, n: Array) -> tuple[float, tuple[float, float, float]]:
    """Share of the normal force along the flange's axis, and (preload N, compliance m/N, half length m) of its stroke."""
    flange = cell.flange
    if flange is None:
        return 0.0, (0.0, 0.0, 0.0)
    direction = n
    if flange.axis is not None:
        R_flange = T_base_blade[:3, :3] @ cell.workpiece.T_flange_blade[:3, :3].T
        direction = R_flange @ flange.axis
        direction = direction * np.sign(direction @ n)
    weight = (
        0.0 if flange.gravity_compensated else flange.carried_mass * GRAVITY * float(cell.robot.gravity_direction @ direction)
    )
    return float(direction @ n), (flange.setpoint + weight, 1.0 / flange.stiffness, 0.5 * flange.stroke)
