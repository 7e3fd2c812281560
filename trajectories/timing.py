"""Time parameterisation: the fastest motion along a joint path that keeps every limit at 1 ms.

The path q(s) is a cubic spline through the waypoints (C2), s the arc length of the contact on the blade, so
ds/dt is the feed. TOPP-RA is sure at its grid points only (PEERS.md: up to 20 % beyond a limit in between),
so the trajectory is sampled at 1 ms and at every knot, limits are tightened where a sample exceeds them, and
what is left is removed by slowing the motion down. docs/timing.md has the equations.
"""

from dataclasses import dataclass, replace

import numpy as np
from scipy.interpolate import CubicSpline, PPoly

from robots.errors import BadInput, Infeasible
from robots.pose import Array
from trajectories.joint_trajectory import JointTrajectory, Limits, TimingStatus, Worst, sample_times
from trajectories.toppra_law import PathRows, graded_grid, squared_speeds, stretched, time_law, times_at

WINDOW = 0.05  # s, running mean of the time law: no jumps of acceleration
RESERVE = 0.998  # rows ask for this part of a limit, so that what lies between grid points stays inside it
ROUNDS = 4  # local tightening before the whole motion is slowed down
NEAR = 1e-3  # waypoints closer than this part of the mean spacing are one waypoint


@dataclass(frozen=True)
class _Path:
    """A cleaned path: q(s), stations (n,), feed bound (n,) or None, indices kept, limits, name, no slope at its ends."""

    q: CubicSpline
    s: Array
    feed: Array | None
    kept: Array
    limits: Limits
    label: str
    at_rest: bool


@dataclass(frozen=True)
class _Tightening:
    """Divisors >= 1 at stations s (m,): of acceleration and the dynamic torque, and of speed and feed."""

    s: Array
    dynamic: Array
    speed: Array


def time_contact_path(
    q: Array,
    s: Array,
    feed: Array | float | None,
    limits: Limits,
    window: float = WINDOW,
    label: str = "pass",
    at_rest: bool = False,
) -> JointTrajectory:
    """Time the joints q (n, 6) rad at stations s (n,) m with feed at most `feed` m/s, from rest to rest.

    `feed`: scalar, (n,) or None (no bound). `at_rest`: the path itself begins and ends without a slope.
    Raises BadInput where this is no path (NaN, s that runs back, a
    jump of the joints at one station) and Infeasible where an axis leaves its range or cannot hold a posture
    at rest; `label` names the pass in messages.
    """
    path = _cleaned(q, s, feed, limits, label, at_rest)
    _check_range_and_rest(path)
    tightening = _Tightening(np.linspace(0.0, path.s[-1], 2 * len(path.s) + 1), *np.ones((2, 2 * len(path.s) + 1)))
    cells = int(np.clip(2 * len(path.s), 200, 8000))
    for attempt in range(ROUNDS):
        trajectory = _trajectory(path, _fastest(path, cells * (1 + (attempt > 0)), tightening, window))
        t = sample_times(trajectory)
        ratios = trajectory.ratios(t)
        if _excess(ratios, limits).max() <= 1.0:
            return _checked(trajectory, ratios, TimingStatus.HELD)
        tightening = _tightened(tightening, trajectory, t, _excess(ratios, limits), window)
    return _slowed(path, trajectory)


def time_joint_move(start: Array, goal: Array, limits: Limits, window: float = WINDOW, label: str = "move") -> JointTrajectory:
    """Time the straight joint-space move from start (6,) to goal (6,) rad, rest to rest; the same checks.

    Raises BadInput where the two are the same posture, Infeasible as `time_contact_path`.
    """
    start, goal = np.asarray(start, float), np.asarray(goal, float)
    length = float(np.abs(goal - start).max())
    if not length > 1e-9:
        raise BadInput(f"{label}: start and goal are the same posture, so there is no move to time; leave it out")
    k = np.linspace(0.0, 1.0, 33)
    return time_contact_path(start + k[:, None] * (goal - start), k * length, None, limits, window, label)


def _cleaned(q: Array, s: Array, feed: Array | float | None, limits: Limits, label: str, at_rest: bool = False) -> _Path:
    q, s = np.asarray(q, float), np.asarray(s, float)
    if q.ndim != 2 or s.shape != q.shape[:1] or len(s) < 2:
        raise BadInput(f"{label}: expected joints (n, 6) at n >= 2 stations, got {q.shape} at {s.shape}")
    bound = None if feed is None else np.broadcast_to(np.asarray(feed, float), s.shape)
    if bound is not None and not np.all(bound > 0):
        raise BadInput(f"{label}: the feed must be above 0 at every waypoint, not {np.min(bound)} m/s; check feed_mm_s")
    finite = np.isfinite(q).all(axis=1) & np.isfinite(s)
    if not finite.all():
        raise BadInput(f"{label}: waypoint {int(np.argmin(finite)) + 1} holds a value that is no number")
    length = s[-1] - s[0]
    near = NEAR * length / (len(s) - 1)
    kept = [0]
    for i in range(1, len(s)):
        if s[i] - s[kept[-1]] > near:
            kept.append(i)
        elif s[i] - s[kept[-1]] < -near or np.abs(q[i] - q[kept[-1]]).max() > 1e-3:
            ds, dq = (s[i] - s[kept[-1]]) * 1e3, np.degrees(np.abs(q[i] - q[kept[-1]]).max())
            raise BadInput(
                f"{label}: from waypoint {kept[-1] + 1} to {i + 1} the arc length grows by {ds:.6f} mm and the "
                f"joints by {dq:.4f} deg; stations must increase with the path"
            )
    if len(kept) < 2:
        raise BadInput(f"{label}: all {len(s)} waypoints are at one station, so there is no path to time")
    kept[-1] = len(s) - 1  # of near-duplicates at the end the goal itself is kept
    index = np.array(kept)
    stations = s[index] - s[index[0]]
    curve = CubicSpline(stations, q[index], bc_type="clamped" if at_rest else "not-a-knot")
    return _Path(curve, stations, None if bound is None else bound[index], index, limits, label, at_rest)


def _check_range_and_rest(path: _Path) -> None:
    limits = path.limits
    fine = np.unique(np.concatenate([path.s, 0.5 * (path.s[:-1] + path.s[1:])]))
    q = path.q(fine)
    outside = np.maximum(q - limits.q_max, limits.q_min - q)
    if outside.max() > 1e-9:
        i, j = np.unravel_index(np.argmax(outside), outside.shape)
        raise Infeasible(
            f"{path.label}: axis {j + 1} is {np.degrees(outside[i, j]):.3f} deg outside its range at station "
            f"{fine[i] * 1e3:.1f} mm; move the wheel or the blade in its holder"
        )
    if limits.torque is None or limits.torque_max is None:
        return
    ratio = np.abs(limits.torque(q, 0 * q, 0 * q) / limits.torque_max)
    if ratio.max() > (RESERVE - 1e-3) * limits.margin:
        i, j = np.unravel_index(np.argmax(ratio), ratio.shape)
        raise Infeasible(
            f"{path.label}: axis {j + 1} needs {ratio[i, j]:.3f} of its torque limit to hold the posture at "
            f"station {fine[i] * 1e3:.1f} mm at rest, and {limits.margin:.2f} may be used; lighten the payload "
            "or change the posture"
        )


def _rows(path: _Path, grid: Array, tightening: _Tightening) -> PathRows:
    limits, part = path.limits, RESERVE * path.limits.margin
    q, q1, q2 = path.q(grid), path.q(grid, 1), path.q(grid, 2)
    dynamic = np.interp(grid, tightening.s, tightening.dynamic)[:, None]
    slower = np.interp(grid, tightening.s, tightening.speed)
    a, b, c = [dynamic * q1 / (part * limits.qdd)], [dynamic * q2 / (part * limits.qdd)], [0 * q]
    if limits.torque is not None and limits.torque_max is not None:
        rest = limits.torque(q, 0 * q, 0 * q)
        # tau = c + a u + b x holds because inertia and Coriolis terms are linear and quadratic in the speeds
        a.append(dynamic * (limits.torque(q, 0 * q, q1) - rest) / (part * limits.torque_max))
        b.append(dynamic * (limits.torque(q, q1, q2) - rest) / (part * limits.torque_max))
        c.append(rest / (part * limits.torque_max))
    speed = part / np.maximum(np.abs(q1 / limits.qd).max(axis=1), 1e-9)
    if path.feed is not None:
        speed = np.minimum(speed, np.interp(grid, path.s, path.feed))
    return PathRows(grid, np.hstack(a), np.hstack(b), np.hstack(c), (speed / slower) ** 2)


def _fastest(path: _Path, cells: int, tightening: _Tightening, window: float) -> PPoly:
    """The time law on a grid of `cells`; other grids are tried where the solver fails numerically."""
    x = np.array([np.nan])
    for factor, both_ends in ((1.0, True), (1.37, True), (2.0, False)):
        coarse = _rows(path, np.linspace(0.0, path.s[-1], 101), tightening)
        accel = 1.0 / np.maximum(np.abs(coarse.a).max(axis=1), 1e-9)
        scale = min(float(np.median(np.sqrt(coarse.x_max))), float(np.sqrt(path.s[-1] * np.median(accel))))
        ramp = 0.0 if path.at_rest else scale**2 / (2.0 * min(accel[0], accel[-1]))
        rows = _rows(path, graded_grid(path.s, int(factor * cells), ramp), tightening)
        x = squared_speeds(rows, scale, both_ends, path.at_rest)
        if np.all(np.isfinite(x)) and np.all(x[1:-1] > 0):
            return time_law(rows.grid, x, window)
    where = path.s[-1] * float(np.argmin(np.isfinite(x))) / len(x)
    raise Infeasible(f"{path.label}: no time law was found near station {where * 1e3:.1f} mm; the waypoints are not smooth there")


def _trajectory(path: _Path, law: PPoly) -> JointTrajectory:
    worst = Worst(*np.full(4, np.nan))
    times = times_at(law, path.s)
    return JointTrajectory(path.q, law, path.s, times, path.kept, path.feed, path.limits, worst, TimingStatus.HELD)


def _excess(ratios: Array, limits: Limits) -> Array:
    """Ratios (n, 4) to what may be used: margin * limit, and the feed bound."""
    return np.asarray(ratios / np.array([limits.margin, limits.margin, limits.margin, 1.0 + 1e-9]))


def _checked(trajectory: JointTrajectory, ratios: Array, status: TimingStatus) -> JointTrajectory:
    worst = Worst(*(float(r) for r in np.minimum(ratios.max(axis=0), [np.inf, np.inf, np.inf, 1.0])))
    return replace(trajectory, worst=worst, status=status)


def _tightened(old: _Tightening, trajectory: JointTrajectory, t: Array, excess: Array, window: float) -> _Tightening:
    """Divisors raised where a sample is beyond a limit, as far as the running mean mixes."""
    dynamic, speed = np.ones_like(old.s), np.ones_like(old.s)
    beyond = np.flatnonzero(excess.max(axis=1) > 1.0)
    reach = trajectory.s(np.stack([t[beyond] - window, t[beyond] + window]))
    for i, low, high in zip(beyond, *(np.searchsorted(old.s, reach) + np.array([[-2], [2]])), strict=True):
        stretch = slice(max(low, 0), high)
        dynamic[stretch] = np.maximum(dynamic[stretch], 1.001 * excess[i, 1:3].max())
        speed[stretch] = np.maximum(speed[stretch], 1.001 * max(excess[i, 0], excess[i, 3]))
    return _Tightening(old.s, old.dynamic * dynamic, old.speed * speed)


def _slowed(path: _Path, trajectory: JointTrajectory) -> JointTrajectory:
    """Stretch time until every limit holds; converges because the torque at rest is inside its limit."""
    for _ in range(8):
        t = sample_times(trajectory)
        ratios = trajectory.ratios(t)
        excess = _excess(ratios, path.limits)
        if excess.max() <= 1.0:
            return _checked(trajectory, ratios, TimingStatus.SLOWED)
        factor = max(excess[:, 0].max(), excess[:, 3].max(), np.sqrt(max(1.0, excess[:, 1].max())), _torque_factor(trajectory, t))
        trajectory = _trajectory(path, stretched(trajectory.law, 1.0001 * factor))
    worst = int(np.argmax(excess.max(axis=1)))
    raise Infeasible(
        f"{path.label}: at station {float(trajectory.s(t[worst])) * 1e3:.1f} mm the limit ratio stays at "
        f"{excess.max():.3f} however slow the motion is; change the posture"
    )


def _torque_factor(trajectory: JointTrajectory, t: Array) -> float:
    """Time factor k that brings torque within its limit: tau = rest + dynamic / k^2."""
    limits = trajectory.limits
    if limits.torque is None or limits.torque_max is None:
        return 1.0
    q, qd, qdd = trajectory.motion(t)
    rest = limits.torque(q, 0 * q, 0 * q)
    dynamic = limits.torque(q, qd, qdd) - rest
    room = limits.margin * limits.torque_max - np.sign(dynamic) * rest
    return float(np.sqrt(max(1.0, (np.abs(dynamic) / room).max())))
