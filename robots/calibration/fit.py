"""One nonlinear robust fit of everything: geometry, springs, payloads, nests, stations, with covariance.

Maximum a posteriori with Student-t errors, from a start found in the data alone. docs/calibration.md has the equations.
"""

from dataclasses import dataclass, replace

import numpy as np
from numpy.random import default_rng
from scipy.linalg import cho_factor, cho_solve

from robots.calibration.layout import Choice, Layout, Priors, State, build_layout, nominal_state, offset_between
from robots.calibration.noise import Noise
from robots.calibration.residuals import linearise, residuals
from robots.calibration.solver import Campaign, Solution, check_open, solve
from robots.calibration.student_t import GROSS, MEDIAN_OF_THREE, gaussian_moments, moments, spread_of, weights
from robots.pose import Array, make_transform
from robots.tracker_readings import Index, Readings

TRIALS, SUBSET = 200, 4  # small sets of readings that are tried to place the tracker, and their size
LOCATING = 200  # readings of a nest from a station that place both, to begin with
ROUGH = 1000  # of a longer campaign, fitted first: they leave little to do for the rest
TRUST = 20.0  # components of residuals that the noise model is worth
LOOSE_TURN, LEAST_TURN_SD = np.radians(10.0), np.radians(1e-4)  # above what passes for sound, below any instrument
# Times: radians in the place of degrees are 57. Within, what the loose arm misses itself could be the difference.
MISSTATED = 3.0
MEDIAN_TURN = float(np.sqrt(MEDIAN_OF_THREE))
LEARNED = (5e-5, 1e-2)  # m or rad, bounds of the learned priors
PLAIN, WEAK = Choice(), Priors()


def rigid_motion(source: Array, target: Array) -> Array:
    """T (4, 4) that moves source (n, 3) onto target (n, 3) in least squares (Kabsch 1976), always right-handed."""
    a, b = source.mean(axis=0), target.mean(axis=0)
    U, _, Vt = np.linalg.svd((source - a).T @ (target - b))
    R = Vt.T @ np.diag([1.0, 1.0, np.sign(np.linalg.det(Vt.T @ U.T))]) @ U.T
    return make_transform(R, b - R @ a)


def robust_motion(source: Array, target: Array) -> tuple[Array, float]:
    """T (4, 4) and the median distance m it leaves: the best of many small subsets, refined on the nearer half.

    Deterministic; half of the readings may be wrong (Rousseeuw 1984).
    """
    n = len(source)
    best = rigid_motion(source, target)
    least = float(np.median(np.linalg.norm(source @ best[:3, :3].T + best[:3, 3] - target, axis=1)))
    if n > SUBSET:
        rows = default_rng(0).random((TRIALS, n)).argpartition(SUBSET, axis=1)[:, :SUBSET]
        R, t = _motions(source[rows], target[rows])
        medians = np.median(np.linalg.norm(source @ np.swapaxes(R, 1, 2) + t[:, None] - target, axis=2), axis=1)
        k = int(np.argmin(medians))
        best, least = make_transform(R[k], t[k]), float(medians[k])
    for _ in range(3):
        off = np.linalg.norm(source @ best[:3, :3].T + best[:3, 3] - target, axis=1)
        near = off <= np.median(off)
        if near.sum() >= 3:
            T = rigid_motion(source[near], target[near])
            median = float(np.median(np.linalg.norm(source @ T[:3, :3].T + T[:3, 3] - target, axis=1)))
            if median > least:
                break
            best, least = T, median
    return best, least


def _motions(source: Array, target: Array) -> tuple[Array, Array]:
    """Rotations (m, 3, 3) and shifts (m, 3) that move source (m, k, 3) onto target, all at once (Kabsch 1976)."""
    a, b = source.mean(axis=1), target.mean(axis=1)
    U, _, Vt = np.linalg.svd(np.swapaxes(source - a[:, None], 1, 2) @ (target - b[:, None]))
    V = np.swapaxes(Vt, 1, 2).copy()
    V[:, :, 2] *= np.sign(np.linalg.det(V @ np.swapaxes(U, 1, 2)))[:, None]
    R = V @ np.swapaxes(U, 1, 2)
    return R, b - (R @ a[..., None])[..., 0]


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
    campaign: Campaign, choice: Choice = PLAIN, priors: Priors = WEAK, noise: Noise | None = None, begin: State | None = None
) -> Fit:
    """Fit the model `choice`. Without `noise` the joint noise is estimated with it; `begin` is a state nearby.

    Priors are centred at the nominal robot and the cell's nests; where `begin` is given only the search starts there.
    """
    c = campaign
    nominal = nominal_state(c.robot, c.readings, c.payloads, c.instrument, choice)
    layout = build_layout(c.robot, c.readings, c.instrument, choice, priors)
    estimated = noise is None
    if begin is None:
        few = _thinned(c.readings, ROUGH)
        if c.pairs is None and len(few) < len(c.readings) / 3:
            rough = fit_campaign(replace(c, readings=few), choice, priors, noise)
            begin, noise = rough.state, rough.noise
        else:
            begin = located(campaign, nominal)
    start = replace(nominal, stations=begin.stations)
    offset = offset_between(layout, start, begin)
    noise = noise or Noise()
    result = solve(campaign, layout, begin, offset, noise)
    if estimated:
        for _ in range(3):
            found = result.joint_noise()
            if abs(np.log(found.joints / noise.joints)) < 0.02:
                break
            noise = found
            result = solve(campaign, layout, result.state, result.offset, noise)
    return _finished(campaign, choice, priors, layout, start, result, noise)


def with_turn_sd(campaign: Campaign, choice: Choice = PLAIN) -> Campaign:
    """`campaign` with one sigma of its orientations, where the file tells none, or one that is MISSTATED times too large or too
    small: as they scatter about an arm that is fitted with hardly any weight on them (MEDIAN_TURN: the length of three
    components has its median there)."""
    r = campaign.readings
    if r.turn is None:
        return campaign
    loose = replace(campaign, readings=replace(r, sigma_turn=np.full(len(r), LOOSE_TURN)))
    off = np.linalg.norm(fit_campaign(loose, choice).residual[r.turned, 3:], axis=1)
    sd = max(float(np.median(off)) / MEDIAN_TURN, LEAST_TURN_SD)
    if (stated := stated_turn_sd(r)) is not None and sd / MISSTATED <= stated <= sd * MISSTATED:
        return campaign
    return replace(campaign, readings=replace(r, sigma_turn=np.full(len(r), sd)))


def stated_turn_sd(r: Readings) -> float | None:
    """One sigma rad of orientations that the file states, the median of its rows; None where it states none."""
    told = np.zeros(0) if r.sigma_turn is None else r.sigma_turn[r.turned & np.isfinite(r.sigma_turn)]
    return float(np.median(told)) if len(told) else None


def learned_priors(fit: Fit) -> Priors:
    """Priors as wide as the deviations that this robot shows (MacKay 1992, eq. 2.20), lengths and angles apart.

    What no reading determines then varies as much as what the readings do determine: the gauge's honest sd.
    """
    widths = [
        learned_width(fit.offset[columns], fit.sd[columns], before)
        for columns, before in zip(fit.layout.geometry, (fit.priors.length, fit.priors.angle), strict=True)
    ]
    return replace(fit.priors, length=widths[0], angle=widths[1])


def fit_learned(fit: Fit) -> Fit:
    """The same model fitted again from where it stands, with `learned_priors`."""
    return fit_campaign(fit.campaign, fit.choice, learned_priors(fit), begin=fit.state)


def learned_width(offset: Array, sd: Array, before: float) -> float:
    """One sigma of the prior of unknowns that are alike, from what a fit with the prior `before` made of them: the rms of their
    offsets (m,) over the number of directions seen, which posterior sd (m,) tell (MacKay 1992, eq. 2.20)."""
    known = float(np.sum(1.0 - (sd / before) ** 2))
    return float(np.clip(np.sqrt(np.sum(offset**2) / known), *LEARNED)) if known > 2.0 else before


def located(campaign: Campaign, state: State) -> State:
    """`state` with its stations where most readings want them, and nests that the cell does not place."""
    c = campaign = replace(campaign, readings=_thinned(campaign.readings, LOCATING), pairs=None)
    at_origin = replace(state, stations=np.tile(np.eye(4), (len(c.readings.stations), 1, 1)))
    base_points = c.readings.point - residuals(c.robot, c.readings, c.instrument, at_origin)[:, :3]
    stations = at_origin.stations.copy()
    for k in np.unique(c.readings.station):
        rows = c.readings.station == k
        stations[k] = robust_motion(base_points[rows], c.readings.point[rows])[0]
    state = replace(state, stations=stations)
    rigid = Choice(geometry=False, joints=())
    layout = build_layout(c.robot, c.readings, c.instrument, rigid, Priors())
    return solve(campaign, layout, state, np.zeros(layout.size), Noise()).state


def _thinned(readings: Readings, most: int) -> Readings:
    """At most `most` readings of each nest from each station, evenly taken."""
    kind = readings.station * len(readings.targets) + readings.target
    groups = [np.flatnonzero(kind == k) for k in np.unique(kind)]
    few = [rows[np.unique(np.linspace(0, len(rows) - 1, most).astype(np.int64))] for rows in groups]
    return readings.take(np.sort(np.concatenate(few)))


def _finished(
    campaign: Campaign, choice: Choice, priors: Priors, layout: Layout, start: State, solution: Solution, noise: Noise
) -> Fit:
    """Covariance of the M-estimator (Huber 1981, section 7.6) about the solution."""
    k = solution.linear.residual.shape[1]
    n, p = len(solution.linear.residual), layout.size
    precision = layout.precision
    # Degrees of freedom that the readings, not the priors, take up.
    whitened = ((solution.W @ solution.linear.J) * layout.scale / solution.spread).reshape(-1, p)
    gained = whitened.T @ whitened
    used = float(np.trace(np.linalg.solve(gained + np.diag(precision + 1e-12), gained)))
    sound = np.ones(n, bool)
    for _ in range(2):  # what is gross says nothing of how the others scatter
        count = int(sound.sum())
        left = max(count * k - used, 0.0)
        freedom = max(left / (count * k), 0.05)
        # Few readings say little of their own scatter: there the noise model speaks, worth TRUST readings' components.
        spread = float(np.sqrt((TRUST + left * spread_of(solution.squared[sound], k, freedom) ** 2) / (TRUST + left)))
        m2 = solution.squared / spread**2
        weight = weights(m2, k)
        sound = weight > GROSS * weights(np.zeros(1), k)
    # psi = w z; its mean square and mean slope correct the covariance of weighted least squares, and the slope's own
    # scatter makes up for unknowns that are not few against the readings (Huber 1981, eq. 7.6.5).
    power, slope, scatter = moments(m2, k)
    expected = gaussian_moments(k)
    power = (TRUST * expected[0] + left * power / freedom) / (TRUST + left)
    slope = (TRUST * expected[1] + left * slope) / (TRUST + left)
    power *= (1.0 + used / (n * k) * scatter / slope**2) ** 2
    scaled = whitened * solution.spread / spread
    if campaign.pairs is not None:
        precision[station_shifts(layout)] = 1.0  # differences do not place the stations; `methods` does afterwards
    gain = slope**2 / power
    covariance = scaled_inverse(gain * scaled.T @ scaled + np.diag(precision), layout)
    if campaign.pairs is None:
        shared = gain * _shared_in_postures(solution, scaled, weight, spread, noise, used)
        covariance = covariance + covariance @ (shared / np.outer(layout.scale, layout.scale)) @ covariance
    believed, found = (campaign, choice, priors, layout, start), (solution.state, solution.offset, covariance)
    seen = solution.linear.residual, weight / weights(np.zeros(1), k), solution.squared, solution.linear.J, solution.W
    return Fit(*believed, *found, *seen, noise, spread, solution.steps)


def _shared_in_postures(solution: Solution, scaled: Array, weight: Array, spread: float, noise: Noise, used: float) -> Array:
    """Covariance (p, p) that the gradient has beside that of independent readings: gears err alike whenever the axes come back.

    The shared part s of the joint noise is told by residuals of one posture and station, s^2 = sum off_i . off_j / sum tr(D_i
    D_j^T) over i != j, the degrees of freedom that the fit took from the postures given back. scaled (n k, p): sensitivities.
    """
    readings, D, n = solution.campaign.readings, solution.linear.d_joints, len(weight)
    posture = readings.postures()
    stand = np.unique(np.column_stack([posture, readings.station]), axis=0, return_inverse=True)[1].ravel()
    w = weight[:, None] / weights(np.zeros(1), solution.W.shape[1])
    common = _between(stand, w * solution.linear.residual[:, :3]).sum() / max(1.0 - used / (3 * (posture.max() + 1)), 0.1)
    by_joints = _between(stand, (w * D.reshape(n, -1))).sum()
    if by_joints <= 0.0:
        return np.zeros((scaled.shape[1], scaled.shape[1]))
    s2 = float(np.clip(common / by_joints, 0.0, (noise.joints * spread) ** 2))
    moved = solution.W[:, :, :3] @ D / spread
    X = np.swapaxes(scaled.reshape(n, -1, scaled.shape[1]), 1, 2) @ moved
    sums = np.zeros((posture.max() + 1, *X.shape[1:]))
    np.add.at(sums, posture, X)
    return np.asarray(s2 * (np.einsum("gpj,gqj->pq", sums, sums) - np.einsum("npj,nqj->pq", X, X)))


def _between(group: Index, rows: Array) -> Array:
    """Sum over i != j of one group of the products of rows (n, k), by column (k,)."""
    sums = np.zeros((group.max() + 1, rows.shape[1]))
    np.add.at(sums, group, rows)
    return np.asarray((sums**2).sum(axis=0) - (rows**2).sum(axis=0))


def scaled_inverse(information: Array, layout: Layout) -> Array:
    """Covariance (p, p) of an information matrix in units of the layout's scale. Raises OpenDirection: it has no inverse."""
    check_open(information, layout)
    inverse = cho_solve(cho_factor(information), np.eye(layout.size))
    return np.asarray(layout.scale[:, None] * inverse * layout.scale[None, :])


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
    linear = linearise(c.robot, replace(seen, point=np.nan_to_num(seen.point)), c.instrument, fit.layout, fit.state)
    J = linear.J[:, :3]
    return linear.point, np.asarray(J @ fit.covariance @ np.swapaxes(J, 1, 2))


def predictive_covariance(fit: Fit, readings: Readings, repeatability: float = 0.0) -> Array:
    """Covariance (n, 3, 3) m^2 of where reflectors will be less where `predict_readings` puts them, tracker's frame.

    The joint noise of the fit is more than the joints' repeatability (rad, from repeats; 0 where nothing was repeated):
    gear errors and the like, which are the same whenever an axis comes back, and so are in a noise-free reading too.
    """
    c = fit.campaign
    seen = replace(readings, turn=None, point=np.nan_to_num(readings.point))
    d_joints = linearise(c.robot, seen, c.instrument, fit.layout, fit.state).d_joints
    unmodelled = fit.spread**2 * max(fit.noise.joints**2 - repeatability**2, 0.0)
    return np.asarray(predict_readings(fit, readings)[1] + unmodelled * d_joints @ np.swapaxes(d_joints, 1, 2))
