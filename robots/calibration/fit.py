"""One nonlinear robust fit of everything: geometry, springs, payloads, nests, stations, with covariance.

Maximum a posteriori with Student-t errors of NU degrees of freedom on each reading as a whole (Lange, Little and Taylor
1989), Levenberg-Marquardt steps on the weighted normal equations. The spread starts at what the data show and is lowered
to the noise model's as the fit settles, so that outliers of any size lose their weight before they can do harm.
docs/calibration.md has the equations.
"""

from dataclasses import dataclass, replace
from functools import cache

import numpy as np
from scipy.linalg import cho_factor, cho_solve
from scipy.optimize import brentq, minimize_scalar
from scipy.stats import chi2

from robots.calibration.layout import Choice, Layout, Priors, State, build_layout, moved, nominal_state
from robots.calibration.noise import TURN_SD, Noise, reading_covariance, whitener
from robots.calibration.parameters import MDH_NAMES
from robots.calibration.residuals import Linearised, linearise, residuals
from robots.calibration.start import robust_motion
from robots.measurements import Hanging, Index, Instrument, Readings
from robots.pose import Array
from robots.robot import Robot

NU = 8.0  # degrees of freedom of the errors: heavy tails, at 2 % of the efficiency on Gaussian ones
MAX_STEPS = 40
SETTLED = 1e-3  # of one posterior sd: smaller steps end the fit
RELINEARISE = 1e-5  # m or rad: smaller steps leave the Jacobian as it is (its change is below 1e-5 of itself)
JOINT_NOISE = (1e-6, 3e-3)  # rad, where the joint noise is searched
LEARNED = (5e-5, 1e-2)  # m or rad, bounds of the learned priors
PLAIN, WEAK = Choice(), Priors()


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
class Fit:
    """A calibrated model with what the readings say of it.

    offset (p,): estimate less start, in the order of layout.names; covariance (p, p). residual (n, k) m (rad);
    weight (n,) of the readings between 0 and 1, squared (n,): squared whitened distance; J (n, k, p) and whitening W
    (n, k, k) at the estimate; noise; spread of the residuals over the noise model; steps taken.
    """

    campaign: Campaign
    choice: Choice
    priors: Priors
    layout: Layout
    start: State
    state: State
    offset: Array
    covariance: Array
    residual: Array
    weight: Array
    squared: Array
    J: Array
    W: Array
    noise: Noise
    spread: float
    steps: int

    @property
    def sd(self) -> Array:
        """One sigma of each unknown (p,)."""
        return np.sqrt(np.maximum(np.diag(self.covariance), 0.0))


def fit_campaign(
    campaign: Campaign,
    choice: Choice = PLAIN,
    priors: Priors = WEAK,
    noise: Noise | None = None,
    begin: State | None = None,
) -> Fit:
    """Fit the model `choice`. Without `noise` the joint noise is estimated with it; `begin` is a state nearby.

    Priors are centred at the nominal robot and the cell's nests; where `begin` is given only the search starts there.
    """
    c = campaign
    nominal = nominal_state(c.robot, c.readings, c.payloads, c.instrument, choice)
    layout = build_layout(c.robot, c.readings, c.instrument, choice, priors)
    if begin is None:
        begin = located(campaign, nominal)
    start = replace(nominal, stations=begin.stations)
    offset = _offset_to(layout, start, begin)
    estimated = noise is None
    noise = noise or Noise()
    result = _solve(campaign, layout, start, begin, offset, noise)
    if estimated:
        for _ in range(3):
            found = joint_noise(campaign, layout, result)
            if abs(np.log(found.joints / noise.joints)) < 0.02:
                break
            noise = found
            result = _solve(campaign, layout, start, result.state, result.offset, noise)
    return _finished(campaign, choice, priors, layout, start, result, noise)


def learned_priors(fit: Fit) -> Priors:
    """Priors as wide as the deviations that this robot shows (MacKay 1992, eq. 2.20), lengths and angles apart.

    What no reading determines then varies as much as what the readings do determine: the gauge's honest sd.
    """
    lengths = np.array([name[0] == "d" or (name[0] == "a" and name[1] != "l") for name in MDH_NAMES])
    found = []
    for kind, before in ((lengths, fit.priors.length), (~lengths, fit.priors.angle)):
        columns = fit.layout.arm[:30][kind]
        columns = columns[columns >= 0]
        known = np.sum(1.0 - (fit.sd[columns] / before) ** 2)
        size = np.sqrt(np.sum(fit.offset[columns] ** 2) / max(known, 1.0)) if known > 2.0 else before
        found.append(float(np.clip(size, *LEARNED)))
    return replace(fit.priors, length=found[0], angle=found[1])


def located(campaign: Campaign, state: State) -> State:
    """`state` with its stations where most readings want them, and nests that the cell does not place."""
    c = campaign
    at_origin = replace(state, stations=np.tile(np.eye(4), (len(c.readings.stations), 1, 1)))
    base_points = c.readings.point - residuals(c.robot, c.readings, c.instrument, at_origin)[:, :3]
    stations = at_origin.stations.copy()
    for k in np.unique(c.readings.station):
        rows = c.readings.station == k
        stations[k] = robust_motion(base_points[rows], c.readings.point[rows])[0]
    state, campaign = replace(state, stations=stations), replace(c, pairs=None)
    rigid = Choice(geometry=False, joints=())
    layout = build_layout(c.robot, c.readings, c.instrument, rigid, Priors())
    return _solve(campaign, layout, state, state, np.zeros(layout.size), Noise()).state


def _offset_to(layout: Layout, start: State, begin: State) -> Array:
    """Offset (p,) from `start` to `begin` in the unknowns that are plain numbers; turns and stations begin at zero."""
    offset = np.zeros(layout.size)
    for columns, change in (
        (layout.arm, begin.arm - start.arm),
        (layout.payload, begin.payloads - start.payloads),
        (layout.nest[:, :3], begin.nests - start.nests),
    ):
        offset[columns[columns >= 0]] = change[columns >= 0]
    return offset


@dataclass(frozen=True)
class _Solution:
    state: State
    offset: Array
    linear: Linearised
    W: Array
    squared: Array
    spread: float
    steps: int


def _solve(campaign: Campaign, layout: Layout, start: State, begin: State, offset: Array, noise: Noise) -> _Solution:
    """Levenberg-Marquardt with the spread lowered as the residuals allow."""
    c = campaign
    state = begin
    linear, W = _looked(c, layout, state, noise)
    precision = np.where(np.isfinite(layout.prior_sd), (layout.scale / layout.prior_sd) ** 2, 0.0)
    squared = _squared(W, linear.residual)
    k = linear.residual.shape[1]
    damping, spread, steps = 0.0, _spread(squared, k), 0  # what the data show
    while steps < MAX_STEPS:
        steps += 1
        weight = (NU + k) / (NU * consistency(k) + squared / spread**2)
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
            linear, W = _looked(c, layout, state, noise)
            squared = _squared(W, linear.residual)
        else:
            linear = replace(linear, residual=residual)
        lower = max(_spread(squared, k), 1e-6)
        settled = length < SETTLED and abs(lower / spread - 1) < 1e-3
        spread = lower
        if settled:
            break
    return _Solution(state, offset, linear, W, squared, spread, steps)


def _looked(campaign: Campaign, layout: Layout, state: State, noise: Noise) -> tuple[Linearised, Array]:
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
    sd = readings.sigma_turn if readings.sigma_turn is not None else np.full(len(readings), TURN_SD)
    W[:, 3:, 3:] = np.eye(3) / sd[:, None, None]
    return W


def _whitened(W: Array, residual: Array) -> Array:
    return np.asarray((W @ residual[..., None])[..., 0])


def _squared(W: Array, residual: Array) -> Array:
    return np.asarray((_whitened(W, residual) ** 2).sum(axis=1))


def _spread(squared: Array, k: int, freedom: float = 1.0) -> float:
    """Scale of the residuals over the noise model that the Student-t likelihood wants, one for Gaussian errors.

    The root of mean (NU + k) u / (NU a + u) = k freedom with u = squared / spread^2 and `consistency` a.
    """
    a = consistency(k)
    scale2 = float(np.median(squared)) / chi2.median(k)
    for _ in range(50):
        u = squared / scale2
        before, scale2 = scale2, scale2 * float(np.mean((NU + k) * u / (NU * a + u))) / (k * freedom)
        if abs(scale2 / before - 1) < 1e-6:
            break
    return float(np.sqrt(scale2))


@cache
def consistency(k: int) -> float:
    """Share a of the variance that a Student-t of k dimensions takes for the scale of Gaussian errors."""

    def excess(a: float) -> float:
        u = chi2(k).ppf((np.arange(4000) + 0.5) / 4000)
        return float(np.mean((NU + k) * u / (NU * a + u)) - k)

    return float(brentq(excess, 0.1, 1.0))


def _cost(squared: Array, spread: float, k: int, offset: Array, layout: Layout) -> float:
    """Negative log posterior."""
    misfit = 0.5 * (NU + k) * np.log1p(squared / spread**2 / (NU * consistency(k))).sum()
    return float(misfit + 0.5 * ((offset / layout.prior_sd) ** 2).sum())


def joint_noise(campaign: Campaign, layout: Layout, solution: _Solution) -> Noise:
    """The joint noise whose covariance explains the residuals best (Student-t likelihood), freedom of the fit allowed for."""
    readings = campaign.readings
    off, d_joints = solution.linear.residual[:, :3], solution.linear.d_joints
    freedom = max(1.0 - layout.size / (3.0 * len(off)), 0.1)
    plain = reading_covariance(readings, campaign.instrument, Noise(0.0), d_joints)
    per_joint = d_joints @ np.swapaxes(d_joints, 1, 2)
    if campaign.pairs is not None:
        plain, per_joint = (m[campaign.pairs[:, 0]] + m[campaign.pairs[:, 1]] for m in (plain, per_joint))

    def misfit(log_joints: float) -> float:
        covariance = freedom * consistency(3) * (plain + np.exp(2 * log_joints) * per_joint)
        _, logdet = np.linalg.slogdet(covariance)
        squared = np.einsum("ni,ni->n", off, np.linalg.solve(covariance, off[..., None])[..., 0])
        return float(0.5 * ((NU + 3) * np.log1p(squared / NU) + logdet).sum())

    found = minimize_scalar(misfit, bounds=tuple(np.log(JOINT_NOISE)), method="bounded", options={"xatol": 1e-2})
    return Noise(float(np.exp(found.x)))


def _finished(
    campaign: Campaign, choice: Choice, priors: Priors, layout: Layout, start: State, solution: _Solution, noise: Noise
) -> Fit:
    """Covariance of the M-estimator (Huber 1981, section 7.6) about the solution."""
    k = solution.linear.residual.shape[1]
    n, p = len(solution.linear.residual), layout.size
    precision = np.where(np.isfinite(layout.prior_sd), (layout.scale / layout.prior_sd) ** 2, 0.0)
    # Degrees of freedom that the readings, not the priors, take up.
    whitened = ((solution.W @ solution.linear.J) * layout.scale / solution.spread).reshape(-1, p)
    gained = whitened.T @ whitened
    used = float(np.trace(np.linalg.solve(gained + np.diag(precision + 1e-12), gained)))
    a, freedom = consistency(k), max(1.0 - used / (n * k), 0.1)
    spread = _spread(solution.squared, k, freedom)
    m2 = solution.squared / spread**2
    weight = (NU + k) / (NU * a + m2)
    # psi = w z; its mean square and mean slope correct the covariance of weighted least squares, and the slope's own
    # scatter makes up for unknowns that are not few against the readings (Huber 1981, eq. 7.6.5).
    slopes = weight - 2.0 * weight * m2 / (NU * a + m2) / k
    slope = float(np.mean(slopes))
    crowded = 1.0 + used / (n * k) * float(np.var(slopes)) / slope**2
    power = crowded**2 * float(np.mean(weight**2 * m2)) / (k * freedom)
    scaled = whitened * solution.spread / spread
    if campaign.pairs is not None:
        # Differences do not place the stations; the mean of as many readings does afterwards.
        one = 0.5 * spread**2 / float(np.median((solution.W**2).sum(axis=(1, 2)) / 3))
        shift = station_shifts(layout)
        precision[shift] = layout.scale[shift] ** 2 * len(campaign.readings) / one
    information = scaled.T @ scaled * slope**2 / power + np.diag(precision)
    inverse = cho_solve(cho_factor(information), np.eye(p))
    covariance = layout.scale[:, None] * inverse * layout.scale[None, :]
    return Fit(
        campaign, choice, priors, layout, start, solution.state, solution.offset, covariance, solution.linear.residual,
        weight * NU * a / (NU + k), solution.squared, solution.linear.J, solution.W, noise, spread, solution.steps,
    )  # fmt: skip


def station_shifts(layout: Layout) -> Index:
    """Columns of the stations' shifts."""
    columns = layout.station[:, :3]
    return np.asarray(columns[columns >= 0], np.int64)


def predict_readings(fit: Fit, readings: Readings) -> tuple[Array, Array]:
    """Predicted points (n, 3) m in the tracker's frame and their covariance (n, 3, 3) from the fit's parameters alone.

    `readings` use the same names (targets, payloads, stations) as the campaign.
    """
    c = fit.campaign
    seen = replace(readings, turn=None)
    layout = replace(fit.layout)
    linear = linearise(c.robot, replace(seen, point=np.nan_to_num(seen.point)), c.instrument, layout, fit.state)
    J = linear.J[:, :3]
    return linear.point, np.asarray(J @ fit.covariance @ np.swapaxes(J, 1, 2))
