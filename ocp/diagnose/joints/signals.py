"""What the log of link-side encoders says at its instants: speeds, directions, load, the motor's angle a moment ago; its noise.

The noise is white from instant to instant, and a wander that no function of the state explains. Residuals of a log at 250 Hz
are far from independent: taken as white they would make every ripple certain. The wander is an Ornstein-Uhlenbeck process,
covariance s^2 exp(-|dt| / T) (Rasmussen and Williams 2006, eq. B.27), white noise is added. Both are estimated by maximum
likelihood from what a broad regression on the state (angle, speed, acceleration, load, their squares and signs) leaves: not
from the gap under diagnosis, which would hide in the wander. A link-side encoder has errors of its own, eccentric or bent, of
its accuracy class: so much of what springs, friction and a delay leave belongs to the wander too.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.interpolate import CubicSpline
from scipy.linalg import cho_factor, cho_solve, solve_triangular
from scipy.optimize import minimize

from ocp.diagnose import rules
from ocp.diagnose.joints.log import JointLog, refuse_radians, refuse_torque_unit
from robots.gravity import weight_torques
from robots.pose import Array, Index, Mask
from robots.rigid_body import inverse_dynamics
from robots.robot import Robot
from robots.tracker_readings import Hanging

MOST = 1500  # readings kept of a log: more of them are no more independent, and the search is linear in them


@dataclass(frozen=True)
class Signals:
    """n instants of a log, thinned.

    log: those rows; qd (n, 6) rad/s of the motor side; direction (n, 6) sign of the last motion; tau (n, 6) N m load torque,
    positive along +q (the motor's with the other sign); viscous (n, 6) rad/s, dry (n, 6), qdd (n, 6) rad/s^2: speed, sign of the
    motion, acceleration, smoothed where tau was recorded; measured (6,) whether it was, or is the believed arm's weight and
    inertia; piece (n,): stretch without a hole, splines[piece][j]: motor angle in it; instant (6,) rad: `_instant_noise`; sign:
    of the recorded torques (`load_sign`).
    """

    log: JointLog
    qd: Array
    qdd: Array
    direction: Array
    tau: Array
    viscous: Array
    dry: Array
    measured: Mask
    piece: Index
    splines: tuple[tuple[CubicSpline, ...], ...]
    instant: Array
    sign: float = 1.0

    def moving(self, joint: int) -> Mask:
        """Rows (n,) in which a joint moves; all where it mostly rests. Stick friction hides what load a joint at rest has."""
        speed = np.abs(self.qd[:, joint - 1])
        found = np.asarray(speed > rules.RESTING_SPEED * speed.max())
        return found if found.mean() > 0.3 else np.ones(len(found), bool)

    def inside(self) -> Mask:
        """Rows (n,) away from the ends of their stretch, where the motor's angle a delay ago (or ahead) was recorded too."""
        start, end = np.array([of_piece[0].x[[0, -1]] for of_piece in self.splines])[self.piece].T
        margin = np.minimum(rules.LONGEST_DELAY, 0.05 * (end - start))
        return np.asarray((self.log.time >= start + margin) & (self.log.time <= end - margin))

    def motor(self, joint: int, delay: float, order: int = 0) -> Array:
        """Motor angle (n,) rad of a joint `delay` s before each instant, or its derivative of an order; at the ends of a stretch
        the one there."""
        out = np.empty(len(self.log))
        for k, of_run in enumerate(self.splines):
            rows = self.piece == k
            spline = of_run[joint - 1]
            out[rows] = spline(np.clip(self.log.time[rows] - delay, spline.x[0], spline.x[-1]), order)
        return out


def signals_of(log: JointLog, robot: Robot, payload: Hanging, like: Signals | None = None) -> Signals:
    """Signals of a log, thinned to `MOST` readings. The sign of the recorded torques is the one with which the joints give way
    (`load_sign`); `like`: the log without a link side that takes it from there. Raises BadInput: torques in another unit."""
    piece = _pieces(log)
    splines, qd, qdd, direction, rubbing = _motion(log, piece)
    measured = np.asarray(np.isfinite(log.tau).any(axis=0))
    refuse_radians(log, robot)
    refuse_torque_unit(log, weight_torques(robot, log.q, payload.mass, payload.com))
    load = -inverse_dynamics(robot, payload.mass, payload.com, log.q, qd, qdd)
    tau = np.where(measured, -_smoothed(log, piece, _filled(log)), load)
    count = int(np.isfinite(log.link[:, [j - 1 for j in log.joints]]).sum())
    rows = np.arange(0, len(log), max(1, int(np.ceil(count / MOST))), dtype=np.int64)  # that `MOST` readings are left
    viscous, dry, pushed = (_smoothed(log, piece, of)[rows] for of in (qd, rubbing, qdd))
    moves = qd[rows], np.where(measured, pushed, qdd[rows]), direction[rows], tau[rows], viscous, dry
    found = Signals(log.take(rows), *moves, measured, piece[rows], splines, _instant_noise(log))
    sign = load_sign(found) if like is None else like.sign
    return replace(found, tau=np.where(found.measured, sign * found.tau, found.tau), sign=sign)


def load_sign(signals: Signals) -> float:
    """+1 where the recorded torques are the motor's, -1 where they are the load's.

    A joint gives way to its load. The one sign of all joints with which link less motor angle, a constant and a lag apart,
    goes along with the load; drives differ in what they call positive.
    """
    total = 0.0
    for j in signals.log.joints:
        if not signals.measured[j - 1]:
            continue
        both = np.column_stack([signals.log.link[:, j - 1] - signals.log.q[:, j - 1], signals.tau[:, j - 1]])
        known = np.isfinite(both[:, 0])
        columns, both = np.column_stack([np.ones(known.sum()), signals.qd[known, j - 1]]), both[known]
        left = both - columns @ np.linalg.lstsq(columns, both, rcond=None)[0]
        scale = float(np.linalg.norm(left[:, 0]) * np.linalg.norm(left[:, 1]))
        total += float(left[:, 0] @ left[:, 1]) / scale if scale > 0 else 0.0
    return -1.0 if total < 0 else 1.0


def _instant_noise(log: JointLog) -> Array:
    """White noise (6,) rad of link less motor angle between all rows of a log, by the median of third differences; infinite
    where neighbours are not recorded."""
    third = np.diff(log.link - log.q, 3, axis=0)[log.run[3:] == log.run[:-3]] / np.sqrt(20.0)
    found = [np.abs(one[np.isfinite(one)]) for one in third.T]
    return np.maximum([1.4826 * np.median(one) if len(one) > FEW else np.inf for one in found], rules.LEAST_ENCODER_NOISE)


def _pieces(log: JointLog) -> Index:
    """Stretches (n,) of a log: a run, and anew behind a hole in its rows, over which nothing is known of the motion."""
    step, same = np.diff(log.time), np.diff(log.run) == 0
    usual = np.array(
        [np.median(step[same & (log.run[1:] == k)]) if np.sum(log.run == k) > 1 else 0.0 for k in range(len(log.runs))]
    )
    hole = step > np.maximum(rules.HOLE_ROWS * usual[log.run[1:]], rules.HOLE)
    return np.concatenate([[0], np.cumsum(~same | hole)])


def _motion(log: JointLog, piece: Index) -> tuple[tuple[tuple[CubicSpline, ...], ...], Array, Array, Array, Array]:
    """Splines of the motor side by stretch, speeds, accelerations, directions of the last motion, and of friction, which turns
    round in the middle of a rest."""
    qd, qdd, direction, rubbing = (np.zeros_like(log.q) for _ in range(4))
    splines = []
    for k in range(piece[-1] + 1):
        rows = np.flatnonzero(piece == k)
        time = log.time[rows]
        if len(rows) < 4:  # a stretch too short to differentiate stands still
            splines.append(tuple(CubicSpline([time[0], time[0] + 1.0], [angle, angle]) for angle in log.q[rows[0]]))
            continue
        smooth = _over(log.q[rows], time, rules.ANGLE_WINDOW)
        of_piece = tuple(CubicSpline(time, smooth[:, j]) for j in range(6))
        splines.append(of_piece)
        qd[rows] = np.stack([s(time, 1) for s in of_piece], axis=1)
        qdd[rows] = np.gradient(qd[rows], time, axis=0)
    top = np.abs(qd).max(axis=0)
    for k in range(piece[-1] + 1):
        rows = np.flatnonzero(piece == k)
        sign = np.where(np.abs(qd[rows]) > rules.RESTING_SPEED * top, np.sign(qd[rows]), 0.0)
        direction[rows] = np.stack([_held(sign[:, j]) for j in range(6)], axis=1)
        for j in np.flatnonzero(sign.any(axis=0)):
            moves = np.flatnonzero(sign[:, j])
            rubbing[rows, j] = np.interp(np.arange(len(rows)), moves, sign[moves, j])
    return tuple(splines), qd, qdd, direction, rubbing


def _held(sign: Array) -> Array:
    """Signs (n,) with every zero replaced by the sign before it."""
    last = np.maximum.accumulate(np.where(sign != 0, np.arange(len(sign)), -1))
    return np.where(last >= 0, sign[np.maximum(last, 0)], 0.0)


def _filled(log: JointLog) -> Array:
    """Torques with gaps filled from their neighbours in time."""
    tau = log.tau.copy()
    for j in range(6):
        known = np.flatnonzero(np.isfinite(tau[:, j]))
        if 0 < len(known) < len(tau):
            tau[:, j] = np.interp(np.arange(len(tau)), known, tau[known, j])
    return tau


def _smoothed(log: JointLog, piece: Index, tau: Array) -> Array:
    """Torques without the current's ripple, which inertia keeps from the link; it would make springs look too stiff."""
    out = np.nan_to_num(tau)
    for k in range(piece[-1] + 1):
        rows = np.flatnonzero(piece == k)
        out[rows] = _over(out[rows], log.time[rows], rules.TORQUE_WINDOW)
    return out


def _over(values: Array, time: Array, window: float) -> Array:
    """Values (n, k) without what is quicker than the window, where it has rows enough, on even instants: a cubic over it keeps
    their course (Savitzky and Golay 1964)."""
    from scipy.signal import savgol_filter  # takes a second, which a diagnosis without encoders need not pay

    width = 2 * int(window / float(np.median(np.diff(time))) / 2) + 1 if len(time) > 1 else 1
    if not 5 <= width <= len(time):
        return values
    even = np.linspace(time[0], time[-1], len(time))
    return np.asarray(CubicSpline(even, savgol_filter(CubicSpline(time, values)(even), width, 3, axis=0))(time))


BLOCK = 400  # instants whitened together; the wander is forgotten at their border
FEW = 120  # instants of a block from which the noise is estimated


@dataclass(frozen=True)
class EncoderNoise:
    """white rad; quick and slow wander rad with their memories s; floor rad: scatter from instant to instant; good (n,): rows of
    the signals that count: neither absent, at rest nor grossly off; fast rad: share of the white that is no reading's noise."""

    white: float
    quick: float
    quick_memory: float
    slow: float
    slow_memory: float
    floor: float
    good: Mask
    fast: float = 0.0


def state_columns(signals: Signals, joint: int, broad: bool) -> Array:
    """Functions (n, m) of the state of one joint, of unit size: what a spring, friction and a delay give; `broad`: what a rotor,
    gears and scales give too."""
    own = (signals.log.q, signals.qd, signals.direction, signals.tau, signals.qdd, signals.viscous, signals.dry)
    q, qd, s, tau, qdd, *friction = (a[:, joint - 1] for a in own)
    runs = [(signals.log.run == k).astype(float) for k in np.unique(signals.log.run)]
    found = [*runs, qd, s, tau, *(friction if signals.measured[joint - 1] else ())]
    if broad:
        found += [qdd, q, q**2, np.cos(2 * q), np.sin(2 * q), tau**3, np.abs(tau) * s]
    columns = np.stack(found, axis=1)
    size = np.linalg.norm(columns, axis=0)
    return columns[:, size > 0] / size[size > 0]


def noise_of(signals: Signals, joint: int) -> EncoderNoise:
    """Noise of the link side of a joint."""
    gap = signals.log.link[:, joint - 1] - signals.log.q[:, joint - 1]
    good = np.isfinite(gap) & signals.moving(joint) & signals.inside()
    columns = state_columns(signals, joint, broad=True)
    for _ in range(3):
        left = _left(columns, gap, good)
        wild = np.abs(left) > rules.RECORDING_FAULT * max(1.4826 * float(np.median(np.abs(left))), rules.LEAST_ENCODER_NOISE)
        if not wild.any():
            break
        good[np.flatnonzero(good)[wild]] = False
    left = _left(columns, gap, good)
    rows = np.flatnonzero(good)
    time, pieces = signals.log.time[rows], blocks(signals, rows)
    white, quick, quick_memory = _likeliest(left, pieces, time)
    # What a spring, friction and a delay leave is the encoder's own up to its accuracy class, not a gap of the robot.
    plain = _left(state_columns(signals, joint, broad=False), gap, good)
    slow = float(np.sqrt(max(float(np.mean(plain**2)) - white**2 - quick**2, rules.LEAST_ENCODER_NOISE**2)))
    _, _, slow_memory = _likeliest(plain, pieces, time, longest=True)
    floor = np.hypot(white, quick * np.sqrt(1.0 - np.exp(-float(np.median(np.diff(time))) / quick_memory)))
    # Ripple that is faster than the instants kept looks white among them; between all rows it does not. A tenth is chance.
    fast = float(np.sqrt(more)) if (more := white**2 - signals.instant[joint - 1] ** 2) > 0.1 * white**2 else 0.0
    return EncoderNoise(white, quick, quick_memory, min(slow, rules.ENCODER_ACCURACY), slow_memory, float(floor), good, fast)


def _left(columns: Array, gap: Array, good: Mask) -> Array:
    """Residual of a regression on the good rows."""
    return np.asarray(gap[good] - columns[good] @ np.linalg.lstsq(columns[good], gap[good], rcond=1e-9)[0])


def blocks(signals: Signals, rows: Index) -> list[Index]:
    """Places in `rows` of stretches of at most BLOCK instants of one run."""
    run = signals.log.run[rows]
    runs = [np.flatnonzero(run == k) for k in np.unique(run)]
    return [block for places in runs for block in np.array_split(places, int(np.ceil(len(places) / BLOCK)))]


def covariance(time: Array, noise: EncoderNoise) -> Array:
    """Of one block at `time` (m,) s, (m, m) rad^2."""
    apart = np.abs(time[:, None] - time[None, :])
    wander = noise.quick**2 * np.exp(-apart / noise.quick_memory) + noise.slow**2 * np.exp(-apart / noise.slow_memory)
    return np.asarray(wander + (noise.white**2 + rules.LEAST_ENCODER_NOISE**2) * np.eye(len(time)))


def factors(time: Array, pieces: list[Index], noise: EncoderNoise) -> list[tuple[Index, Array]]:
    """Places of each block and the lower root of its covariance."""
    return [(piece, cho_factor(covariance(time[piece], noise), lower=True)[0]) for piece in pieces]


def whiten_blocks(roots: list[tuple[Index, Array]], columns: Array) -> Array:
    """Columns (n, m) in rad as independent rows of unit noise."""
    out = np.empty_like(columns)
    for piece, root in roots:
        out[piece] = solve_triangular(root, columns[piece], lower=True, check_finite=False)
    return out


def _likeliest(left: Array, pieces: list[Index], time: Array, longest: bool = False) -> tuple[float, float, float]:
    """White rad, wander rad and memory s of residuals; `longest`: of at least a tenth of a block, for what wanders slowly."""
    size = max(float(np.sqrt(np.mean(left**2))), rules.LEAST_ENCODER_NOISE)
    # The parts of a long log say the same; a few are enough, of slow wander every so manieth instant.
    pieces = pieces[:: max(1, len(pieces) // 3)]
    pieces = [p[:: -(-len(p) // FEW)] if longest else p[:FEW] for p in pieces]
    step = float(np.median(np.diff(time[pieces[0]]))) if len(pieces[0]) > 1 else 1.0
    length = max(float(np.ptp(time[pieces[0]])), 20 * step)
    shortest = length / 20 if longest else 2 * step

    parts = [(left[piece], np.abs(time[piece][:, None] - time[piece])) for piece in pieces]
    unit = np.log([size, size, step])
    bounds = [(-4.0, 0.5), (-5.0, 1.0), (np.log(shortest / step), np.log(length / 4 / step))]
    starts = [(-0.3, -1.0, bounds[2][0] + 0.1), (-2.0, 0.0, 0.5 * (bounds[2][0] + bounds[2][1]))]
    found = [
        minimize(lambda x: unlikely(unit + x, parts), s, jac=True, method="L-BFGS-B", bounds=bounds, options={"maxiter": 40})
        for s in starts
    ]
    best = min(found, key=lambda f: float(f.fun))
    return float(size * np.exp(best.x[0])), float(size * np.exp(best.x[1])), float(step * np.exp(best.x[2]))


def unlikely(logs: Array, parts: Sequence[tuple[Array, Array]]) -> tuple[float, Array]:
    """Minus the log likelihood, but for a constant, of residuals (m,) rad with their lags (m, m) s, part by part, and its slope
    (3,) in `logs`, the logarithms of white rad, wander rad and memory s (Rasmussen and Williams 2006, eq. 5.8 and 5.9)."""
    white, wander, memory = np.exp(logs)
    total, slope = 0.0, np.zeros(3)
    for left, lags in parts:
        wanders, own = wander**2 * np.exp(-lags / memory), np.eye(len(left))
        root = cho_factor(wanders + (white**2 + rules.LEAST_ENCODER_NOISE**2) * own, lower=True)
        weighed = cho_solve(root, left)
        total += 0.5 * float(left @ weighed) + float(np.log(np.diag(root[0])).sum())
        in_covariance = cho_solve(root, own) - np.outer(weighed, weighed)
        by_wander = in_covariance * wanders
        slope += [white**2 * np.trace(in_covariance), by_wander.sum(), 0.5 * (by_wander * lags).sum() / memory]
    return total, slope
