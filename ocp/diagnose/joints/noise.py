"""Noise of link-side encoders: white from instant to instant, and a wander that no function of the state explains.

Residuals of a log at 250 Hz are far from independent: taken as white they would make every ripple certain. The wander is an
Ornstein-Uhlenbeck process, covariance s^2 exp(-|dt| / T) (Rasmussen and Williams 2006, eq. B.27), white noise is added. Both are
estimated by maximum likelihood from what a broad regression on the state (angle, speed, acceleration, load, their squares and
signs) leaves: not from the gap under diagnosis, which would hide in the wander. A link-side encoder has errors of its own,
eccentric or bent, of its accuracy class: so much of what springs, friction and a delay leave belongs to the wander too.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import cho_factor, solve_triangular
from scipy.optimize import minimize

from ocp.diagnose.joints.signals import Signals
from ocp.diagnose.rules import ENCODER_ACCURACY, LEAST_ENCODER_NOISE, RECORDING_FAULT
from robots.pose import Array
from robots.tracker_readings import Index

BLOCK = 400  # instants whitened together; the wander is forgotten at their border
FEW = 120  # instants of a block from which the noise is estimated


@dataclass(frozen=True)
class EncoderNoise:
    """white rad; quick and slow wander rad with their memories s; floor rad: scatter from instant to instant; good (n,): rows of
    the signals that count: neither absent, at rest nor grossly off."""

    white: float
    quick: float
    quick_memory: float
    slow: float
    slow_memory: float
    floor: float
    good: NDArray[np.bool_]


def state_columns(signals: Signals, joint: int, broad: bool) -> Array:
    """Functions (n, m) of the state of one joint, of unit size: what a spring, friction and a delay give; `broad`: what gears and
    scales give too."""
    j = joint - 1
    q, qd, tau = signals.log.q[:, j], signals.qd[:, j], signals.tau[:, j]
    s = signals.direction[:, j]
    runs = [(signals.log.run == k).astype(float) for k in np.unique(signals.log.run)]
    found = [*runs, qd, s, tau]
    if broad:
        found += [signals.qdd[:, j], q, q**2, np.cos(2 * q), np.sin(2 * q), tau**3, np.abs(tau) * s]
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
        wild = np.abs(left) > RECORDING_FAULT * max(1.4826 * float(np.median(np.abs(left))), LEAST_ENCODER_NOISE)
        if not wild.any():
            break
        good[np.flatnonzero(good)[wild]] = False
    left = _left(columns, gap, good)
    rows = np.flatnonzero(good)
    time, pieces = signals.log.time[rows], blocks(signals, rows)
    white, quick, quick_memory = _likeliest(left, pieces, time)
    # What a spring, friction and a delay leave is the encoder's own up to its accuracy class, not a gap of the robot.
    plain = _left(state_columns(signals, joint, broad=False), gap, good)
    slow = float(np.sqrt(max(float(np.mean(plain**2)) - white**2 - quick**2, LEAST_ENCODER_NOISE**2)))
    _, _, slow_memory = _likeliest(plain, pieces, time, longest=True)
    step = float(np.median(np.diff(time)))
    floor = np.hypot(white, quick * np.sqrt(1.0 - np.exp(-step / quick_memory)))
    return EncoderNoise(white, quick, quick_memory, min(slow, ENCODER_ACCURACY), slow_memory, float(floor), good)


def _left(columns: Array, gap: Array, good: NDArray[np.bool_]) -> Array:
    """Residual of a regression on the good rows."""
    return np.asarray(gap[good] - columns[good] @ np.linalg.lstsq(columns[good], gap[good], rcond=1e-9)[0])


def blocks(signals: Signals, rows: Index) -> list[Index]:
    """Places in `rows` of stretches of at most BLOCK instants of one run."""
    run = signals.log.run[rows]
    found = []
    for k in np.unique(run):
        places = np.flatnonzero(run == k)
        found += list(np.array_split(places, int(np.ceil(len(places) / BLOCK))))
    return found


def covariance(time: Array, noise: EncoderNoise) -> Array:
    """Of one block at `time` (m,) s, (m, m) rad^2."""
    apart = np.abs(time[:, None] - time[None, :])
    wander = noise.quick**2 * np.exp(-apart / noise.quick_memory) + noise.slow**2 * np.exp(-apart / noise.slow_memory)
    return np.asarray(wander + (noise.white**2 + LEAST_ENCODER_NOISE**2) * np.eye(len(time)))


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
    size = max(float(np.sqrt(np.mean(left**2))), LEAST_ENCODER_NOISE)
    # The parts of a long log say the same; a few are enough, of slow wander every so manieth instant.
    pieces = pieces[:: max(1, len(pieces) // 3)]
    pieces = [p[:: -(-len(p) // FEW)] if longest else p[:FEW] for p in pieces]
    step = float(np.median(np.diff(time[pieces[0]]))) if len(pieces[0]) > 1 else 1.0
    length = max(float(np.ptp(time[pieces[0]])), 20 * step)
    shortest = length / 20 if longest else 2 * step

    def cost(x: Array) -> float:
        white, wander, memory = size * np.exp(x[0]), size * np.exp(x[1]), step * np.exp(x[2])
        noise = EncoderNoise(white, wander, memory, 0.0, 1.0, white, np.empty(0, bool))
        total = 0.0
        for piece in pieces:
            factor = cho_factor(covariance(time[piece], noise), lower=True)[0]
            total += 0.5 * float(np.sum(solve_triangular(factor, left[piece], lower=True) ** 2))
            total += float(np.log(np.diag(factor)).sum())
        return total

    bounds = [(-4.0, 0.5), (-5.0, 1.0), (np.log(shortest / step), np.log(length / 4 / step))]
    starts = [(-0.3, -1.0, bounds[2][0] + 0.1), (-2.0, 0.0, 0.5 * (bounds[2][0] + bounds[2][1]))]
    found = [minimize(cost, s, method="L-BFGS-B", bounds=bounds, options={"maxiter": 40}) for s in starts]
    best = min(found, key=lambda f: float(f.fun))
    return float(size * np.exp(best.x[0])), float(size * np.exp(best.x[1])), float(step * np.exp(best.x[2]))
