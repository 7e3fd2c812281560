"""One minimisation of the robust misfit: Levenberg-Marquardt on the weighted normal equations, and the joint noise after it.

The spread starts at what the data show and is lowered to the noise model's as the fit settles, so that outliers of any
size lose their weight before they can do harm. docs/calibration.md, eqs. 2 and 3.
"""

from dataclasses import dataclass, replace

import numpy as np
from scipy.linalg import cho_factor, cho_solve
from scipy.optimize import minimize_scalar

from robots.calibration.layout import Layout, State, moved
from robots.calibration.noise import TURN_SD, Noise, reading_covariance, whitener
from robots.calibration.residuals import Linearised, linearise, residuals
from robots.calibration.student import NU, consistency, misfit, spread_of, weights
from robots.measurements import Hanging, Index, Instrument, Readings
from robots.pose import Array
from robots.robot import Robot

MAX_STEPS = 40
SETTLED = 1e-3  # of one posterior sd: smaller steps end the fit
RELINEARISE = 1e-5  # m or rad: smaller steps leave the Jacobian as it is (its change is below 1e-5 of itself)
JOINT_NOISE_SD = 1.0  # of its logarithm about what is usual: a factor of three either way, which few readings cannot correct
LEAST_SPREAD = 0.5  # of the noise model: few readings can be met too well, no instrument is that much better than it says
JOINT_NOISE = (1e-6, 3e-3)  # rad, where the joint noise is searched


@dataclass(frozen=True)
class Campaign:
    """What a fit starts from: robot, readings, what hung on the flange, the instrument.

    pairs (m, 2): where given, differences of these readings are fitted instead of the readings (the relative model); both
    of a pair are of one station.
    """

    robot: Robot
    readings: Readings
    payloads: dict[str, Hanging]
    instrument: Instrument
    pairs: Index | None = None


@dataclass(frozen=True)
class Solution:
    """State reached and its offset (p,) from the start, residuals with derivatives, whitener, squared distances (n,), spread,
    steps taken."""

    state: State
    offset: Array
    linear: Linearised
    W: Array
    squared: Array
    spread: float
    steps: int


def solve(campaign: Campaign, layout: Layout, start: State, begin: State, offset: Array, noise: Noise) -> Solution:
    """Levenberg-Marquardt with the spread lowered as the residuals allow."""
    c = campaign
    state = begin
    linear, W = looked(c, layout, state, noise)
    precision = np.where(np.isfinite(layout.prior_sd), (layout.scale / layout.prior_sd) ** 2, 0.0)
    squared = _squared(W, linear.residual)
    k = linear.residual.shape[1]
    damping, spread, steps = 0.0, spread_of(squared, k), 0  # what the data show
    while steps < MAX_STEPS:
        steps += 1
        weight = weights(squared / spread**2, k)
        scaled = (W @ linear.J) * layout.scale / spread
        rhs = np.einsum("nki,nk,n->i", scaled, _whitened(W, linear.residual) / spread, weight)
        rhs -= precision * offset / layout.scale
        flat = (scaled * np.sqrt(weight)[:, None, None]).reshape(-1, layout.size)
        normal = flat.T @ flat + np.diag(precision)
        cost = _cost(squared, spread, k, offset, layout)
        while True:
            damped = normal + np.diag(damping * np.diag(normal) + 1e-12)
            step = layout.scale * cho_solve(cho_factor(damped), rhs)
            trial = moved(layout, state, step)
            residual = _paired(c, residuals(c.robot, c.readings, c.instrument, trial))
            trial_squared = _squared(W, residual)
            if _cost(trial_squared, spread, k, offset + step, layout) <= cost * (1 + 1e-12) + 1e-9 or damping > 1e6:
                break
            damping = max(10 * damping, 1e-4)
        damping = 0.0 if damping < 1e-3 else 0.1 * damping
        # Geometry of the step in posterior sds, without an inverse: step^T normal step.
        length = float(np.sqrt((step / layout.scale) @ normal @ (step / layout.scale)))
        state, offset, squared = trial, offset + step, trial_squared
        if np.abs(step).max() > RELINEARISE:
            linear, W = looked(c, layout, state, noise)
            squared = _squared(W, linear.residual)
        else:
            linear = replace(linear, residual=residual)
        lower = max(spread_of(squared, k), LEAST_SPREAD)
        settled = length < SETTLED and abs(lower / spread - 1) < 1e-3
        spread = lower
        if settled:
            break
    return Solution(state, offset, linear, W, squared, spread, steps)


def looked(campaign: Campaign, layout: Layout, state: State, noise: Noise) -> tuple[Linearised, Array]:
    """Residuals with derivatives and their whitener, of readings or of pairs of them."""
    c = campaign
    linear = linearise(c.robot, c.readings, c.instrument, layout, state)
    if c.pairs is None:
        return linear, _whitener(c, linear, noise)
    covariance = reading_covariance(c.readings, c.instrument, noise, linear.d_joints)
    W = whitener(covariance[c.pairs[:, 0]] + covariance[c.pairs[:, 1]])
    return replace(linear, residual=_paired(c, linear.residual), J=_paired(c, linear.J)), W


def _paired(campaign: Campaign, rows: Array) -> Array:
    """Rows (n, 3, ..) as they are, or their differences over the pairs (m, 3, ..)."""
    return rows if campaign.pairs is None else rows[campaign.pairs[:, 1]] - rows[campaign.pairs[:, 0]]


def _whitener(campaign: Campaign, linear: Linearised, noise: Noise) -> Array:
    readings = campaign.readings
    points = whitener(reading_covariance(readings, campaign.instrument, noise, linear.d_joints))
    if readings.turn is None:
        return points
    W = np.zeros((len(readings), 6, 6))
    W[:, :3, :3] = points
    sd = np.full(len(readings), TURN_SD) if readings.sigma_turn is None else np.nan_to_num(readings.sigma_turn, nan=TURN_SD)
    W[:, 3:, 3:] = np.eye(3) / sd[:, None, None]
    return W


def _whitened(W: Array, residual: Array) -> Array:
    return np.asarray((W @ residual[..., None])[..., 0])


def _squared(W: Array, residual: Array) -> Array:
    return np.asarray((_whitened(W, residual) ** 2).sum(axis=1))


def _cost(squared: Array, spread: float, k: int, offset: Array, layout: Layout) -> float:
    """Negative log posterior."""
    return misfit(squared / spread**2, k) + 0.5 * float(((offset / layout.prior_sd) ** 2).sum())


def joint_noise(campaign: Campaign, layout: Layout, solution: Solution) -> Noise:
    """The joint noise whose covariance explains the residuals best (Student-t likelihood), freedom of the fit allowed for."""
    readings = campaign.readings
    off, d_joints = solution.linear.residual[:, :3], solution.linear.d_joints
    freedom = max(1.0 - layout.size / (3.0 * len(off)), 0.1)
    plain = reading_covariance(readings, campaign.instrument, Noise(0.0), d_joints)
    per_joint = d_joints @ np.swapaxes(d_joints, 1, 2)
    if campaign.pairs is not None:
        plain, per_joint = (m[campaign.pairs[:, 0]] + m[campaign.pairs[:, 1]] for m in (plain, per_joint))

    def unlikely(log_joints: float) -> float:
        covariance = freedom * consistency(3) * (plain + np.exp(2 * log_joints) * per_joint)
        _, logdet = np.linalg.slogdet(covariance)
        squared = np.einsum("ni,ni->n", off, np.linalg.solve(covariance, off[..., None])[..., 0])
        known = (log_joints - np.log(Noise().joints)) / JOINT_NOISE_SD
        return float(0.5 * ((NU + 3) * np.log1p(squared / NU) + logdet).sum() + 0.5 * known**2)

    found = minimize_scalar(unlikely, bounds=tuple(np.log(JOINT_NOISE)), method="bounded", options={"xatol": 1e-2})
    return Noise(float(np.exp(found.x)))
