"""A robot file from a URDF: six revolute axes in the distal MD-H form, limits, and masses where the URDF has them.

Pinocchio's parser reads the URDF. Frame i - 1 is laid on the axis of joint i: x along the common normal of two axes, for parallel
ones from axis to axis with d = 0, and the axis' own sense as `sign` (Denavit and Hartenberg 1955; Hayati 1983 for parallel axes).
The result is compared with the URDF's own kinematics before it is given.
"""

from dataclasses import dataclass
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import casadi as ca
import numpy as np
import pinocchio as pin

from robots.bounds import MEGABYTE, read_whole
from robots.errors import BadInput, shown, words_kept_back
from robots.kinematics import chain, evaluate_rows, mdh_transform
from robots.pose import Array, invert, make_transform, rot_z

MOST_BYTES = 5 * MEGABYTE
PARALLEL = 1e-6  # sine of the angle below which two axes are one direction: a millionth of a metre a metre
MEETING = 1e-9  # m
SAME = 1e-9  # m, and of a rotation's entries: the arm and the URDF are the same machine
POSTURES = 100
MOST_TURNED = 25.0  # rad to either side, four turns: no axis of an arm goes as far, and thirty degrees written as radians do
FARTHEST, HEAVIEST = 100.0, 1e5  # m; kg and kg m^2


@dataclass(frozen=True)
class ImportedArm:
    """Tables of a robot file (mm, deg, kg), and what the user should know of it."""

    tables: dict[str, Any]
    notices: tuple[str, ...]


def read_urdf(path: Path, flange: str | None = None) -> ImportedArm:
    """The arm of a URDF file; flange: the link that the tool is screwed to, without it the last one of the chain.

    Raises BadInput: the file cannot be read, is no URDF, has not six revolute joints in a row, no limits, or a flange or base
    that no MD-H chain reaches.
    """
    model = _model(path)
    name = _flange_name(path, model, flange)
    data = model.createData()
    pin.framesForwardKinematics(model, data, pin.neutral(model))
    _refuse_numbers(path, model, data)
    lines = [_axis(model, data, i) for i in range(1, 7)]
    at_flange = np.array(data.oMf[model.getFrameId(name)].homogeneous)
    base = _on_first_axis(lines[0])
    ways = [along for _, along in lines]
    if ways[5] @ at_flange[:3, 2] < 0:  # z of the last frames out of the flange, as data sheets draw it
        ways[5] = -ways[5]
    frames, rows, signs = [base], [], []
    for i in range(6):
        row = _last_row(path, invert(frames[-1]) @ at_flange, name) if i == 5 else _row(frames[-1], lines[i + 1][0], ways[i + 1])
        signs.append(1 if lines[i][1] @ frames[-1][:3, 2] > 0 else -1)
        rows.append(row)
        frames.append(frames[-1] @ np.array(mdh_transform(*row)))
    mdh = np.array(rows)
    _refuse_other(path, model, name, base, mdh, np.array(signs))
    notices = []
    if np.abs(base - np.eye(4)).max() > SAME:
        notices.append(
            f"the base frame was laid on the first axis: it stands at {_mm(base[:3, 3])} mm in the URDF's root, its z axis along "
            "the axis; give places in the cell in this frame"
        )
    masses = _links(model, data, frames)
    weightless = [str(model.names[i]) for i in range(1, 7) if masses is not None and not model.inertias[i].mass > 0]
    if weightless:
        notices.append(f"what moves with joint {', '.join(weightless)} has no mass in the URDF: it is taken to weigh nothing")
    if masses is None:
        notices.append("the URDF has no masses: nothing that depends on weight is offered until [links] are added")
    tables = _tables(path, model, mdh, signs, masses)
    notices.append(
        f"flange is link '{name}'; accelerations, stiffness and collision shapes are in no URDF: add "
        "limits.acceleration_deg_s2, [stiffness] and [[shape]] before anything moves by it"
    )
    return ImportedArm(tables, tuple(notices))


def _model(path: Path) -> Any:
    """The URDF's six revolute joints. Raises BadInput."""
    try:
        text = read_whole(path, MOST_BYTES, "a URDF file").decode("utf-8-sig")
    except UnicodeDecodeError as error:
        raise BadInput(f"{path}: byte {error.start} is not UTF-8; save the URDF as UTF-8 text") from None
    try:
        root = ElementTree.fromstring(text)
    except ElementTree.ParseError as error:
        raise BadInput(f"{path}: is not XML ({error}); correct it") from None
    if root.tag != "robot" or path.suffix == ".xacro":
        raise BadInput(f"{path}: holds no <robot> of a URDF; give one (a xacro is expanded first: `xacro FILE > arm.urdf`)")
    with words_kept_back() as said:
        try:
            model = pin.buildModelFromXML(text)
        except (ValueError, RuntimeError) as error:
            why = " ".join((said() or str(error)).split())
            raise BadInput(f"{path}: is no URDF that can be read ({shown(why, 200)}); correct it") from None
    kinds = [joint.shortname() for joint in model.joints[1:]]
    moving = list(model.names)[1:]
    for joint, kind in zip(moving, kinds, strict=True):
        if not kind.startswith("JointModelR"):
            raise BadInput(
                f"{path}: joint '{shown(joint)}' is not revolute; fix it in the URDF, an arm here has six revolute axes"
            )
    if len(kinds) != 6:
        raise BadInput(f"{path}: has {len(kinds)} moving joints, six are needed; fix those of a gripper or a track in the URDF")
    coupled = [
        joint.get("name") for joint in root.iter("joint") if joint.find("mimic") is not None and joint.get("name") in moving
    ]
    if coupled:
        raise BadInput(
            f"{path}: joint '{shown(str(coupled[0]))}' follows another one (mimic), as in a parallelogram; an arm here has "
            "six axes of their own"
        )
    if list(model.parents)[1:] != list(range(6)):
        raise BadInput(f"{path}: its six joints do not follow each other; give a serial arm")
    return model


def _flange_name(path: Path, model: Any, asked: str | None) -> str:
    """The link that is the flange: asked for, or the last that hangs on joint 6."""
    links = [f.name for f in model.frames if f.type == pin.FrameType.BODY]
    hung = [f.name for f in model.frames if f.type == pin.FrameType.BODY and f.parentJoint == 6]
    if asked is None:
        return str(hung[-1])
    if asked not in hung:
        there = "is no link" if asked not in links else "does not hang on the last joint"
        raise BadInput(f"{path}: --flange '{shown(asked)}' {there}; there {', '.join(map(shown, hung))} hang")
    return asked


def _refuse_numbers(path: Path, model: Any, data: Any) -> None:
    """Raises BadInput: a joint without an axis, a place or an inertia that no arm has."""
    columns = pin.computeJointJacobians(model, data, pin.neutral(model))
    for i in range(1, 7):
        name, place, body = shown(model.names[i]), np.array(data.oMi[i].homogeneous), model.inertias[i]
        if not abs(float(np.linalg.norm(columns[3:, i - 1])) - 1.0) < 1e-6:
            raise BadInput(f"{path}: joint '{name}' has no axis; give <axis xyz=..> a direction")
        if not (np.isfinite(place).all() and np.abs(place[:3, 3]).max() < FARTHEST):
            raise BadInput(
                f"{path}: joint '{name}' stands more than {FARTHEST:g} m away; a URDF is in metres, correct its origin"
            )
        if not all(np.isfinite(v).all() and np.abs(v).max() < HEAVIEST for v in (body.mass, body.lever, np.array(body.inertia))):
            raise BadInput(f"{path}: the link after joint '{name}' has a mass or inertia that no arm has; correct <inertial>")


def _axis(model: Any, data: Any, joint: int) -> tuple[Array, Array]:
    """A point (3,) and the direction (3,) of a joint's axis in the root frame, all joints at zero."""
    column = pin.computeJointJacobians(model, data, pin.neutral(model))[:, joint - 1]
    turn = column[3:] / np.linalg.norm(column[3:])
    return np.asarray(np.cross(turn, column[:3])), np.asarray(turn)


def _on_first_axis(line: tuple[Array, Array]) -> Array:
    """The root frame where its z axis is joint 1's, else one on that axis, as near to the root's as can be."""
    point, along = line
    z = along if along[2] >= -PARALLEL else -along
    origin = point - z * (point @ z)  # the axis' point nearest to the root's origin
    if np.hypot(*z[:2]) < PARALLEL and np.linalg.norm(origin) < MEETING:
        return np.eye(4)
    x = np.eye(3)[0] if abs(z[0]) < 0.9 else np.eye(3)[1]
    x = x - z * (x @ z)
    x /= np.linalg.norm(x)
    return make_transform(np.stack([x, np.cross(z, x), z], axis=1), origin)


def _row(T: Array, point: Array, along: Array) -> Array:
    """theta, d, a, alpha, beta (5,) from frame T, z on one axis, to a frame whose z is on the next axis."""
    z, o = T[:3, 2], T[:3, 3]
    normal = np.cross(z, along)
    if np.linalg.norm(normal) < PARALLEL:
        w = along if along @ z > 0 else -along
        foot = point + w * (w @ (o - point))
        x = foot - o
        d = 0.0
    else:
        w = along
        # Feet of the common normal: o + d z on this axis, point + k w on the next one.
        d, k = np.linalg.lstsq(np.stack([z, -w], axis=1), point - o, rcond=None)[0]
        foot = point + k * w
        x = foot - (o + d * z)
        if np.linalg.norm(x) < MEETING:
            x = normal if normal @ T[:3, 0] >= -PARALLEL else -normal
    a = float(np.linalg.norm(foot - o - d * z))
    x = x / np.linalg.norm(x) if np.linalg.norm(x) > MEETING else T[:3, 0]
    theta = np.arctan2(x @ T[:3, 1], x @ T[:3, 0])
    alpha = np.arctan2(np.cross(z, w) @ x, z @ w)
    return np.array([theta, d, a if a > MEETING else 0.0, alpha, 0.0])


def _last_row(path: Path, T: Array, name: str) -> Array:
    """theta, d, a, alpha, beta (5,) of the flange's pose T on the frame of joint 6. Raises BadInput where there are none."""
    (x, y, d), R = T[:3, 3], T[:3, :3]
    a = float(np.hypot(x, y))
    if a < MEETING:
        theta = float(np.arctan2(-R[0, 1], R[1, 1]))
        return np.array([theta, d, 0.0, *_twist(rot_z(-theta) @ R)])
    theta = float(np.arctan2(y, x))
    rest = rot_z(-theta) @ R
    if abs(rest[0, 1]) > SAME:
        raise BadInput(
            f"{path}: link '{shown(name)}' stands beside axis 6 and turned so that no MD-H row reaches it; name the flange "
            "itself with --flange"
        )
    return np.array([theta, d, a, *_twist(rest)])


def _twist(R: Array) -> tuple[float, float]:
    """alpha, beta with R = Rx(alpha) Ry(beta)."""
    return float(np.arctan2(R[2, 1], R[1, 1])), float(np.arctan2(R[0, 2], R[0, 0]))


def _refuse_other(path: Path, model: Any, name: str, base: Array, mdh: Array, sign: Array) -> None:
    """Compare with the URDF's own kinematics at random postures. Raises BadInput: they differ."""
    rng, data, number = np.random.default_rng(0), model.createData(), model.getFrameId(name)
    postures, symbol = rng.uniform(-np.pi, np.pi, (POSTURES, 6)), ca.SX.sym("q", 6)
    flange = ca.Function("flange", [symbol], [ca.vec(chain(symbol, mdh, sign)[-1].T)])
    for q, own in zip(postures, base @ evaluate_rows(flange, postures).reshape(-1, 4, 4), strict=True):
        pin.framesForwardKinematics(model, data, _configuration(model, q))
        off = np.abs(np.array(data.oMf[number].homogeneous) - own).max()
        if off > SAME:
            raise BadInput(f"{path}: no MD-H chain was found for it (off by {off:.2g} m); write the robot file by hand")


def _configuration(model: Any, q: Array) -> Array:
    """Pinocchio's configuration of six angles: a continuous joint has cosine and sine."""
    parts = [[v] if joint.nq == 1 else [np.cos(v), np.sin(v)] for joint, v in zip(model.joints[1:], q, strict=True)]
    return np.array([v for part in parts for v in part])


def _links(model: Any, data: Any, frames: list[Array]) -> dict[str, Any] | None:
    """`[links]`: masses, centres and inertias in the MD-H frames; None where the URDF has no masses."""
    if not any(model.inertias[i].mass > 0 for i in range(1, 7)):
        return None
    found: dict[str, Any] = {"source": "the URDF", "base": {"mass_kg": 0.0, "com_mm": [0.0, 0.0, 0.0]}}
    found["base"]["inertia_kg_m2"] = [0.0] * 6
    for i in range(1, 7):
        own = model.inertias[i]
        X = invert(frames[i]) @ np.array(data.oMi[i].homogeneous)
        centre = X[:3, :3] @ np.array(own.lever) + X[:3, 3]
        inertia = X[:3, :3] @ np.array(own.inertia) @ X[:3, :3].T
        six = [inertia[0, 0], inertia[1, 1], inertia[2, 2], inertia[0, 1], inertia[0, 2], inertia[1, 2]]
        found[f"link{i}"] = {
            "mass_kg": round(float(own.mass), 9),
            "com_mm": [round(1e3 * float(v), 6) + 0.0 for v in centre],
            "inertia_kg_m2": [round(float(v), 9) + 0.0 for v in six],
        }
    return found


def _tables(path: Path, model: Any, mdh: Array, signs: list[int], masses: dict[str, Any] | None) -> dict[str, Any]:
    """The robot file's tables, rounded to a nanometre and a billionth of a degree."""
    source = f"{path.name}, by its URDF"
    degrees = np.degrees(mdh)
    columns = {"theta_deg": degrees[:, 0], "d_mm": 1e3 * mdh[:, 1], "a_mm": 1e3 * mdh[:, 2]}
    columns |= {"alpha_deg": degrees[:, 3], "beta_deg": degrees[:, 4]}
    limits: dict[str, Any] = {"source": source}
    ranges, at = [], 0
    for joint in model.joints[1:]:
        ends = np.array([model.lowerPositionLimit[at], model.upperPositionLimit[at]])
        ranges.append(np.radians([-360.0, 360.0]) if joint.nq == 2 else ends)
        at += joint.nq
    speed, torque = np.array(model.velocityLimit), np.array(model.effortLimit)
    for i in range(6):
        name = shown(model.names[i + 1])
        if not (np.isfinite(ranges[i]).all() and ranges[i][0] < ranges[i][1]):
            raise BadInput(f"{path}: joint '{name}' has no range; add <limit lower=.. upper=..> in rad")
        if np.abs(ranges[i]).max() > MOST_TURNED:
            farthest = float(np.abs(ranges[i]).max())
            raise BadInput(f"{path}: joint '{name}' turns as far as {farthest:g} rad; a URDF is in radians, correct its <limit>")
        if not (np.isfinite(speed[i]) and speed[i] > 0):
            raise BadInput(f"{path}: joint '{name}' has no speed; add <limit velocity=..> in rad/s")
    low, high = np.degrees(np.array(ranges)).T
    limits |= {"q_min_deg": _rounded(low), "q_max_deg": _rounded(high), "speed_deg_s": _rounded(np.degrees(speed))}
    if (np.isfinite(torque) & (torque > 0)).all():
        limits["torque_Nm"] = _rounded(torque)
    word = "".join(c if c.isascii() and (c.isalnum() or c in "_.-") else "_" for c in model.name)[:100] or "arm"
    found = {"name": word, "title": model.name[:100] or word}
    found["geometry"] = {"source": source, "sign": signs} | {key: _rounded(values) for key, values in columns.items()}
    return found | {"limits": limits} | ({} if masses is None else {"links": masses})


def _rounded(values: Array) -> list[float]:
    return [round(float(v), 9) + 0.0 for v in values]


def _mm(place: Array) -> str:
    return "[" + ", ".join(f"{1e3 * v:.3f}" for v in place) + "]"
