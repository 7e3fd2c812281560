"""Inverse kinematics: all eight branches, in closed form; calibrated arms by Newton from the branches.

The index of a branch is KUKA's status S (KRL.md): bit 0 the wrist reaches back over axis 1, bit 1 the elbow's
side, bit 2 the sign of axis 5. Formulas: docs/robot.md.

Arms of one family have a closed inverse: axes 2 and 3 parallel, wrist axes in one point.
"""

from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike, NDArray

from robots.errors import BadInput
from robots.kinematics import forward, jacobian
from robots.pose import Array, invert, make_transform, rot_x, rot_y, rot_z
from robots.robot import Robot

# A calibrated arm differs from its family by far less; beyond this the branches of the family say nothing
# about it.
LARGEST_ANGLE = np.radians(5.0)
LARGEST_LENGTH = 0.02  # m
EXACT = 1e-12
# A wrist centre this far outside the reach is taken onto its boundary: rounding of 3 m, a thousandfold.
_REACH_ROUNDING = 1e-12
# Below this sine of axis 5, axes 4 and 6 are one direction and axis 4 is set to zero.
_WRIST_SINGULAR = 1e-10
ITERATIONS = 30
TOLERANCE = 1e-10  # m and rad: well below print rounding, well above the rounding of 3 m in double precision
_LONGEST_STEP = 0.3  # rad


@dataclass(frozen=True, eq=False)
class ArmFamily:
    """Reduced geometry of an arm with closed inverse, symbols as in docs/robot.md; lengths m, angles rad.

    s1, s3, s4, s5 = sin alpha_i = +-1; link 3 is the vector (a3, -s3 d4), of length l3 and angle psi; lateral
    = d2 + d3. T_flange_link6: constant inverse of what follows the rotation of joint 6. exact: the robot
    itself is such an arm.
    """

    sign: Array
    offset: Array
    d1: float
    a1: float
    a2: float
    l3: float
    psi: float
    lateral: float
    s1: float
    s3: float
    s4: float
    s5: float
    T_flange_link6: Array
    exact: bool


def arm_family(robot: Robot) -> ArmFamily:
    """The family member nearest to a robot: twists rounded to right angles, wrist offsets and beta set to zero.

    Raises BadInput: the robot is not near such an arm (more than 5 deg or 20 mm away).
    """
    family = _family(*(np.asarray(a, float).tobytes() for a in (robot.mdh, robot.sign)))
    if family is None:
        raise BadInput(
            f"robot '{robot.name}' is not of the family with parallel axes 2 and 3 and a spherical wrist, so its postures "
            "have no closed list; use inverse_refined with a seed"
        )
    return family


def planned_family(robot: Robot) -> ArmFamily | None:
    """The closed inverse that planning needs, None where the arm has none."""
    try:
        return arm_family(robot)
    except BadInput:
        return None


def refuse_other_arm(cell_file: Path, robot: Robot, what: str) -> None:
    """Raises BadInput where the arm that a cell names has no closed list of postures; what: who needs it."""
    if planned_family(robot) is None:
        raise BadInput(
            f"{cell_file}, robot.model: {robot.title}: axes 2 and 3 are not parallel or the wrist's axes do not meet in one "
            f"point, and {what} needs an arm where they are and do; for this one there are ocp.calibrate and ocp.diagnose alone"
        )


@lru_cache(maxsize=32)
def _family(mdh_bytes: bytes, sign_bytes: bytes) -> ArmFamily | None:
    mdh, sign = np.frombuffer(mdh_bytes).reshape(6, 5), np.frombuffer(sign_bytes)
    _, d, a, alpha, beta = mdh.T
    quarter = np.round(alpha / (np.pi / 2))
    if not np.array_equal(quarter[:5] % 2, [1, 0, 1, 1, 1]) or quarter[1] % 4 != 0:
        return None
    bent = np.abs(np.concatenate([(alpha - quarter * np.pi / 2)[:5], beta[:5]])).max()
    apart = np.abs([a[3], a[4], d[4]]).max()
    if bent > LARGEST_ANGLE or apart > LARGEST_LENGTH:
        return None
    s = np.round(np.sin(quarter * np.pi / 2))
    last = make_transform(rot_x(alpha[5]) @ rot_y(beta[5]), np.array([a[5], 0.0, d[5]]))
    return ArmFamily(
        sign=sign,
        offset=mdh[:, 0],
        d1=float(d[0]),
        a1=float(a[0]),
        a2=float(a[1]),
        l3=float(np.hypot(a[2], d[3])),
        psi=float(np.arctan2(-s[2] * d[3], a[2])),
        lateral=float(d[1] + d[2]),
        s1=float(s[0]),
        s3=float(s[2]),
        s4=float(s[3]),
        s5=float(s[4]),
        T_flange_link6=invert(last),
        exact=bool(max(bent, apart) < EXACT),
    )


def wrap(angle: ArrayLike) -> Array:
    """Angles in (-pi, pi]."""
    wrapped = np.pi - np.mod(np.pi - np.asarray(angle, float), 2 * np.pi)
    # mod of a number just below zero rounds to 2 pi itself
    return np.asarray(np.where(wrapped <= -np.pi, np.pi, wrapped))


def inverse_branches(robot: Robot, T: ArrayLike) -> tuple[Array, NDArray[np.bool_]]:
    """Joints q (n, 8, 6) rad in (-pi, pi], reachable (n, 8), of flange poses T (n, 4, 4); index = KUKA's S.

    Axis limits and whole turns are not looked at. Rows that are out of reach are nan. At the wrist singularity
    axis 4 is zero. Arms that are nearly of the family (calibrated ones) are refined to their own geometry.
    Raises BadInput: the arm is not near the family of `arm_family`.
    """
    family = arm_family(robot)
    T = np.asarray(T, float).reshape(-1, 4, 4)
    link6 = T @ family.T_flange_link6
    theta123, reachable4 = _arm_angles(family, link6[:, :3, 3])
    theta = _with_wrist(family, theta123, link6[:, :3, :3])
    reachable = np.concatenate([reachable4, reachable4], axis=1)
    q = wrap(family.sign * (theta - family.offset))
    if not family.exact:
        rows, branches = np.nonzero(reachable)
        refined = inverse_refined(robot, T[rows], q[rows, branches])
        q[rows, branches] = wrap(refined.q)
        reachable[rows, branches] = refined.converged
    q[~reachable] = np.nan
    return q, reachable


def status(robot: Robot, q: ArrayLike) -> NDArray[np.int64]:
    """KUKA's S bits 0..2 (KRL.md) of postures q (..., 6) rad, as integers (...): the index of `inverse_branches`."""
    family = arm_family(robot)
    theta = family.sign * np.asarray(q, float) + family.offset
    stretch = theta[..., 2] + family.psi  # zero where upper arm and forearm are in line
    radius = family.a1 + family.a2 * np.cos(theta[..., 1]) + family.l3 * np.cos(theta[..., 1] + stretch)
    elbow = family.sign[2] * stretch
    wrist = family.sign[4] * theta[..., 4]
    # Axis 3 counts from the in-line posture, axis 5 in [-180, 180): KRL.md's ">= 180" is the negative half
    # again.
    bits = (radius < 0, _wrap_half_open(elbow) >= 0, _wrap_half_open(wrist) < 0)
    return np.asarray(sum(bit.astype(np.int64) << i for i, bit in enumerate(bits)))


def reach_excess(robot: Robot, T: ArrayLike) -> Array:
    """How far (n,) m the wrist centre of flange poses T (n, 4, 4) or (4, 4) lies outside the reach; 0 within it."""
    family = arm_family(robot)
    centre = (np.asarray(T, float).reshape(-1, 4, 4) @ family.T_flange_link6)[:, :3, 3]
    radial = np.hypot(centre[:, 0], centre[:, 1])
    inside = np.maximum(abs(family.lateral) - radial, 0.0)
    X, Y = _in_plane(family, centre)
    distance = np.hypot(X, Y)
    outside = np.maximum(distance - (family.a2 + family.l3), abs(family.a2 - family.l3) - distance).min(axis=1)
    return np.maximum(np.maximum(outside, inside), 0.0)


def _wrap_half_open(angle: Array) -> Array:
    """Angles in [-pi, pi)."""
    return np.mod(angle + np.pi, 2 * np.pi) - np.pi


def _in_plane(family: ArmFamily, centre: Array) -> tuple[Array, Array]:
    """Wrist centre (n, 2) in the plane of axes 2 and 3, from axis 2, for the shoulder in front and behind."""
    reach = np.sqrt(np.maximum(centre[:, 0] ** 2 + centre[:, 1] ** 2 - family.lateral**2, 0.0))
    X = np.stack([reach, -reach], axis=1) - family.a1
    Y = np.broadcast_to(family.s1 * (centre[:, 2:] - family.d1), X.shape)
    return X, Y


def _arm_angles(family: ArmFamily, centre: Array) -> tuple[Array, NDArray[np.bool_]]:
    """theta 1..3 (n, 4, 3) that bring the wrist to its centre (n, 3), and reachable (n, 4); index = S bits 0 and 1."""
    a2, l3, lateral = family.a2, family.l3, family.lateral
    X, Y = _in_plane(family, centre)
    squared = (X**2 + Y**2 - a2**2 - l3**2) / (2 * a2 * l3)
    distance = np.hypot(X, Y)
    near, far = abs(a2 - l3) - _REACH_ROUNDING, a2 + l3 + _REACH_ROUNDING
    beside = np.hypot(centre[:, 0], centre[:, 1]) >= abs(lateral) - _REACH_ROUNDING
    reachable = (distance >= near) & (distance <= far) & beside[:, None]
    bend = np.arccos(np.clip(squared, -1.0, 1.0))
    theta = np.empty((len(centre), 4, 3))
    for branch in range(4):
        side, up = branch & 1, branch >> 1
        stretch = (1 if up else -1) * family.sign[2] * bend[:, side]
        radius = X[:, side] + family.a1
        theta[:, branch, 0] = np.arctan2(centre[:, 1], centre[:, 0])
        theta[:, branch, 0] -= np.arctan2(-family.s1 * lateral, radius)
        theta[:, branch, 1] = np.arctan2(Y[:, side], X[:, side])
        theta[:, branch, 1] -= np.arctan2(l3 * np.sin(stretch), a2 + l3 * np.cos(stretch))
        theta[:, branch, 2] = stretch - family.psi
    return theta, reachable[:, [0, 1, 0, 1]]


def _with_wrist(family: ArmFamily, theta123: Array, R6: Array) -> Array:
    """theta 1..6 (n, 8, 6) from theta 1..3 (n, 4, 3) and the rotation (n, 3, 3) of link 6; bit 2 of the index added."""
    s4, s5 = family.s4, family.s5
    R03 = rot_z(theta123[..., 0]) @ rot_x(family.s1 * np.pi / 2)
    R03 = R03 @ rot_z(theta123[..., 1] + theta123[..., 2]) @ rot_x(family.s3 * np.pi / 2)
    M = np.swapaxes(R03, -1, -2) @ R6[:, None]
    sine = np.hypot(M[..., 0, 2], M[..., 1, 2])
    singular = sine < _WRIST_SINGULAR
    theta = np.empty((len(M), 8, 6))
    for bit in (0, 1):
        half = slice(4 * bit, 4 * bit + 4)
        side = family.sign[4] * (1 - 2 * bit)
        theta5 = np.arctan2(side * sine, -s4 * s5 * M[..., 2, 2])
        theta4 = np.arctan2(s5 * side * M[..., 1, 2], s5 * side * M[..., 0, 2])
        theta4 = np.where(singular, family.offset[3], theta4)
        # Axis 6 takes what is left of the rotation: accurate next to the singularity too.
        R45 = rot_z(theta4) @ rot_x(s4 * np.pi / 2) @ rot_z(theta5) @ rot_x(s5 * np.pi / 2)
        rest = np.swapaxes(R45, -1, -2) @ M
        theta6 = np.arctan2(rest[..., 1, 0], rest[..., 0, 0])
        theta[:, half, :3] = theta123
        theta[:, half, 3:] = np.stack([theta4, theta5, theta6], axis=-1)
    return theta


@dataclass(frozen=True)
class Refined:
    """Joints (n, 6) rad, whether each reached the pose (n,), and what is left: position (n,) m, rotation (n,) rad."""

    q: Array
    converged: Array
    position_error: Array
    rotation_error: Array


def inverse_refined(robot: Robot, T: ArrayLike, q_seed: ArrayLike) -> Refined:
    """Joints that bring the flange to poses T (n, 4, 4), from seeds (n, 6) rad, by damped Newton steps.

    The damping falls with the error, so that convergence stays quadratic away from singularities. Limits are
    not looked at. Rows that do not arrive are marked in `converged`, never by an exception.
    """
    T = np.asarray(T, float).reshape(-1, 4, 4)
    q = np.array(np.broadcast_to(np.asarray(q_seed, float), (len(T), 6)))
    error = pose_error(T, forward(robot, q))
    for _ in range(ITERATIONS):
        # Two digits beyond the tolerance: the last step is nearly free and rounding is far below.
        rows = np.flatnonzero(np.abs(error).max(axis=1) > TOLERANCE / 100)
        if not len(rows):
            break
        q[rows] += _step(jacobian(robot, q[rows]), error[rows])
        error[rows] = pose_error(T[rows], forward(robot, q[rows]))
    position, rotation = np.linalg.norm(error[:, :3], axis=1), np.linalg.norm(error[:, 3:], axis=1)
    return Refined(q, np.maximum(position, rotation) <= TOLERANCE, position, rotation)


def pose_error(T_goal: Array, T: Array) -> Array:
    """Translation and rotation vector (n, 6) m, rad, base axes, that carry poses T (n, 4, 4) to T_goal."""
    R = T_goal[:, :3, :3] @ np.swapaxes(T[:, :3, :3], 1, 2)
    v = 0.5 * np.stack([R[:, 2, 1] - R[:, 1, 2], R[:, 0, 2] - R[:, 2, 0], R[:, 1, 0] - R[:, 0, 1]], axis=1)
    sine = np.linalg.norm(v, axis=1)
    angle = np.arctan2(sine, 0.5 * (np.trace(R, axis1=1, axis2=2) - 1.0))
    scale = np.divide(angle, sine, out=np.ones_like(sine), where=sine > 1e-12)
    return np.concatenate([T_goal[:, :3, 3] - T[:, :3, 3], v * scale[:, None]], axis=1)


def _step(J: Array, error: Array) -> Array:
    """Levenberg steps (m, 6): J^T (J J^T + lambda I)^-1 error, no longer than the largest step."""
    Jt = np.swapaxes(J, 1, 2)
    damping = 1e-3 * np.sum(error**2, axis=1) + 1e-15
    step = Jt @ np.linalg.solve(J @ Jt + damping[:, None, None] * np.eye(6), error[:, :, None])
    length = np.abs(step).max(axis=(1, 2), keepdims=True)
    return np.asarray((step * np.minimum(1.0, _LONGEST_STEP / np.maximum(length, 1e-300)))[..., 0])
