"""Rigid transforms as 4 x 4 homogeneous matrices, in stacks with the leading axes free."""

from dataclasses import dataclass, fields, replace
from typing import Any, Self

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.spatial.transform import Rotation

Array = NDArray[np.float64]
Index = NDArray[np.int64]
Mask = NDArray[np.bool_]


def _axis_rotation(angle: ArrayLike, i: int, j: int) -> Array:
    a = np.asarray(angle, float)
    R = np.broadcast_to(np.eye(3), (*a.shape, 3, 3)).copy()
    c, s = np.cos(a), np.sin(a)
    R[..., i, i], R[..., j, j], R[..., i, j], R[..., j, i] = c, c, -s, s
    return R


def rot_x(angle: ArrayLike) -> Array:
    """Rotation about x by `angle` (...) rad, (..., 3, 3)."""
    return _axis_rotation(angle, 1, 2)


def rot_y(angle: ArrayLike) -> Array:
    """Rotation about y by `angle` (...) rad, (..., 3, 3)."""
    return _axis_rotation(angle, 2, 0)


def rot_z(angle: ArrayLike) -> Array:
    """Rotation about z by `angle` (...) rad, (..., 3, 3)."""
    return _axis_rotation(angle, 0, 1)


def rotation_from_abc(abc: ArrayLike) -> Array:
    """KUKA Euler angles A, B, C (..., 3) rad to Rz(A) Ry(B) Rx(C), (..., 3, 3)."""
    abc = np.asarray(abc, float)
    return rot_z(abc[..., 0]) @ rot_y(abc[..., 1]) @ rot_x(abc[..., 2])


_LETTERS = ("xyz", "xzy", "yxz", "yzx", "zxy", "zyx", "xyx", "xzx", "yxy", "yzy", "zxz", "zyz")
ROTATION_ORDERS = tuple(f"{order}_{kind}" for kind in ("intrinsic", "extrinsic") for order in _LETTERS)


def rotations_in_order(angles: ArrayLike, order: str) -> Array:
    """Rotations (..., 3, 3) of three angles (..., 3) rad in one of ROTATION_ORDERS: turns about the letters one after the other,
    about axes that turn along (intrinsic) or stay (extrinsic). Where each letter stands once the angles are those about x, y
    and z, else those of the first, second and third turn."""
    letters, kind = order.split("_")
    places = ["xyz".index(c) for c in letters] if len(set(letters)) == 3 else [0, 1, 2]
    turned = np.asarray(angles, float)[..., places]
    axes = letters.upper() if kind == "intrinsic" else letters  # SciPy's capital letters turn along
    return np.asarray(Rotation.from_euler(axes, turned.reshape(-1, 3)).as_matrix()).reshape(*turned.shape[:-1], 3, 3)


def abc_from_rotation(R: ArrayLike) -> Array:
    """KUKA Euler angles A, B, C (..., 3) rad of rotations (..., 3, 3), B in [-pi/2, pi/2].

    At B = +-90 deg, where A and C are one direction, C is 0.
    """
    R = np.asarray(R, float)
    cos_b = np.hypot(R[..., 0, 0], R[..., 1, 0])
    regular = cos_b > 1e-9
    A = np.where(regular, np.arctan2(R[..., 1, 0], R[..., 0, 0]), np.arctan2(-R[..., 0, 1], R[..., 1, 1]))
    B = np.arctan2(-R[..., 2, 0], cos_b)
    C = np.where(regular, np.arctan2(R[..., 2, 1], R[..., 2, 2]), 0.0)
    return np.stack([A, B, C], axis=-1)


def make_transform(R: ArrayLike, p: ArrayLike) -> Array:
    """Homogeneous transform (..., 4, 4) of rotation (..., 3, 3) and translation (..., 3) m."""
    R, p = np.asarray(R, float), np.asarray(p, float)
    T = np.zeros((*np.broadcast_shapes(R.shape[:-2], p.shape[:-1]), 4, 4))
    T[..., :3, :3], T[..., :3, 3], T[..., 3, 3] = R, p, 1.0
    return T


def transform_from_xyzabc(xyz: ArrayLike, abc: ArrayLike) -> Array:
    """Homogeneous transform (..., 4, 4) of a position (..., 3) m and KUKA angles A, B, C (..., 3) rad."""
    return make_transform(rotation_from_abc(abc), xyz)


def invert(T: ArrayLike) -> Array:
    """Inverse of rigid transforms (..., 4, 4)."""
    T = np.asarray(T, float)
    Rt = np.swapaxes(T[..., :3, :3], -1, -2)
    return make_transform(Rt, -(Rt @ T[..., :3, 3:])[..., 0])


def apply(T: ArrayLike, points: ArrayLike) -> Array:
    """Transform points (..., 3) by T (..., 4, 4), leading axes broadcast."""
    T, points = np.asarray(T, float), np.asarray(points, float)
    return np.asarray((T[..., :3, :3] @ points[..., None])[..., 0] + T[..., :3, 3])


@dataclass(frozen=True)
class Stacked:
    """Arrays with one leading axis, the rows, beside names and numbers that hold for all of them."""

    def take(self, rows: Any) -> Self:
        """The rows of an index, slice or mask; names keep their indices."""
        known = {f.name: getattr(self, f.name) for f in fields(self)}
        taken: dict[str, Any] = {name: value[rows] for name, value in known.items() if isinstance(value, np.ndarray)}
        taken |= {name: value.take(rows) for name, value in known.items() if isinstance(value, Stacked)}
        return replace(self, **taken)


def skew(v: ArrayLike) -> Array:
    """Matrix [v]x (..., 3, 3) with [v]x w = v x w, of vectors (..., 3)."""
    v = np.asarray(v, float)
    S = np.zeros((*v.shape, 3))
    S[..., 0, 1], S[..., 0, 2], S[..., 1, 2] = -v[..., 2], v[..., 1], -v[..., 0]
    S[..., 1, 0], S[..., 2, 0], S[..., 2, 1] = v[..., 2], -v[..., 1], v[..., 0]
    return S


def abc_by_spin(T: Array) -> Array:
    """Derivative (3, 3) of KUKA angles A, B, C of T with respect to a small turn from the left (central differences)."""
    step, columns = 1e-6, []
    for axis in np.eye(3):
        plus, minus = (abc_from_rotation(Rotation.from_rotvec(s * axis).as_matrix() @ T[:3, :3]) for s in (step, -step))
        columns.append(((plus - minus + np.pi) % (2 * np.pi) - np.pi) / (2 * step))
    return np.stack(columns, axis=1)
