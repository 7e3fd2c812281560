"""The time law s(t) along a given path: TOPP-RA on a grid, then a piecewise polynomial without jumps of
acceleration.

TOPP-RA (Pham & Pham 2018, IEEE T-RO 34(3), doi 10.1109/TRO.2018.2819195) returns the squared path speed x =
(ds/dt)^2 at grid points; between them ds^2/dt^2 is constant. Every limit on joint acceleration, torque, joint
speed or feed is linear in (u, x) = (d2s/dt2, x) at a fixed s, so all of them enter as rows `|c + k (a u + b
x)| <= 1` and `x <= x_max`.
"""

import warnings
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.interpolate import PPoly

from robots.pose import Array


@dataclass(frozen=True)
class PathRows:
    """Limits along a path at grid points: `|c + a u + b x| <= 1` row by row, and `x <= x_max`.

    a, b, c (n, m) with c the part at rest; x_max (n,) in m^2/s^2; grid (n,) m, increasing from 0.
    """

    grid: Array
    a: Array
    b: Array
    c: Array
    x_max: Array


def _toppra() -> tuple[Any, Any, Any, Any]:
    # toppra's docstrings hold invalid escapes, which warn when it is compiled, and it loads a plotting
    # library: imported on first use, with its own warnings off.
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        from toppra.algorithm import TOPPRA
        from toppra.constraint import LinearConstraint
        from toppra.constraint.linear_constraint import canlinear_colloc_to_interpolate
        from toppra.interpolator import AbstractGeometricPath
    return TOPPRA, LinearConstraint, canlinear_colloc_to_interpolate, AbstractGeometricPath


def squared_speeds(rows: PathRows, scale: float, at_both_ends: bool = True, moving: bool = False) -> Array:
    """Largest admissible x = (ds/dt)^2 at the grid points, (n,) m^2/s^2; NaN where the solver failed. From rest to rest, or
    `moving` along the path as fast as it may at both ends, where the path itself rests.

    `scale` [m/s] is a typical speed: toppra's absolute tolerances expect numbers near 1. `at_both_ends` asks
    that the acceleration of an interval fits the rows at both of its ends (otherwise at its start alone).
    """
    TOPPRA, LinearConstraint, both_ends, AbstractGeometricPath = _toppra()
    grid = rows.grid / scale
    a, b = rows.a * scale, rows.b * scale**2
    stacked = [np.hstack([m, -m]) for m in (a, b, rows.c)]
    bound = np.stack([np.zeros(len(grid)), rows.x_max / scale**2], axis=1)
    F, g = np.eye(2 * a.shape[1]), np.ones(2 * a.shape[1])

    class Rows(LinearConstraint):  # type: ignore[misc, valid-type]
        def __init__(self) -> None:
            super().__init__()
            self.identical, self.dof, self._format_string = True, a.shape[1], ""

        def compute_constraint_params(self, path: Any, gridpoints: Array) -> tuple[Any, ...]:
            if at_both_ends:
                return both_ends(*stacked, F, g, None, bound, gridpoints, identical=True)
            return (*stacked, F, g, None, bound)

    class Interval(AbstractGeometricPath):  # type: ignore[misc, valid-type]
        dof = a.shape[1]
        path_interval = np.array([grid[0], grid[-1]])

    solver = TOPPRA([Rows()], Interval(), gridpoints=grid, solver_wrapper="seidel")
    ends = [float(np.sqrt(x)) / scale if moving else 0.0 for x in rows.x_max[[0, -1]]]
    _, speed, _ = solver.compute_parameterization(*ends)
    if speed is None:
        return np.full(len(grid), np.nan)
    return np.asarray(speed, float) ** 2 * scale**2


def graded_grid(stations: Array, cells: int, ramp: float) -> Array:
    """Grid (n,) on [0, L]: about `cells` equal cells, and cells equal in time over the first and last 2
    `ramp` metres.

    From rest s grows with t^2, so the nodes next to the ends are spaced quadratically; otherwise a short ramp
    falls into one cell and the start is lost.
    """
    length = float(stations[-1])
    uniform = np.linspace(0.0, length, cells + 1)
    end = min(2.0 * ramp, 0.5 * length)
    graded = end * np.linspace(0.0, 1.0, 41)[1:] ** 2
    nodes = np.unique(np.concatenate([uniform, graded, length - graded]))
    shortest = min(end / 1600.0, length / cells) * 0.3
    keep = np.concatenate([[True], np.diff(nodes) > shortest])
    nodes = nodes[keep]
    nodes[-1] = length
    return np.asarray(nodes)


def time_law(grid: Array, x: Array, window: float) -> PPoly:
    """s(t) from squared speeds x (n,) at grid points (n,) m: accelerations are constant in a cell, then
    averaged.

    The running mean over `window` seconds, s_w(t) = 1/w int_{t-w}^{t} s, makes the path acceleration
    continuous, keeps rest at both ends, never raises the largest feed or path acceleration, and adds `window`
    to the duration. The result is a piecewise cubic, exact: no resampling. window = 0 gives the piecewise
    quadratic itself.
    """
    v = np.sqrt(np.maximum(x, 0.0))
    dt = 2.0 * np.diff(grid) / (v[:-1] + v[1:])
    t = np.concatenate([[0.0], np.cumsum(dt)])
    u = np.diff(v) / dt
    quadratic = PPoly(np.array([0.5 * u, v[:-1], grid[:-1]]), t)
    return quadratic if window <= 0 else _running_mean(quadratic, window)


def _running_mean(law: PPoly, window: float) -> PPoly:
    T, length = law.x[-1], float(law(law.x[-1]))
    # extended by rest on both sides, so that the mean can run over the ends
    c = np.zeros((3, law.c.shape[1] + 2))
    c[:, 1:-1] = law.c
    c[2, -1] = length
    extended = PPoly(c, np.concatenate([[-2.0 * window], law.x, [T + 2.0 * window]]))
    knots = np.unique(np.concatenate([law.x, law.x + window]))
    knots = knots[np.concatenate([[True], np.diff(knots) > 1e-9])]
    knots[-1] = T + window
    speed, accel = extended.derivative(), extended.derivative(2)
    left, back, middle = knots[:-1], knots[:-1] - window, 0.5 * (knots[:-1] + knots[1:])
    jerk = (accel(middle) - accel(middle - window)) / window
    # accelerations are taken from the middle of the cell: at a knot the left and the right value differ
    s2 = (speed(middle) - speed(middle - window)) / window - jerk * (middle - left)
    s1 = (extended(left) - extended(back)) / window
    # positions by summing the pieces: a difference of integrals would leave steps of 1e-13 m between them
    dt = np.diff(knots)
    steps = ((jerk / 6.0 * dt + s2 / 2.0) * dt + s1) * dt
    s0 = np.concatenate([[0.0], np.cumsum(steps[:-1])])
    return PPoly(np.array([jerk / 6.0, s2 / 2.0, s1, s0]), knots)


def stretched(law: PPoly, factor: float) -> PPoly:
    """The same motion `factor` times slower: speeds divided by it, accelerations by its square."""
    powers = np.arange(law.c.shape[0])[::-1]
    return PPoly(law.c / factor ** powers[:, None], law.x * factor)


def times_at(law: PPoly, stations: Array) -> Array:
    """When s(t) reaches the stations (n,) m, increasing, (n,) s."""
    s = law(law.x)
    s = np.maximum.accumulate(s)
    index = np.clip(np.searchsorted(s, stations, side="right") - 1, 0, len(law.x) - 2)
    low, high = law.x[index], law.x[index + 1]
    for _ in range(50):  # s(t) is monotone in a cell, and at rest its slope is 0: bisection instead of Newton
        middle = 0.5 * (low + high)
        below = law(middle) < stations
        low, high = np.where(below, middle, low), np.where(below, high, middle)
    t = 0.5 * (low + high)
    t[stations <= 0] = 0.0
    t[stations >= s[-1] * (1 - 1e-12)] = law.x[-1]  # at rest rounding of s is much time
    return np.asarray(t)
