"""The one symbolic model: commanded joints and contact force -> overlap, its parts, task coordinates.

Planning fixes the parameters and differentiates in the joints; calibration and the force's standard deviation fix the
joints and differentiate in the parameters. Symbols as in docs/model.md; frames and signs as in docs/architecture.md.
"""

from dataclasses import dataclass

import casadi as ca
import numpy as np

from ocp.contact.wheel.law import WheelLaw
from ocp.effects.context import ContactContext
from ocp.effects.engine.symbolic import CONDITIONS, ModelEffects, planned_arm_context
from ocp.model.cell import Cell
from ocp.model.theta import Theta, axis_directions
from robots.compliance import deflected_joints
from robots.gravity import GRAVITY, gravity_torques
from robots.kinematics import chain
from robots.pose import Array

# Columns of the waypoint data w handed to every function of the model.
WAYPOINT = ("p", "n", "t", "curvature", "blade_compliance", "indentation_correction")
WAYPOINT_SIZE = {"p": 3, "n": 3, "t": 3, "curvature": 3, "blade_compliance": 3, "indentation_correction": 1}
STOP_SOFTNESS = 0.1  # N about a stop of the flange in which its stroke bends over
N_WAYPOINT = sum(WAYPOINT_SIZE.values())


@dataclass(frozen=True)
class Model:
    """Symbols of the model and its expressions, all scalar CasADi SX; see `build_model`.

    q (6) commanded joints rad; F contact force N; w (16) waypoint; theta (m) parameters. A cell with effects appends their
    conditions (`ocp.effects.engine.symbolic.CONDITIONS`) to w and, where asked, their coefficients to theta.
    delta = overlap m; extra m: what effects add to it; residual = delta + extra - (flange + wheel + blade + robot) m, zero in
    equilibrium.
    task = arc rad, lateral m, turn rad, tilt_x, tilt_y (slopes), radial distance of the wrist from axis 1 m.
    """

    q: ca.SX
    F: ca.SX
    w: ca.SX
    theta: ca.SX
    delta: ca.SX
    residual: ca.SX
    parts: ca.SX
    arc: ca.SX
    lateral: ca.SX
    turn: ca.SX
    tilt: ca.SX
    curvature: ca.SX
    shoulder: ca.SX
    T_base_blade: ca.SX
    q_real: ca.SX
    extra: ca.SX
    joint_lever: ca.SX
    joint_push: ca.SX
    tau: ca.SX


def build_model(cell: Cell, law: WheelLaw, sigma: int = 1, uncertain: bool = False, any_bend: bool = False) -> Model:
    """The model of `cell` with the wheel's force law; `sigma` +1 grinds "down", -1 "up" (docs/architecture.md).

    `uncertain`: coefficients of the cell's effects are parameters after theta's own, else numbers. `any_bend`: the last six
    numbers of w say which joints bend under weight (1 or 0), else the cell does. Friction and belt speed may be symbols.
    """
    q, F, effects = ca.SX.sym("q", 6), ca.SX.sym("F"), ModelEffects.of(cell.effects, uncertain)
    w, theta = ca.SX.sym("w", N_WAYPOINT), ca.SX.sym("theta", Theta.size)
    waypoint = dict(zip(WAYPOINT, ca.vertsplit(w, np.cumsum([0, *WAYPOINT_SIZE.values()]).tolist()), strict=True))
    par = Theta.split(theta)

    bends = ca.SX.sym("bends", 6) if any_bend else ca.SX(ca.DM(bending(cell)))
    frames, q_real, T_base_flange, tau = _arm(cell, q, par, bends, effects)
    R_real, p_real = _blade_pose(cell, T_base_flange, par)
    p, n, t = p_real + R_real @ waypoint["p"], R_real @ waypoint["n"], R_real @ waypoint["t"]

    radius = cell.wheel.radius + par["wheel_radius"]
    axis, e, belt, lateral, delta, arc = _on_wheel(cell, par, p, radius)
    heading = -sigma * ca.if_else(cell.wheel.belt_speed < 0, -1, 1) * t
    turn = ca.atan2(ca.dot(heading, axis), ca.dot(heading, belt))
    tilt = -ca.vertcat(ca.dot(n, belt), ca.dot(n, axis)) / ca.dot(n, e)
    curvature = _relative_curvature(radius, waypoint["curvature"], n, t, belt, axis)

    friction = ca.SX.sym("friction") if effects.on_contact else ca.SX(cell.wheel.friction)
    force_direction = e + friction * ca.sign(cell.wheel.belt_speed) * belt
    x_flange = _flange_stroke(cell, F, n, T_base_flange, par)
    d_wheel = waypoint["indentation_correction"] + law.indentation(
        F / (1 + par["cover_stiffness_scale"]), curvature[0], curvature[1], curvature[2], lateral, tilt[0], tilt[1]
    )
    d_blade = F * _blade_compliance(cell, waypoint["blade_compliance"], n, t, force_direction, par)
    joint_lever, joint_push = (_about_joints(cell, frames, p, of) for of in (e, F * force_direction))
    parts = ca.vertcat(x_flange, d_wheel, d_blade, ca.dot(par["c"], joint_lever * joint_push))
    extra = ca.SX(0)
    if effects.on_contact:
        seen = {"lateral": lateral, "tilt": tilt, "arc": arc, "turn": turn, "curvature": curvature, "axis": axis, "e": e}
        seen |= {name: waypoint[name] for name in ("p", "n", "t")} | {"belt_direction": belt, "n_base": n, "R_blade": R_real}
        seen |= {"joint_lever": joint_lever, "joint_push": joint_push, "tau": tau, "q": q}
        extra = _extra(cell, effects, friction, F, parts, T_base_flange[:3, :3], seen)
        parts, extra, joint_push = ca.substitute([parts, extra, joint_push], [friction], [ca.SX(cell.wheel.friction)])
    return Model(
        q=q,
        F=F,
        w=ca.vertcat(w, effects.conditions, *([bends] if any_bend else [])),
        theta=ca.vertcat(theta, effects.a) if uncertain else theta,
        delta=delta,
        residual=delta + extra - ca.sum1(parts),
        parts=parts,
        arc=arc,
        lateral=lateral,
        turn=turn,
        tilt=tilt,
        curvature=curvature,
        shoulder=_shoulder(cell, q),
        T_base_blade=ca.vertcat(ca.horzcat(R_real, p_real), ca.DM([[0, 0, 0, 1]])),
        q_real=q_real,
        extra=extra,
        joint_lever=joint_lever,
        joint_push=joint_push,
        tau=tau,
    )


def _extra(
    cell: Cell, effects: ModelEffects, friction: ca.SX, F: ca.SX, parts: ca.SX, R_flange: ca.SX, seen: dict[str, ca.SX]
) -> ca.SX:
    """Overlap m that the cell's effects add at the contact."""
    conditions = CONDITIONS.split(effects.conditions)
    clamp, slopes = cell.workpiece, ca.jacobian(parts, F)
    seen |= {name: value for name, value in conditions.items() if name not in ("approach", "speed")}
    context = ContactContext(
        F=F,
        parts=parts,
        slopes=slopes,
        R_flange=R_flange,
        radius=cell.wheel.radius,
        friction=cell.wheel.friction,
        normal_stiffness=1 / ca.sum1(slopes),
        friction_deflection=ca.jacobian(ca.sum1(parts), friction),
        push_axis=_push_axis(cell, seen["n_base"], R_flange),
        down=cell.robot.gravity_direction,
        lever=ca.fabs(ca.dot(clamp.clamp_normal, seen["p"]) - clamp.clamp_offset),
        clamp_deflection=F / clamp.clamp_stiffness,
        **seen,
    )
    return effects.overlap(context, rigid=cell.flange is None)


def bending(cell: Cell) -> Array:
    """1 for joints that bend under weight, else 0 (6,)."""
    return np.array([float(j in cell.compliant_joints) for j in range(1, 7)])


def _arm(
    cell: Cell, q: ca.SX, par: dict[str, ca.SX], bends: ca.SX, effects: ModelEffects
) -> tuple[list[ca.SX], ca.SX, ca.SX, ca.SX]:
    """Link frames, joints and flange pose of the arm that is bent by gravity and moved by the cell's effects, and the torque of
    the weight about its axes."""
    robot, mdh, sign = cell.robot, ca.reshape(par["mdh"], 5, 6).T, cell.robot.sign

    def torque(joints: ca.SX) -> ca.SX:
        return gravity_torques(
            joints, mdh, sign, robot.link_mass, robot.link_com, par["payload_mass"], par["payload_com"], robot.gravity_direction
        )

    c = par["c"] * bends
    q_real = deflected_joints(q, torque, c)
    frames = chain(q_real, mdh, sign)
    if not cell.effects:
        return frames, q_real, frames[-1], torque(q_real)
    context = planned_arm_context(
        robot,
        cell.workpiece.payload_name,
        frames,
        CONDITIONS.split(effects.conditions),
        q=q,
        q_real=q_real,
        tau=torque(q_real),
        c=c,
        payload=ca.vertcat(par["payload_mass"], par["payload_com"]),
    )
    change = effects.arm(context)
    q_real = deflected_joints(q + change.dq, lambda joints: torque(joints) + change.dtau, c)
    frames = change.moved(chain(q_real, mdh, sign))
    return frames, q_real, frames[-1], torque(q_real) + change.dtau


def _blade_pose(cell: Cell, T_base_flange: ca.SX, par: dict[str, ca.SX]) -> tuple[ca.SX, ca.SX]:
    """Rotation and position of the blade frame in the base frame, its registration error a small twist on the flange."""
    T = cell.workpiece.T_flange_blade
    R = T_base_flange[:3, :3] @ _small_rotation(par["blade_rotation"]) @ T[:3, :3]
    p = T_base_flange[:3, 3] + T_base_flange[:3, :3] @ (T[:3, 3] + par["blade_shift"])
    return R, p


def _small_rotation(r: ca.SX) -> ca.SX:
    """Rotation of the small rotation vector r (3) rad to second order: registration errors are below 1e-2 rad."""
    S = ca.skew(r)
    return ca.SX.eye(3) + S + 0.5 * S @ S


def _on_wheel(cell: Cell, par: dict[str, ca.SX], p: ca.SX, radius: ca.SX) -> tuple[ca.SX, ca.SX, ca.SX, ca.SX, ca.SX, ca.SX]:
    """Where a point p (3) m lies on the wheel: axis; outward, and where the belt goes; lateral, overlap m; arc rad."""
    axis, start = _tilted_axis(cell.wheel.axis, par["wheel_axis"]), ca.SX(cell.wheel.contact_direction)
    v = p - (cell.wheel.centre + par["wheel_centre"])
    lateral = ca.dot(v, axis)
    radial = v - lateral * axis
    rho = ca.norm_2(radial)
    e = radial / rho
    arc = ca.atan2(ca.dot(ca.cross(start, e), axis), ca.dot(start, e))
    return axis, e, ca.cross(axis, e), lateral, radius - rho, arc


def _tilted_axis(axis: np.ndarray, uv: ca.SX) -> ca.SX:
    """Wheel axis turned by two small angles about the directions of `axis_directions`."""
    u, v = axis_directions(axis)
    tilted = ca.SX(axis) - uv[0] * v + uv[1] * u
    return tilted / ca.norm_2(tilted)


def _relative_curvature(radius: ca.SX, k: ca.SX, n: ca.SX, t: ca.SX, belt: ca.SX, axis: ca.SX) -> ca.SX:
    """kxx, kyy, kxy of the gap in the wheel's contact frame: the blade's curvature turned, plus the wheel's 1/R."""
    b = ca.cross(n, t)
    A = ca.blockcat([[ca.dot(t, belt), ca.dot(b, belt)], [ca.dot(t, axis), ca.dot(b, axis)]])
    K = A @ ca.blockcat([[k[0], k[2]], [k[2], k[1]]]) @ A.T
    return ca.vertcat(K[0, 0] + 1 / radius, K[1, 1], K[0, 1])


def _flange_stroke(cell: Cell, F: ca.SX, n: ca.SX, T_base_flange: ca.SX, par: dict[str, ca.SX]) -> ca.SX:
    """What the force-setting flange gives along the normal: F (n.a) = setpoint + k stroke (+ carried weight), between its stops,
    where it is rigid (PHYSICS 6)."""
    flange = cell.flange
    if flange is None:
        return ca.SX(0)
    direction = _push_axis(cell, n, T_base_flange[:3, :3])
    along = ca.SX(1) if flange.axis is None else ca.dot(direction, n)
    along_gravity = ca.dot(ca.SX(cell.robot.gravity_direction), direction)
    weight = ca.SX(0) if flange.gravity_compensated else flange.carried_mass * GRAVITY * along_gravity
    setpoint = flange.setpoint + par["flange_setpoint_offset"]
    x, soft = (F * along - setpoint - weight) / par["flange_stiffness"], STOP_SOFTNESS / flange.stiffness
    x = _at_least(x + 0.5 * flange.stroke, soft) - 0.5 * flange.stroke
    return (0.5 * flange.stroke - _at_least(0.5 * flange.stroke - x, soft)) * along


def _at_least(v: ca.SX, soft: float) -> ca.SX:
    """max(v, 0), twice continuously differentiable, exact where |v| > soft."""
    u = v / soft + 1
    return ca.if_else(u > 2, v, ca.if_else(u < 0, 0, soft * u**3 * (4 - u) / 16))


def _push_axis(cell: Cell, n: ca.SX, R_flange: ca.SX) -> ca.SX:
    """Direction in which the flange pushes the blade toward the wheel, base frame."""
    if cell.flange is None or cell.flange.axis is None:
        return n
    direction = R_flange @ ca.SX(cell.flange.axis)
    return ca.if_else(ca.dot(direction, n) < 0, -direction, direction)


def _blade_compliance(cell: Cell, c: ca.SX, n: ca.SX, t: ca.SX, f: ca.SX, par: dict[str, ca.SX]) -> ca.SX:
    """Displacement of the blade along -n per newton of normal force, friction and fixture included.

    c = c_nn, c_nt, c_nb of the finite elements: displacement along -n, t, b under a unit force along -n. By reciprocity
    a unit force along t moves the contact along -n by c_nt.
    """
    b = ca.cross(n, t)
    total = c[0] * -ca.dot(f, n) + c[1] * ca.dot(f, t) + c[2] * ca.dot(f, b)
    return total / (1 + par["blade_stiffness_scale"]) + 1 / cell.workpiece.clamp_stiffness


def _about_joints(cell: Cell, frames: list[ca.SX], p: ca.SX, v: ca.SX) -> ca.SX:
    """J^T v (6) at the point p, positive along +q: of a direction how far p moves along it, m/rad, of a force its torques N m.
    The arm gives e^T J K^-1 J^T f (PHYSICS 3.1)."""
    levers = [ca.cross(frame[:3, 2], p - frame[:3, 3]) for frame in frames[:6]]
    return ca.vertcat(*(sign * ca.dot(lever, v) for sign, lever in zip(cell.robot.sign.tolist(), levers, strict=True)))


def _shoulder(cell: Cell, q: ca.SX) -> ca.SX:
    """Signed distance of the wrist centre from axis 1, m (KRL.md, status bit 0): zero is the overhead singularity."""
    mdh = cell.robot.mdh
    a1, a2, a3, d4 = mdh[0, 2], mdh[1, 2], mdh[2, 2], mdh[3, 1]
    q23 = q[1] + q[2]
    return a1 + a2 * ca.cos(q[1]) + d4 * ca.cos(q23) + a3 * ca.sin(q23)
