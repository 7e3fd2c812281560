"""Registration, stiffnesses and sensor bias from a grinding-force log: Gauss-Newton MAP jointly with the robot's posterior.

docs/force_registration.md, eq. 7 to 11. Prior: the robot's calibration with its covariance, the cell's `_sd` for the rest.

Runs may differ beyond the noise and the model: wear, a changed friction, a blade gripped anew move whole runs. Unless the fit
allows for it by an offset of each run as one more random quantity, it takes them for registration and is far too sure of it.
Calibration finds the offsets' size (`offset_size`, eq. 11). The diagnosis names such causes: it takes a small size as known, and
has beside it setpoints that were read off the log (`RunOffsets`).
"""

from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy.special import chdtrc

from ocp.calibrate.force.log import Flags, ForceLog
from ocp.calibrate.force.model import ForceModel, ForceRows, PlacedRows
from ocp.calibrate.force.noise import ReadingNoise, Whitened, channel_of
from ocp.model.cell import Cell
from ocp.model.theta import NAMES, believed_theta, covariance_root
from robots.calibration.store import Calibration
from robots.errors import Infeasible
from robots.gauss_newton import Rule, Valley, minimise
from robots.pose import Array

SIZES: Array = np.geomspace(5e-3, 20.0, 60)  # N, tried for the standard deviation of the offsets
CLEAR = 6.0  # twice the logarithm of the likelihood ratio from which offsets are taken for real
FEWEST = 3  # runs in contact


def offset_columns(run: NDArray[np.int64], contact: NDArray[np.bool_]) -> Array:
    """Indicator (n, r) of each run's rows in contact."""
    runs = np.unique(run[contact])
    return np.asarray((run[:, None] == runs) & contact[:, None], float)


def offset_size(sensitivity: Array, indicator: Array, residual: Array) -> float:
    """Standard deviation N of the runs' offsets by greatest marginal likelihood, 0 where none is clear.

    sensitivity (n, k) to standard normal unknowns, indicator (n, r) of the runs, residual (n,) at the unknowns' mean, all
    whitened.
    """
    if indicator.shape[1] < FEWEST:
        return 0.0
    columns = np.hstack([sensitivity, indicator])
    gram, right = columns.T @ columns, columns.T @ residual
    fixed = sensitivity.shape[1]

    def evidence(size: float) -> float:
        scale = np.concatenate([np.ones(fixed), np.full(indicator.shape[1], size)])
        H = np.eye(len(scale)) + scale[:, None] * gram * scale
        L = np.linalg.cholesky(H)
        part = np.linalg.solve(L, scale * right)
        return float(part @ part - 2.0 * np.log(np.diag(L)).sum())

    gains = np.array([evidence(size) for size in SIZES]) - evidence(0.0)
    best = int(np.argmax(gains))
    return float(SIZES[best]) if gains[best] > CLEAR else 0.0


@dataclass(frozen=True)
class RunOffsets:
    """Columns (n, o) N of the normal and of the tangential reading per standard normal unknown; the first `runs` are single
    runs' own offsets, which no other run shares; behind them what setpoints are off by that the readings gave."""

    normal: Array = field(repr=False)
    shear: Array = field(repr=False)
    runs: int

    @staticmethod
    def of(log: ForceLog, friction: Array, sd: float) -> "RunOffsets":
        """Of a log; friction (n,): tangential force per newton of the normal one; sd N: of single runs' offsets."""
        runs = offset_columns(log.run, log.contact)
        open_rows = log.contact if log.setpoint_sd is None else log.contact & (log.setpoint_sd > 0)
        levels = np.zeros((len(log), 0))
        if log.setpoint_sd is not None:
            levels = log.setpoint_sd[:, None] * offset_columns(log.run, open_rows)
        return RunOffsets(
            np.hstack([sd * runs, levels]), np.hstack([np.zeros_like(runs), friction[:, None] * levels]), runs.shape[1]
        )

    @property
    def count(self) -> int:
        """Unknowns."""
        return self.normal.shape[1]

    def none(self, rows: int) -> "RunOffsets":
        """Of other rows, which share none of them."""
        return RunOffsets(np.zeros((rows, 0)), np.zeros((rows, 0)), 0)


FIT_NAMES: tuple[str, ...] = (*NAMES, "sensor_bias")
BIAS = len(NAMES)
BIAS_SD = 1.0  # N where no calibration says; DIAGNOSIS: sensors are off by 0.1 to 2 N
# At rest within 3 % of the posterior's standard deviations. Weights may swing where a log falls into two parts: ten steps.
# A fit may rest on a kink, where a row just bears: steps point across it and win nothing however short.
RULE = Rule(25, rest=1e-3, reweighted=10, halvings=10, relaxed=True, valley=Valley(3, still=0.01, close=0.01, tries=200, lost=5))
PRESSED = 0.3  # of the process force
OTHER_CELL = 1e-9  # chance below which a log is not of a cell: far below what effects without a name make of it (1e-5)


@dataclass(frozen=True)
class Prior:
    """mean (m,), covariance (m, m) of FIT_NAMES; root (m, r): x = mean + root z with z standard normal."""

    mean: Array
    covariance: Array
    root: Array


@dataclass(frozen=True)
class ForceSolution:
    """The MAP estimate of a log.

    x (m,) and covariance (m, m) in the order of FIT_NAMES; offset N: standard deviation of the runs' offsets that the log shows
    (0 without any), allowed N: what the fit has them free by, at least what joints do beside the model.
    reading (n,) N: predicted with the sensor's bias, without offsets; before (n,) N: the same at the prior's mean; jacobian
    (n, m) of the reading. channel: noise and weights; whitened residuals and sensitivities to the standard normal unknowns z
    (r + o,), those of x first, then one for each run's offset; information (r + o,)^2 of z, the prior's in.
    """

    prior: Prior
    x: Array
    covariance: Array
    offset: float
    allowed: float
    reading: Array
    before: Array
    jacobian: Array
    channel: ReadingNoise
    whitened: Whitened
    information: Array


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
    model: ForceModel, rows: ForceRows, x: Array, guess: Array | None = None, pressed: Flags | None = None
) -> tuple[Array, Array]:
    """Contact force (n,) N and what the sensor shows (n,) N at parameters x (m,); Newton starts at `guess` (n,).

    `pressed` rows may have negative forces (`ForceModel.force`).
    """
    F = model.force(rows, x[:BIAS], guess, pressed)
    return F, F + x[BIAS]


def covariance_left(root: Array, information: Array) -> Array:
    """Covariance (m, m) of x = mean + root z, root (m, r), where z are the first r of the unknowns that `information` (k, k) is
    of, the prior's in it."""
    r = root.shape[1]
    covariance = root @ np.linalg.inv(information)[:r, :r] @ root.T
    return np.asarray(0.5 * (covariance + covariance.T))


def surprise(seen: Array, z: Array) -> tuple[float, int, float]:
    """How unlike their prior a log finds unknowns z (r,) that are standard normal before it: chi-square of the directions that it
    tells more of than the prior, how many these are, and the chance of more.

    seen (r, r): what the log adds to their information. About the prior's mean its gradient g = (1 + seen) z has covariance
    seen + seen^2; along eigenvectors of seen, with l > 1,

        sum of g_i^2 / (l_i + l_i^2) = sum of z_i^2 (1 + 1 / l_i)                                                   (12)
    """
    size, vector = np.linalg.eigh(0.5 * (seen + seen.T))
    told = size > 1.0
    statistic = float(np.sum((vector.T @ z)[told] ** 2 * (1.0 + 1.0 / size[told])))
    return statistic, int(told.sum()), float(chdtrc(max(int(told.sum()), 1), statistic))


def of_another_cell(log: ForceLog, information: Array, z: Array, count: int) -> tuple[str, ...]:
    """A sentence where a fit asks for more of its first `count` unknowns, the cell's, than they can be off by; information (k, k)
    on all its standard normal unknowns z (k,), the prior's in."""
    others = np.linalg.solve(information[count:, count:], information[count:, :count])
    seen = information[:count, :count] - information[:count, count:] @ others - np.eye(count)
    chance = surprise(np.asarray(seen), z[:count])[2]
    if chance > OTHER_CELL:
        return ()
    return (
        f"{log.path.name}: the fit needs wheel, blade, arm, stiffnesses or sensor farther from the cell than that and its "
        f"calibration allow (chance {chance:.1g}): of another cell, or something was moved or changed since; calibrate anew "
        "before you rely on it",
    )


def pressed_rows(model: ForceModel, log: ForceLog) -> Flags:
    """Rows (n,) that read a force which only contact explains, far above what a sensor is off by."""
    return np.asarray(log.contact & (log.fn > PRESSED * model.law.process_force))


def reading_jacobian(model: ForceModel, rows: ForceRows, x: Array, F: Array) -> Array:
    """d reading / dx (n, m) at contact forces F (n,)."""
    return np.hstack([model.sensitivity(rows, x[:BIAS], F), np.ones((len(rows), 1))])


def unmodelled_force(model: ForceModel, rows: ForceRows, x: Array, F: Array, joint_noise: float) -> float:
    """One sigma N, rms over the rows in contact, of what joints do beside the model (`joint_noise` rad), at parameters x and
    forces F (n,): the least that runs differ by."""
    at = np.flatnonzero(rows.contact)
    if not len(at):
        return 0.0
    by = model.evaluate("derivative", PlacedRows.of(model.cell, rows.take(at), x[:BIAS]), np.maximum(F[at], model.least_force))
    slopes = by[:, -6:] / by[:, :1]
    return float(joint_noise * np.sqrt(np.mean(np.sum(slopes**2, axis=1))))


def solve_force_log(model: ForceModel, rows: ForceRows, log: ForceLog, prior: Prior, joint_noise: float) -> ForceSolution:
    """The most probable parameters given the log, and their covariance; runs that differ are allowed for, by at least what the
    arm's joints do beside the model (rad).

    The noise comes from the scatter about the prior's prediction first, then about the fit's. Raises Infeasible where the
    iteration does not come to rest.
    """
    known = _Log(model, rows, log, prior, pressed_rows(model, log))
    F, before = reading_of(model, rows, prior.mean, None, known.pressed)
    r = prior.root.shape[1]
    none = np.zeros((len(log), 0))
    at = _settled(_Point(known, np.zeros(r), prior.mean, F, before, none, channel_of(log, log.fn - before)))
    at = _settled(replace(at, channel=channel_of(log, log.fn - at.reading, at.channel)))
    indicator = offset_columns(log.run, log.contact)
    white = at.whitened
    shown = at.channel.whitened(np.zeros(len(log)), indicator).sensitivity
    size = offset_size(white.sensitivity, shown, white.residual + white.sensitivity @ at.z)
    allowed = max(size, unmodelled_force(model, rows, at.x, at.F, joint_noise))
    if allowed > 0:
        at = _settled(replace(at, z=np.concatenate([at.z, np.zeros(indicator.shape[1])]), extra=allowed * indicator))
    information = np.eye(len(at.z)) + at.channel.information(at.whitened.sensitivity)
    covariance = covariance_left(prior.root, information)
    sizes = (size, allowed)
    return ForceSolution(prior, at.x, covariance, *sizes, at.reading, before, at.jacobian, at.channel, at.whitened, information)


@dataclass(frozen=True)
class _Log:
    """One log to fit."""

    model: ForceModel
    rows: ForceRows
    log: ForceLog
    prior: Prior
    pressed: Flags


@dataclass(frozen=True)
class _Point:
    """A point of the search (`robots.gauss_newton.Iterate`): unknowns z, parameters x, contact force F and reading (n,) N,
    columns (n, o) N of the offsets, noise and weights."""

    known: _Log
    z: Array
    x: Array
    F: Array
    reading: Array
    extra: Array
    channel: ReadingNoise

    @cached_property
    def jacobian(self) -> Array:
        """The reading's derivatives (n, m) in x."""
        return reading_jacobian(self.known.model, self.known.rows, self.x, self.F)

    @cached_property
    def whitened(self) -> Whitened:
        """Residuals and sensitivities to z."""
        return self.channel.whitened(self._gap(), np.hstack([self.jacobian @ self.known.prior.root, self.extra]))

    def reweighted(self) -> "_Point":
        """With the weights that follow from the residuals (eq. 9)."""
        return replace(self, channel=self.channel.reweighted(self._gap()))

    def residual(self) -> Array:
        """Whitened (n,)."""
        return self.channel.whitened(self._gap(), np.zeros((len(self.F), 0))).residual

    def linearised(self) -> tuple[Array, Array]:
        """Whitened residuals (n,) and sensitivities (n, k) to z. Raises Infeasible where they are no numbers."""
        white = self.whitened
        if not (np.isfinite(white.residual).all() and np.isfinite(white.sensitivity).all()):
            raise Infeasible(
                f"{self.known.log.path}: the fit of the force log leaves what can be computed; the cell is not the log's"
            )
        return white.residual, white.sensitivity

    def moved(self, change: Array) -> "_Point":
        """The point at z + change."""
        known, prior, z = self.known, self.known.prior, self.z + change
        x = prior.mean + prior.root @ z[: prior.root.shape[1]]
        # Where the derivative points, Newton's iteration on the force is over after a step or two.
        guess = self.F + self.jacobian[:, :BIAS] @ (x - self.x)[:BIAS]
        F, reading = reading_of(known.model, known.rows, x, guess, known.pressed)
        return replace(self, z=z, x=x, F=F, reading=reading)

    def _gap(self) -> Array:
        """Measured less predicted (n,) N, the runs' offsets in the prediction."""
        return np.asarray(self.known.log.fn - self.reading - self.extra @ self.z[self.known.prior.root.shape[1] :])


def _settled(start: _Point) -> _Point:
    """The most probable point with the channel's noise (eq. 8, 9)."""
    found = minimise(start, np.ones(len(start.z)), RULE)
    if not found.rested:
        path = start.known.log.path
        raise Infeasible(
            f"{path}: the fit of the force log does not come to rest in {RULE.steps} steps; the cell is not the log's"
        )
    return found.at
