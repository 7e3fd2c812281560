"""Where a reflector is in the base frame: the planner's own arm (MD-H, weight, springs) with a nest on one of its links.

One symbolic row, evaluated for all readings at once. The posture q_real = q + c tau(q_real) is differentiated implicitly,
    (I - C tau_q) dq_real = dq + C (tau_mdh dmdh + tau_payload dpayload) + diag(tau) dc,
which is exact at the fixed point and nine times cheaper than differentiating through its two steps (the steps leave
1e-5 of the sag, `robots.compliance`). Each MD-H number turns or shifts everything after it about or along a line of the
arm, so the derivatives of points and torques are written as cross products: a quarter of what automatic
differentiation evaluates.
"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import casadi as ca
import numpy as np

from robots.calibration.parameters import COMPLIANCE_NAMES, MDH_NAMES
from robots.compliance import deflected_joints
from robots.gravity import GRAVITY, gravity_torques
from robots.kinematics import chain
from robots.pose import Array
from robots.robot import Robot

_CHUNK = 2048  # rows of one call: large enough to hide its cost, small enough for the cache
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
    geometry = _rows(_geometry, (rows.nest_link, robot.sign.tobytes()), real, mdh, rows.nest)
    point, R = geometry[:, :3], geometry[:, 3:12].reshape(n, 3, 3)
    J = geometry[:, 12:].reshape(n, 6, 36)  # point, then spin, in q_real, mdh
    key = (rows.load_link, *_masses(robot))
    statics = _rows(_statics, key, real, mdh, rows.payload, rows.load, rows.load_place)
    tau, T = statics[:, :6], statics[:, 6:].reshape(n, 6, 40)  # q_real, mdh, payload
    # X = J_q (I - C tau_q)^-1, from the left: six right-hand sides instead of 46.
    bent = np.eye(6) - c[:, None] * T[..., :6]
    X = np.swapaxes(np.linalg.solve(np.swapaxes(bent, 1, 2), np.swapaxes(J[..., :6], 1, 2)), 1, 2)
    forced = (X * c) @ T[..., 6:]  # mdh, payload
    d_arm = np.concatenate([J[..., 6:] + forced[..., :30], X * tau[:, None, :]], axis=2)
    d_payload = forced[:, :, 30:]
    return Prediction(point, R, d_arm[:, :3], R, d_payload[:, :3], X[:, :3], d_arm[:, 3:], d_payload[:, 3:], X[:, 3:])


def predict_points(robot: Robot, arm: Array, rows: RowInputs) -> tuple[Array, Array]:
    """Points (n, 3) m and rotations (n, 3, 3) alone, as `predict` gives them."""
    n = len(rows.q)
    key = (rows.nest_link, robot.sign.tobytes())
    out = _rows(_place, key, _postures(robot, arm, rows), np.broadcast_to(arm[:30], (n, 30)), rows.nest)
    return out[:, :3], out[:, 3:].reshape(n, 3, 3)


def _postures(robot: Robot, arm: Array, rows: RowInputs) -> Array:
    """Bent joints (n, 6) rad."""
    if not arm[30:].any():
        return rows.q
    whole = np.broadcast_to(arm, (len(rows.q), 36))
    return _rows(_bent, (rows.load_link, *_masses(robot)), rows.q, whole, rows.payload, rows.load, rows.load_place)


def _rows(build: Callable[..., ca.Function], key: tuple[Any, ...], *arguments: Array) -> Array:
    """One output row per input row of the function build(*key): arguments (n, k_i) -> (n, m).

    CasADi reads and writes the arrays' own memory: its matrices would cost as much again as the evaluation.
    """
    n = len(arguments[0])
    out = np.empty((n, build(*key).size1_out(0)))
    for start in range(0, n, _CHUNK):
        block = slice(start, min(start + _CHUNK, n))
        buffer: Any
        buffer, evaluate = _mapped(build, block.stop - start, key).buffer()
        held = [np.ascontiguousarray(a[block], float) for a in arguments]
        for i, a in enumerate(held):
            buffer.set_arg(i, a.data)
        buffer.set_res(0, out[block].data)
        evaluate()
    return out


@lru_cache(maxsize=64)
def _mapped(build: Callable[..., ca.Function], count: int, key: tuple[Any, ...]) -> ca.Function:
    """The function for `count` rows at once."""
    return build(*key).map(count)


def _masses(robot: Robot) -> tuple[bytes, ...]:
    return tuple(np.asarray(a, float).tobytes() for a in (robot.sign, robot.link_mass, robot.link_com, robot.gravity_direction))


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
    """(q_real, mdh, nest) -> point, R, then (6, 36) of the point and the spin in q_real and mdh; matrices row-major."""
    q, mdh, nest = ca.SX.sym("q", 6), ca.SX.sym("mdh", 30), ca.SX.sym("nest", 3)
    s = np.frombuffer(sign)
    frames = chain(q, _table(mdh), s)
    R = frames[link][:3, :3]
    point = frames[link][:3, 3] + R @ nest
    columns = []
    for m in _motions(q, _table(mdh), s, frames):
        if m.joint >= link:
            columns.append(ca.SX.zeros(6))
        elif m.turns:
            columns.append(ca.vertcat(ca.cross(m.axis, point - m.at), m.axis))
        else:
            columns.append(ca.vertcat(m.axis, 0, 0, 0))
    J = ca.horzcat(*(s[i] * columns[5 * i] for i in range(6)), *columns)
    return ca.Function("geometry", [q, mdh, nest], [ca.cse(ca.densify(ca.vertcat(point, ca.vec(R.T), ca.vec(J.T))))])


@dataclass(frozen=True)
class _Motion:
    """What one MD-H number does to all frames after A_joint: turn about, or shift along, `axis` (3) at `at` (3), base frame."""

    joint: int
    turns: bool
    axis: Any
    at: Any


def _motions(q: Any, table: Any, sign: Array, frames: list[Any]) -> Iterator[_Motion]:
    """The 30 motions in the order of `MDH_NAMES`."""
    for i in range(6):
        theta = sign[i] * q[i] + table[i, 0]
        before, after = frames[i], frames[i + 1]
        x = ca.cos(theta) * before[:3, 0] + ca.sin(theta) * before[:3, 1]
        yield _Motion(i, True, before[:3, 2], before[:3, 3])
        yield _Motion(i, False, before[:3, 2], before[:3, 3])
        yield _Motion(i, False, x, after[:3, 3])
        yield _Motion(i, True, x, after[:3, 3])
        yield _Motion(i, True, after[:3, 1], after[:3, 3])


def _torques(q: ca.SX, mdh: ca.SX, payload: ca.SX, load: ca.SX, place: ca.SX, link: int, masses: tuple[bytes, ...]) -> ca.SX:
    """Torque (6) N m about each axis, positive along +q: weight, and a force and moment in base axes at a place of a link."""
    sign, mass, com = np.frombuffer(masses[0]), np.frombuffer(masses[1]), np.frombuffer(masses[2]).reshape(7, 3)
    weight = gravity_torques(q, _table(mdh), sign, mass, com, payload[0], payload[1:], np.frombuffer(masses[3]))
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
    return ca.Function("bent", [q, arm, payload, load, place], [ca.cse(ca.densify(real))])


@lru_cache(maxsize=32)
def _statics(link: int, *masses: bytes) -> ca.Function:
    """(q_real, mdh, payload, load, place) -> tau (6), its derivative (6, 40) in the first three, row-major."""
    q, mdh, (payload, load, place) = ca.SX.sym("q", 6), ca.SX.sym("mdh", 30), _load_symbols()
    tau = _torques(q, mdh, payload, load, place, link, masses)
    sign, mass, com = np.frombuffer(masses[0]), np.frombuffer(masses[1]), np.frombuffer(masses[2]).reshape(7, 3)
    frames = chain(q, _table(mdh), sign)
    R, o = [f[:3, :3] for f in frames], [f[:3, 3] for f in frames]
    # Mass and first moment of what hangs on each axis.
    total, moment = [payload[0]], [payload[0] * (o[6] + R[6] @ payload[1:])]
    for i in range(6, 0, -1):
        total.insert(0, total[0] + mass[i])
        moment.insert(0, moment[0] + mass[i] * (o[i] + R[i] @ com[i]))
    weight, force, at = ca.SX(GRAVITY * np.frombuffer(masses[3])), load[:3], o[link] + R[link] @ place
    derivative: list[list[Any]] = [[] for _ in range(6)]
    motions = list(_motions(q, _table(mdh), sign, frames))
    for j, row in enumerate(derivative):
        z, lever, arm = R[j][:, 2], moment[j] - total[j] * o[j], at - o[j]
        pull = float(j < link)
        # An axis that is turned with all it carries feels the forces turned the other way.
        turned = ca.cross(ca.cross(z, lever), weight)
        turned += pull * (ca.cross(ca.cross(z, arm), force) + ca.cross(z, load[3:]))
        for m in motions:
            if m.joint < j:
                row.append(ca.dot(m.axis, turned) if m.turns else 0)
                continue
            moved = ca.cross(m.axis, moment[m.joint] - total[m.joint] * m.at) if m.turns else total[m.joint] * m.axis
            work = ca.dot(moved, ca.cross(weight, z))
            if pull and m.joint < link:
                work += ca.dot(ca.cross(m.axis, at - m.at) if m.turns else m.axis, ca.cross(force, z))
            row.append(work)
        hung = o[6] + R[6] @ payload[1:] - o[j]
        row.extend([ca.dot(hung, ca.cross(weight, z)), *(payload[0] * ca.dot(R[6][:, k], ca.cross(weight, z)) for k in range(3))])
    rows = [ca.vertcat(*(sign[i] * row[5 * i] for i in range(6)), *row) for row in derivative]
    out = ca.vertcat(tau, *(sign[j] * row for j, row in enumerate(rows)))
    return ca.Function("statics", [q, mdh, payload, load, place], [ca.cse(ca.densify(out))])
