"""Where a reflector is in the base frame: the planner's own arm (MD-H, weight, springs) with a nest on one of its links.

One symbolic row, evaluated for all readings at once. The posture q_real = q + c tau(q_real) is differentiated implicitly,
    (I - C tau_q) dq_real = dq + C (tau_mdh dmdh + tau_payload dpayload) + diag(tau) dc,
which is exact at the fixed point and nine times cheaper than differentiating through its two steps (the steps leave
1e-5 of the sag, `robots.compliance`).
"""

from dataclasses import dataclass
from functools import lru_cache

import casadi as ca
import numpy as np

from robots.calibration.parameters import COMPLIANCE_NAMES, MDH_NAMES
from robots.compliance import deflected_joints
from robots.gravity import gravity_torques
from robots.kinematics import chain, evaluate_rows
from robots.pose import Array
from robots.robot import Robot

ARM_NAMES: tuple[str, ...] = (*MDH_NAMES, *COMPLIANCE_NAMES)  # order of `arm` (36,)
PAYLOAD_NAMES = ("payload_mass", "payload_com_x", "payload_com_y", "payload_com_z")


@dataclass(frozen=True)
class RowInputs:
    """What a prediction needs besides the arm's parameters: q (n, 6) rad commanded; payload (n, 4) kg, m; load (n, 6)
    N, N m in base axes, acting at load_place (n, 3) m of link load_link; nest (n, 3) m in link nest_link."""

    q: Array
    payload: Array
    load: Array
    load_place: Array
    nest: Array
    nest_link: int = 6
    load_link: int = 6


@dataclass(frozen=True)
class Prediction:
    """Point (n, 3) m of the nest and rotation R (n, 3, 3) of its link in the base frame.

    Derivatives of the point in arm (n, 3, 36), nest (n, 3, 3), payload (n, 3, 4) and commanded joints (n, 3, 6). Those of
    R as spins in base axes, rad, in the same parameters: spin_arm, spin_payload, spin_joints.
    """

    point: Array
    R: Array
    d_arm: Array
    d_nest: Array
    d_payload: Array
    d_joints: Array
    spin_arm: Array
    spin_payload: Array
    spin_joints: Array


def predict(robot: Robot, arm: Array, rows: RowInputs) -> Prediction:
    """Nest positions of `robot` with parameters arm (36,) in the order of `ARM_NAMES`, with all derivatives."""
    n = len(rows.q)
    mdh, c = np.broadcast_to(arm[:30], (n, 30)), arm[30:]
    real = _postures(robot, arm, rows)
    geometry = evaluate_rows(_geometry(rows.nest_link, robot.sign.tobytes()), real, mdh, rows.nest)
    point, R = geometry[:, :3], geometry[:, 3:12].reshape(n, 3, 3)
    J = geometry[:, 12:129].reshape(n, 3, 39)  # q_real, mdh, nest
    W = geometry[:, 129:].reshape(n, 3, 36)  # q_real, mdh
    statics = evaluate_rows(_statics(rows.load_link, *_masses(robot)), real, mdh, rows.payload, rows.load, rows.load_place)
    tau, T = statics[:, :6], statics[:, 6:].reshape(n, 6, 40)  # q_real, mdh, payload
    bend = c[:, None] * T
    right = np.concatenate([bend[..., 6:36], tau[:, :, None] * np.eye(6), bend[..., 36:], np.tile(np.eye(6), (n, 1, 1))], axis=2)
    dq = np.linalg.solve(np.eye(6) - bend[..., :6], right)  # in mdh, c, payload, joints
    d = J[..., :6] @ dq
    d[..., :30] += J[..., 6:36]
    spin = W[..., :6] @ dq
    spin[..., :30] += W[..., 6:]
    return Prediction(
        point, R, d[..., :36], J[..., 36:], d[..., 36:40], d[..., 40:], spin[..., :36], spin[..., 36:40], spin[..., 40:]
    )


def predict_points(robot: Robot, arm: Array, rows: RowInputs) -> tuple[Array, Array]:
    """Points (n, 3) m and rotations (n, 3, 3) alone, as `predict` gives them."""
    n = len(rows.q)
    function = _place(rows.nest_link, robot.sign.tobytes())
    out = evaluate_rows(function, _postures(robot, arm, rows), np.broadcast_to(arm[:30], (n, 30)), rows.nest)
    return out[:, :3], out[:, 3:].reshape(n, 3, 3)


def _postures(robot: Robot, arm: Array, rows: RowInputs) -> Array:
    """Bent joints (n, 6) rad."""
    if not arm[30:].any():
        return rows.q
    function = _bent(rows.load_link, *_masses(robot))
    return evaluate_rows(function, rows.q, np.broadcast_to(arm, (len(rows.q), 36)), rows.payload, rows.load, rows.load_place)


def _masses(robot: Robot) -> tuple[bytes, ...]:
    return tuple(np.asarray(a, float).tobytes() for a in (robot.sign, robot.link_mass, robot.link_com))


def _table(mdh: ca.SX) -> ca.SX:
    return ca.reshape(mdh, 5, 6).T


@lru_cache(maxsize=32)
def _place(link: int, sign: bytes) -> ca.Function:
    """(q_real, mdh, nest) -> point, row-major R."""
    q, mdh, nest = ca.SX.sym("q", 6), ca.SX.sym("mdh", 30), ca.SX.sym("nest", 3)
    frame = chain(q, _table(mdh), np.frombuffer(sign))[link]
    R = frame[:3, :3]
    return ca.Function("place", [q, mdh, nest], [ca.densify(ca.vertcat(frame[:3, 3] + R @ nest, ca.vec(R.T)))])


@lru_cache(maxsize=32)
def _geometry(link: int, sign: bytes) -> ca.Function:
    """(q_real, mdh, nest) -> point, R, point's derivative in all three, R's spin in q_real and mdh; matrices row-major."""
    q, mdh, nest = ca.SX.sym("q", 6), ca.SX.sym("mdh", 30), ca.SX.sym("nest", 3)
    frame = chain(q, _table(mdh), np.frombuffer(sign))[link]
    R = frame[:3, :3]
    point = frame[:3, 3] + R @ nest
    J = ca.jacobian(point, ca.vertcat(q, mdh, nest))
    dR = ca.jacobian(ca.vec(R), ca.vertcat(q, mdh))
    # skew(w_i) = dR/dx_i R^T
    spin = ca.vertcat(*(sum(dR[i + 3 * k, :] * R[j, k] for k in range(3)) for i, j in ((2, 1), (0, 2), (1, 0))))
    out = ca.vertcat(point, ca.vec(R.T), ca.vec(J.T), ca.vec(spin.T))
    return ca.Function("geometry", [q, mdh, nest], [ca.densify(out)])


def _torques(q: ca.SX, mdh: ca.SX, payload: ca.SX, load: ca.SX, place: ca.SX, link: int, masses: tuple[bytes, ...]) -> ca.SX:
    """Torque (6) N m about each axis, positive along +q: weight, and a force and moment in base axes at a place of a link."""
    sign, mass, com = np.frombuffer(masses[0]), np.frombuffer(masses[1]), np.frombuffer(masses[2]).reshape(7, 3)
    weight = gravity_torques(q, _table(mdh), sign, mass, com, payload[0], payload[1:])
    frames = chain(q, _table(mdh), sign)
    at = frames[link][:3, 3] + frames[link][:3, :3] @ place
    pull = []
    for j in range(6):
        z, o = frames[j][:3, 2], frames[j][:3, 3]
        pull.append(sign[j] * ca.dot(z, ca.cross(at - o, load[:3]) + load[3:]) if j < link else ca.SX(0))
    return weight + ca.vertcat(*pull)


def _load_symbols() -> tuple[ca.SX, ca.SX, ca.SX]:
    return ca.SX.sym("payload", 4), ca.SX.sym("load", 6), ca.SX.sym("place", 3)


@lru_cache(maxsize=32)
def _bent(link: int, *masses: bytes) -> ca.Function:
    """(q, arm, payload, load, place) -> q_real."""
    q, arm, (payload, load, place) = ca.SX.sym("q", 6), ca.SX.sym("arm", 36), _load_symbols()
    real = deflected_joints(q, lambda x: _torques(x, arm[:30], payload, load, place, link, masses), arm[30:])
    return ca.Function("bent", [q, arm, payload, load, place], [ca.densify(real)])


@lru_cache(maxsize=32)
def _statics(link: int, *masses: bytes) -> ca.Function:
    """(q_real, mdh, payload, load, place) -> tau (6), its derivative in the first three, row-major."""
    q, mdh, (payload, load, place) = ca.SX.sym("q", 6), ca.SX.sym("mdh", 30), _load_symbols()
    tau = _torques(q, mdh, payload, load, place, link, masses)
    J = ca.jacobian(tau, ca.vertcat(q, mdh, payload))
    return ca.Function("statics", [q, mdh, payload, load, place], [ca.densify(ca.vertcat(tau, ca.vec(J.T)))])
