"""Registration, stiffnesses and sensor bias from a grinding-force log: Gauss-Newton MAP jointly with the robot's posterior.

docs/force_registration.md, eq. 7 to 11. Prior: the robot's calibration with its covariance, the cell's `_sd` for the rest.
"""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from ocp.calibrate.force.log import ForceLog
from ocp.calibrate.force.model import ForceModel, ForceRows
from ocp.calibrate.force.noise import ReadingNoise, Whitened, channel_of
from ocp.calibrate.force.offsets import offset_columns, offset_size
from ocp.model.cell import Cell
from ocp.model.theta import NAMES, believed_theta, covariance_root
from robots.calibration.store import Calibration
from robots.errors import Infeasible
from robots.pose import Array

FIT_NAMES: tuple[str, ...] = (*NAMES, "sensor_bias")
BIAS = len(NAMES)
BIAS_SD = 1.0  # N where no calibration says; DIAGNOSIS: sensors are off by 0.1 to 2 N
STEPS = 25  # Gauss-Newton steps between two estimates of the noise
REWEIGHTED = 10  # steps with new weights; then they stand, for they may swing where a log falls into two parts
AT_REST = 1e-3  # squared length of a step in posterior standard deviations
LEAST_SHARE = 0.2
SHORTEST = 1e-3  # share of a step below which halving it is given up
PRESSED = 0.3  # of the process force


@dataclass(frozen=True)
class Prior:
    """mean (m,), covariance (m, m) of FIT_NAMES; root (m, r): x = mean + root z with z standard normal."""

    mean: Array
    covariance: Array
    root: Array


@dataclass(frozen=True)
class ForceSolution:
    """The MAP estimate of a log.

    x (m,) and covariance (m, m) in the order of FIT_NAMES; z (r + o,) standard normal unknowns, those of x first, then one
    for each run's offset (o is 0 without offsets); offset N: their standard deviation; extra (n, o) N: what they add.
    reading (n,) N: predicted with the sensor's bias, without offsets; before (n,) N: the same at the prior's mean; jacobian
    (n, m) of the reading. channel: noise and weights; whitened residuals and sensitivities to z; information (r + o,)^2 of z,
    the prior's in; steps taken.
    """

    prior: Prior
    x: Array
    covariance: Array
    z: Array
    offset: float
    extra: Array
    reading: Array
    before: Array
    jacobian: Array
    channel: ReadingNoise
    whitened: Whitened
    information: Array
    steps: int


def force_prior(cell: Cell, robot: Calibration | None = None) -> Prior:
    """What is known before the log: `robot` (default: the cell's own calibration) with its covariance, the cell's `_sd`."""
    calibration = cell.calibration if robot is None else robot
    theta = believed_theta(replace(cell, calibration=calibration))
    m = len(FIT_NAMES)
    mean, covariance = np.append(theta.values, 0.0), np.zeros((m, m))
    covariance[:BIAS, :BIAS] = theta.covariance
    covariance[BIAS, BIAS] = BIAS_SD**2
    if calibration is not None and "sensor_bias" in calibration.names:
        inside = [i for i, name in enumerate(calibration.names) if name in FIT_NAMES]
        at = [FIT_NAMES.index(calibration.names[i]) for i in inside]
        mean[at] = calibration.values[inside]
        covariance[np.ix_(at, at)] = calibration.covariance[np.ix_(inside, inside)]
    return Prior(mean, covariance, covariance_root(covariance))


def reading_of(
    model: ForceModel, rows: ForceRows, x: Array, guess: Array | None = None, pressed: NDArray[np.bool_] | None = None
) -> tuple[Array, Array]:
    """Contact force (n,) N and what the sensor shows (n,) N at parameters x (m,); Newton starts at `guess` (n,).

    `pressed` rows may have negative forces (`ForceModel.force`).
    """
    F = model.force(rows, x[:BIAS], guess, pressed)
    return F, F + x[BIAS]


def pressed_rows(model: ForceModel, log: ForceLog) -> NDArray[np.bool_]:
    """Rows (n,) that read a force which only contact explains, far above what a sensor is off by."""
    return np.asarray(log.contact & (log.fn > PRESSED * model.law.process_force))


def reading_jacobian(model: ForceModel, rows: ForceRows, x: Array, F: Array) -> Array:
    """d reading / dx (n, m) at contact forces F (n,)."""
    return np.hstack([model.sensitivity(rows, x[:BIAS], F), np.ones((len(rows), 1))])


def solve_force_log(model: ForceModel, rows: ForceRows, log: ForceLog, prior: Prior, offsets: bool = True) -> ForceSolution:
    """The most probable parameters given the log, and their covariance; `offsets` allows for runs that differ.

    The noise comes from the scatter about the prior's prediction first, then about the fit's. Raises Infeasible where the
    iteration does not come to rest.
    """
    problem = _Problem(model, rows, log, prior, pressed_rows(model, log))
    F, before = reading_of(model, rows, prior.mean, None, problem.pressed)
    state = _State(np.zeros(prior.root.shape[1]), prior.mean, F, before, np.zeros((len(log), 0)), 0)
    channel = channel_of(log, log.fn - before)
    state, channel = problem.settle(state, channel)
    channel = channel_of(log, log.fn - state.reading, channel)
    state, channel = problem.settle(state, channel)
    size = 0.0
    if offsets:
        indicator = offset_columns(log.run, log.contact)
        white, _ = problem.linearised(state, channel)
        shown = channel.whitened(np.zeros(len(log)), indicator).sensitivity
        size = offset_size(white.sensitivity, shown, white.residual + white.sensitivity @ state.z)
        if size > 0:
            z = np.concatenate([state.z, np.zeros(indicator.shape[1])])
            state, channel = problem.settle(replace(state, z=z, extra=size * indicator), channel)
    white, jacobian = problem.linearised(state, channel)
    information = np.eye(len(state.z)) + channel.information(white.sensitivity)
    r = prior.root.shape[1]
    covariance = prior.root @ np.linalg.inv(information)[:r, :r] @ prior.root.T
    return ForceSolution(
        prior, state.x, 0.5 * (covariance + covariance.T), state.z, size, state.extra, state.reading, before, jacobian, channel,
        white, information, state.steps,
    )  # fmt: skip


@dataclass(frozen=True)
class _State:
    """An iterate: unknowns z, parameters x, contact force F and reading (n,) N, columns (n, o) of the offsets, steps so far."""

    z: Array
    x: Array
    F: Array
    reading: Array
    extra: Array
    steps: int


@dataclass(frozen=True)
class _Problem:
    """One log to fit."""

    model: ForceModel
    rows: ForceRows
    log: ForceLog
    prior: Prior
    pressed: NDArray[np.bool_]

    def residual(self, state: _State) -> Array:
        offset = state.extra @ state.z[self.prior.root.shape[1] :]
        return np.asarray(self.log.fn - state.reading - offset)

    def linearised(self, state: _State, channel: ReadingNoise) -> tuple[Whitened, Array]:
        """Whitened residuals and sensitivities to z, and the reading's derivatives (n, m) in x."""
        jacobian = reading_jacobian(self.model, self.rows, state.x, state.F)
        return channel.whitened(self.residual(state), np.hstack([jacobian @ self.prior.root, state.extra])), jacobian

    def settle(self, state: _State, channel: ReadingNoise) -> tuple[_State, ReadingNoise]:
        """Gauss-Newton with the channel's noise and, at first, new weights at every step (eq. 8, 9)."""
        previous, share = np.zeros_like(state.z), 1.0
        for step in range(STEPS):
            if step < REWEIGHTED:
                channel = channel.reweighted(self.residual(state))
            white, jacobian = self.linearised(state, channel)
            A = white.sensitivity
            H = np.eye(len(state.z)) + A.T @ A
            change = np.asarray(np.linalg.solve(H, A.T @ white.residual - state.z), float)
            share = _relaxed(share, previous, change, H)
            state, previous = self._moved(state, channel, white, share * change, jacobian), change
            if change @ H @ change < AT_REST:
                return state, channel
        raise Infeasible(
            f"{self.log.path}: the fit of the force log does not come to rest in {STEPS} steps; the cell is not the log's"
        )

    def _moved(self, state: _State, channel: ReadingNoise, white: Whitened, change: Array, jacobian: Array) -> _State:
        """The step, halved until the weighted squares do not rise."""
        now = float(white.residual @ white.residual + state.z @ state.z)
        share = 1.0
        while True:
            z = state.z + share * change
            x = self.prior.mean + self.prior.root @ z[: self.prior.root.shape[1]]
            # Where the derivative points, Newton's iteration on the force is over after a step or two.
            guess = state.F + jacobian[:, :BIAS] @ (x - state.x)[:BIAS]
            F, reading = reading_of(self.model, self.rows, x, guess, self.pressed)
            trial = _State(z, x, F, reading, state.extra, state.steps + 1)
            left = channel.whitened(self.residual(trial), np.zeros((len(F), 0))).residual
            if float(left @ left + z @ z) <= now * (1.0 + 1e-9) + 1e-6 or share < SHORTEST:
                return trial
            share *= 0.5


def _relaxed(share: float, previous: Array, change: Array, H: Array) -> float:
    """Share of the next step. Where residuals are large, Gauss-Newton steps overshoot in turn to either side: from how much of
    the step before comes back follows the share that would have met the middle."""
    length = float(previous @ H @ previous)
    back = float(previous @ H @ change) / length if length > 0 else 0.0
    return float(np.clip(share / max(1.0 - back, 1e-3), LEAST_SHARE, 1.0))
