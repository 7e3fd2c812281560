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
    R as spins in base axes, rad, in the same parameters: spin_arm, spin_payload.
    """

    point: Array
    R: Array
    d_arm: Array
    d_nest: Array
    d_payload: Array
    d_joints: Array
    spin_arm: Array
    spin_payload: Array


def predict(robot: Robot, arm: Array, rows: RowInputs) -> Prediction:
    """Nest positions of `robot` with parameters arm (36,) in the order of `ARM_NAMES`, with all derivatives."""
    n, c = len(rows.q), arm[30:]
    point, R, J, tau, T = np.split(_rows(_with_derivatives, robot, arm, rows), [3, 12, 228, 234], axis=1)
    R, J, T = R.reshape(n, 3, 3), J.reshape(n, 6, 36), T.reshape(n, 6, 40)  # J, T: rows in q_real and mdh, T in payload too
    # X = J_q (I - C tau_q)^-1, from the left: six right-hand sides instead of 46.
    bent = np.eye(6) - c[:, None] * T[..., :6]
    X = np.swapaxes(np.linalg.solve(np.swapaxes(bent, 1, 2), np.swapaxes(J[..., :6], 1, 2)), 1, 2)
    forced = (X * c) @ T[..., 6:]  # mdh, payload
    d_arm = np.concatenate([J[..., 6:] + forced[..., :30], X * tau[:, None, :]], axis=2)
    d_payload = forced[:, :, 30:]
    return Prediction(point, R, d_arm[:, :3], R, d_payload[:, :3], X[:, :3], d_arm[:, 3:], d_payload[:, 3:])


def predict_points(robot: Robot, arm: Array, rows: RowInputs) -> tuple[Array, Array]:
    """Points (n, 3) m and rotations (n, 3, 3) alone, as `predict` gives them."""
    out = _rows(_place, robot, arm, rows)
    return out[:, :3], out[:, 3:].reshape(-1, 3, 3)


def _rows(build: Callable[..., ca.Function], robot: Robot, arm: Array, rows: RowInputs) -> Array:
    """One output row per reading of a function of `_Symbols`. What a rigid joint feels changes nothing and is left out."""
    function = build(rows.nest_link, rows.load_link, tuple((arm[30:] != 0.0).tolist()), *_masses(robot))
    whole = np.broadcast_to(arm, (len(rows.q), 36))
    return evaluate_rows(function, rows.q, whole, rows.payload, rows.load, rows.load_place, rows.nest)


def _masses(robot: Robot) -> tuple[bytes, ...]:
    return tuple(np.asarray(a, float).tobytes() for a in (robot.sign, robot.link_mass, robot.link_com, robot.gravity_direction))


def _table(mdh: ca.SX) -> ca.SX:
    return ca.reshape(mdh, 5, 6).T


class _Symbols:
    """A reading's symbols, the arm that they bend, and what it carries."""

    def __init__(self, load_link: int, bending: tuple[bool, ...], masses: tuple[bytes, ...]) -> None:
        self.q, self.arm, self.payload = ca.SX.sym("q", 6), ca.SX.sym("arm", 36), ca.SX.sym("payload", 4)
        self.load, self.place, self.nest = ca.SX.sym("load", 6), ca.SX.sym("place", 3), ca.SX.sym("nest", 3)
        self.sign, self.mass, self.down = (np.frombuffer(masses[k]) for k in (0, 1, 3))
        self.com, self.load_link, self.table = np.frombuffer(masses[2]).reshape(7, 3), load_link, _table(self.arm[:30])
        self.weighed = _torques(load_link, masses)
        self.real = deflected_joints(self.q, self.torques, self.arm[30:] * ca.DM(bending))
        self.frames = chain(self.real, self.table, self.sign)

    def torques(self, q: ca.SX) -> ca.SX:
        """Torque (6) N m about each axis, positive along +q: weight, and a force and moment in base axes at a place of a link."""
        return self.weighed(q, self.arm[:30], self.payload, self.load, self.place)

    def function(self, name: str, *parts: ca.SX) -> ca.Function:
        """(q, arm, payload, load, place, nest) -> the parts below each other."""
        given = [self.q, self.arm, self.payload, self.load, self.place, self.nest]
        return ca.Function(name, given, [ca.cse(ca.densify(ca.vertcat(*parts)))])


@lru_cache(maxsize=32)
def _torques(load_link: int, masses: tuple[bytes, ...]) -> ca.Function:
    """(q, mdh, payload, load, place) -> `_Symbols.torques`: as a function, for an expression is asked for again and again."""
    q, mdh, payload = ca.SX.sym("q", 6), ca.SX.sym("mdh", 30), ca.SX.sym("payload", 4)
    load, place, table = ca.SX.sym("load", 6), ca.SX.sym("place", 3), _table(mdh)
    sign, mass, com, down = (np.frombuffer(one) for one in masses)
    weight = gravity_torques(q, table, sign, mass, com.reshape(7, 3), payload[0], payload[1:], down)
    frames, force = chain(q, table, sign), load[:3]
    at = frames[load_link][:3, 3] + frames[load_link][:3, :3] @ place
    pull = [ca.SX(0)] * 6
    for j in range(load_link):
        z, o = frames[j][:3, 2], frames[j][:3, 3]
        pull[j] = sign[j] * ca.dot(z, ca.cross(at - o, force) + load[3:])
    return ca.Function("torques", [q, mdh, payload, load, place], [weight + ca.vertcat(*pull)])


@lru_cache(maxsize=32)
def _place(nest_link: int, load_link: int, bending: tuple[bool, ...], *masses: bytes) -> ca.Function:
    """Point, row-major R."""
    s = _Symbols(load_link, bending, masses)
    R = s.frames[nest_link][:3, :3]
    return s.function("place", s.frames[nest_link][:3, 3] + R @ s.nest, ca.vec(R.T))


@lru_cache(maxsize=32)
def _with_derivatives(nest_link: int, load_link: int, bending: tuple[bool, ...], *masses: bytes) -> ca.Function:
    """Point, R, then (6, 36) of the point and the spin in q_real and mdh, tau (6), and its derivative (6, 40) in q_real, mdh and
    payload, zero for joints that do not bend; matrices row-major."""
    s = _Symbols(load_link, bending, masses)
    R = s.frames[nest_link][:3, :3]
    point = s.frames[nest_link][:3, 3] + R @ s.nest
    columns = []
    for m in _motions(s):
        if m.joint >= nest_link:
            columns.append(ca.SX.zeros(6))
        elif m.turns:
            columns.append(ca.vertcat(ca.cross(m.axis, point - m.at), m.axis))
        else:
            columns.append(ca.vertcat(m.axis, 0, 0, 0))
    J = ca.horzcat(*(s.sign[i] * columns[5 * i] for i in range(6)), *columns)
    felt = [bends * s.sign[j] * row for j, (bends, row) in enumerate(zip(bending, _derivatives_of_torque(s), strict=True))]
    return s.function("with_derivatives", point, ca.vec(R.T), ca.vec(J.T), s.torques(s.real), *felt)


@dataclass(frozen=True)
class _Motion:
    """What one MD-H number does to all frames after A_joint: turn about, or shift along, `axis` (3) at `at` (3), base frame."""

    joint: int
    turns: bool
    axis: Any
    at: Any


def _motions(s: _Symbols) -> Iterator[_Motion]:
    """The 30 motions in the order of `MDH_NAMES`."""
    for i in range(6):
        theta = s.sign[i] * s.real[i] + s.table[i, 0]
        before, after = s.frames[i], s.frames[i + 1]
        x = ca.cos(theta) * before[:3, 0] + ca.sin(theta) * before[:3, 1]
        yield _Motion(i, True, before[:3, 2], before[:3, 3])
        yield _Motion(i, False, before[:3, 2], before[:3, 3])
        yield _Motion(i, False, x, after[:3, 3])
        yield _Motion(i, True, x, after[:3, 3])
        yield _Motion(i, True, after[:3, 1], after[:3, 3])


def _derivatives_of_torque(s: _Symbols) -> Iterator[ca.SX]:
    """Of each axis (40): in q_real, mdh and payload, without the axis' sign."""
    R, o = [f[:3, :3] for f in s.frames], [f[:3, 3] for f in s.frames]
    # Mass and first moment of what hangs on each axis.
    total, moment = [s.payload[0]], [s.payload[0] * (o[6] + R[6] @ s.payload[1:])]
    for i in range(6, 0, -1):
        total.insert(0, total[0] + s.mass[i])
        moment.insert(0, moment[0] + s.mass[i] * (o[i] + R[i] @ s.com[i]))
    weight, force, link = ca.SX(GRAVITY * s.down), s.load[:3], s.load_link
    at, motions = o[link] + R[link] @ s.place, list(_motions(s))
    for j in range(6):
        z, lever, arm = R[j][:, 2], moment[j] - total[j] * o[j], at - o[j]
        pull, row = float(j < link), list[Any]()
        # An axis that is turned with all it carries feels the forces turned the other way.
        turned = ca.cross(ca.cross(z, lever), weight)
        turned += pull * (ca.cross(ca.cross(z, arm), force) + ca.cross(z, s.load[3:]))
        for m in motions:
            if m.joint < j:
                row.append(ca.dot(m.axis, turned) if m.turns else 0)
                continue
            moved = ca.cross(m.axis, moment[m.joint] - total[m.joint] * m.at) if m.turns else total[m.joint] * m.axis
            work = ca.dot(moved, ca.cross(weight, z))
            if pull and m.joint < link:
                work += ca.dot(ca.cross(m.axis, at - m.at) if m.turns else m.axis, ca.cross(force, z))
            row.append(work)
        hung = o[6] + R[6] @ s.payload[1:] - o[j]
        row += [ca.dot(hung, ca.cross(weight, z)), *(s.payload[0] * ca.dot(R[6][:, k], ca.cross(weight, z)) for k in range(3))]
        yield ca.vertcat(*(s.sign[i] * row[5 * i] for i in range(6)), *row)
