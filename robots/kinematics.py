"""Forward kinematics and Jacobian of a six-axis arm, the MD-H chain written once, in CasADi.

Symbolic builders `chain` and `geometric_jacobian` serve the big model; the numeric functions are the same
expressions, compiled per geometry and evaluated for stacks of postures.
"""

from functools import lru_cache
from typing import Any

import casadi as ca
import numpy as np

from robots.pose import Array
from robots.robot import Robot

_CHUNK = 1 << 11  # calls of one mapped function: building one for more takes longer than it saves
_STEP = 1 << 7  # calls by which mapped functions differ: building one takes as long as some hundred calls


def mdh_transform(theta: Any, d: Any, a: Any, alpha: Any, beta: Any) -> Any:
    """A = Rz(theta) Tz(d) Tx(a) Rx(alpha) Ry(beta) as a 4 x 4 CasADi expression (PHYSICS 2.2); rad, m."""
    ct, st, calpha, salpha, cb, sb = (f(x) for x in (theta, alpha, beta) for f in (ca.cos, ca.sin))
    rows = [
        [ct * cb - st * salpha * sb, -st * calpha, ct * sb + st * salpha * cb, a * ct],
        [st * cb + ct * salpha * sb, ct * calpha, st * sb - ct * salpha * cb, a * st],
        [-calpha * sb, salpha, calpha * cb, d],
        [0, 0, 0, 1],
    ]
    return ca.blockcat(rows)


def chain(q: Any, mdh: Any, sign: Any) -> list[Any]:
    """Link frames 0..6 as seven 4 x 4 expressions: base (identity), after joint 1, .., joint 6 = flange.

    q (6) rad in the controller's signs, mdh (6, 5) as in `Robot`, sign (6); CasADi symbols or numbers.
    """
    frames = [ca.SX.eye(4) if isinstance(q, ca.SX) else ca.DM.eye(4)]
    for i in range(6):
        theta = sign[i] * q[i] + mdh[i, 0]
        frames.append(frames[-1] @ mdh_transform(theta, mdh[i, 1], mdh[i, 2], mdh[i, 3], mdh[i, 4]))
    return frames


def geometric_jacobian(frames: list[Any], sign: Any, point: Any) -> Any:
    """Jacobian (6, 6) of a point fixed to the flange with respect to q: linear m/rad, angular; base axes.

    frames from `chain`, point (3) in the base frame. Column j is sign_j [z_j x (point - o_j); z_j], z_j and
    o_j the axis and origin of link frame j - 1, about which joint j turns. Rows [:3, :] alone are the point
    Jacobian.
    """
    columns = []
    for j in range(6):
        z, o = frames[j][:3, 2], frames[j][:3, 3]
        columns.append(sign[j] * ca.vertcat(ca.cross(z, point - o), z))
    return ca.horzcat(*columns)


def forward(robot: Robot, q: Array) -> Array:
    """Flange poses T_base_flange (n, 4, 4) of postures q (n, 6) rad."""
    return _evaluate(robot, "forward", q).reshape(-1, 4, 4)


def link_frames(robot: Robot, q: Array) -> Array:
    """Link frames 0..6 in the base frame, (n, 7, 4, 4), of postures q (n, 6) rad."""
    return _evaluate(robot, "frames", q).reshape(-1, 7, 4, 4)


def jacobian(robot: Robot, q: Array) -> Array:
    """Geometric Jacobian (n, 6, 6) of the flange origin with respect to q (n, 6) rad: linear m/rad, angular."""
    return _evaluate(robot, "jacobian", q).reshape(-1, 6, 6)


def _evaluate(robot: Robot, kind: str, q: Array) -> Array:
    """Rows of outputs (n, m) of postures q (n, 6)."""
    function = _compiled(kind, *(np.asarray(a, float).tobytes() for a in (robot.mdh, robot.sign)))
    return evaluate_rows(function, np.asarray(q, float).reshape(-1, 6))


def evaluate_rows(function: Any, *arguments: Array) -> Array:
    """One output row per input row of a CasADi function of column vectors, or of one that maps like it: arguments (n, k_i) ->
    (n, m)."""
    out = np.empty((len(arguments[0]), function.size1_out(0)))
    evaluate_into(out, function, *arguments)
    return out


def evaluate_into(out: Array, function: Any, *arguments: Array) -> None:
    """`evaluate_rows` written into contiguous `out` (n, m), through the arrays' own memory: CasADi's matrices would cost as much
    again as the evaluation. What is left of a block is filled up with its last row. Raises ValueError: arguments of other shapes,
    of which a buffer would take the numbers all the same."""
    wrong = [a.shape for i, a in enumerate(arguments) if a.shape != (len(out), function.size1_in(i))]
    if wrong:
        raise ValueError(f"{function.name()} at {len(out)} rows was given {wrong}")
    done = 0
    while done < len(out):
        part = out[done:]
        count = calls_at_once(len(part))
        n = min(len(part), count)
        result = part[:n] if n == count else np.empty((count, out.shape[1]))
        buffer: Any
        buffer, evaluate = _mapped(function.name(), function, count).buffer()
        rows = done + np.minimum(np.arange(count), n - 1)
        held = [np.ascontiguousarray(a[done : done + n] if n == count else a[rows], float) for a in arguments]
        for i, a in enumerate(held):
            if a.size:
                buffer.set_arg(i, a.data)
        buffer.set_res(0, result.data)
        evaluate()
        if n < count:
            part[:n] = result[:n]
        done += n


def calls_at_once(n: int) -> int:
    """Calls of the mapped function that does most of n rows: a multiple of _STEP, for fewer rows a power of two."""
    return min(n // _STEP * _STEP, _CHUNK) if n >= _STEP else 1 << (n - 1).bit_length()


@lru_cache(maxsize=1024)
def _mapped(name: str, function: Any, count: int) -> ca.Function:
    """With all numbers of the results, those that are always zero too: a buffer holds no others."""
    if isinstance(function, ca.Function) and not function.sparsity_out(0).is_dense():
        given = function.mx_in()
        function = ca.Function(name, given, [ca.densify(function(*given))])
    return function.map(count)


@lru_cache(maxsize=96)
def _compiled(kind: str, mdh_bytes: bytes, sign_bytes: bytes) -> ca.Function:
    """The function q (6) -> row-major entries of the wanted matrix, for one geometry."""
    mdh, sign = np.frombuffer(mdh_bytes).reshape(6, 5), np.frombuffer(sign_bytes)
    q = ca.SX.sym("q", 6)
    frames = chain(q, mdh, sign)
    if kind == "forward":
        matrices = [frames[-1]]
    elif kind == "frames":
        matrices = frames
    else:
        matrices = [geometric_jacobian(frames, sign, frames[-1][:3, 3])]
    out = ca.densify(ca.vertcat(*(ca.vec(m.T) for m in matrices)))
    return ca.Function(kind, [q], [out])
