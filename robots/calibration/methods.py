"""The ways of calibrating that are compared: ours, the usual one, and the paper's on differences of positions.

full              geometry and springs together (`robots.calibration.fit`)
geometry          geometry alone, springs left out (after Gong et al. 2000, the step that everyone does)
relative          differences between readings of one station, springs inside: the base's place drops out
relative-literal  the paper's order: differences of readings with nearly equal gravity torques, geometry without springs,
                  springs added afterwards (PHYSICS 2.4 says what that does)
"""

from dataclasses import replace

import numpy as np
from scipy.spatial import cKDTree

from robots.calibration.fit import PLAIN, WEAK, Fit, fit_campaign, located, scaled_inverse
from robots.calibration.layout import Choice, Priors, State, believed_compliance, nominal_state
from robots.calibration.noise import reading_covariance, whitener
from robots.calibration.reading_model import ARM_NAMES
from robots.calibration.residuals import linearise, residuals
from robots.calibration.solver import Campaign
from robots.calibration.store import Calibration
from robots.calibration.student_t import MEDIAN_OF_THREE, gaussian_moments, spread_of, tail_weights, weights
from robots.gravity import weight_torques
from robots.pose import Array
from robots.robot import Robot
from robots.tracker_readings import Index, Readings

METHODS = ("full", "geometry", "relative", "relative-literal")
PARTNERS = 3  # differences each reading takes part in, about


def calibrate_by(
    method: str, campaign: Campaign, choice: Choice = PLAIN, priors: Priors = WEAK, begin: State | None = None
) -> Fit:
    """Fit by a method's name, from the geometry and places of `begin` if given. The state of every result places all stations, so
    that it predicts readings."""
    rigid = replace(choice, joints=(), payloads=())
    if method == "full":
        return fit_campaign(campaign, choice, priors, begin=begin)
    if begin is not None and method in ("geometry", "relative-literal"):
        begin = _without_terms(begin, campaign, rigid)
    if method == "geometry":
        return fit_campaign(campaign, rigid, priors, begin=begin)
    if method == "relative":
        points = replace(campaign, readings=replace(campaign.readings, turn=None))
        fit = fit_campaign(replace(points, pairs=spread_pairs(campaign.readings)), choice, priors, begin=begin)
        return _as_readings(fit, points, fit.state)
    if method == "relative-literal":
        pairs = equal_torque_pairs(campaign.robot, campaign.readings)
        points = replace(campaign, readings=replace(campaign.readings, turn=None))
        fit = fit_campaign(replace(points, pairs=pairs), rigid, priors, begin=begin)
        bends = np.array([float(j in choice.joints) for j in range(1, 7)])
        arm = np.concatenate([fit.state.arm[:30], bends * believed_compliance(campaign.robot)])
        return _as_readings(fit, points, replace(fit.state, arm=arm))
    raise ValueError(f"method '{method}' is not one of {', '.join(METHODS)}")


def _without_terms(state: State, campaign: Campaign, choice: Choice) -> State:
    """`state` with springs and payloads as `choice` holds them."""
    c = campaign
    nominal = nominal_state(c.robot, c.readings, c.payloads, c.instrument, choice)
    return replace(state, arm=np.concatenate([state.arm[:30], nominal.arm[30:]]), payloads=nominal.payloads)


def _as_readings(fit: Fit, campaign: Campaign, state: State) -> Fit:
    """A fit of differences as one of readings: stations placed, residuals, weights and covariance of the readings themselves.

    The covariance is that of readings with Gaussian errors: differences and a mean over them tell together what they tell.
    """
    state = placed(campaign, state)
    c = campaign
    linear = linearise(c.robot, c.readings, c.instrument, fit.layout, state)
    W = whitener(reading_covariance(c.readings, c.instrument, fit.noise, linear.d_joints))
    squared = np.asarray(((W @ linear.residual[..., None])[..., 0] ** 2).sum(axis=1))
    spread = spread_of(squared, 3)
    weight = weights(squared / spread**2, 3) / weights(np.zeros(1), 3)
    whitened = ((W @ linear.J) * fit.layout.scale / spread).reshape(-1, fit.layout.size)
    power, slope, _ = gaussian_moments(3)
    covariance = scaled_inverse(whitened.T @ whitened * slope**2 / power + np.diag(fit.layout.precision), fit.layout)
    seen = replace(fit, residual=linear.residual, weight=weight, squared=squared, J=linear.J, W=W, spread=spread)
    return replace(seen, campaign=campaign, state=state, covariance=covariance)


def spread_pairs(readings: Readings) -> Index:
    """Pairs (m, 2) of readings of one station, PARTNERS a reading, the same for the same file."""
    rng = np.random.default_rng(0)
    found: list[Index] = []
    for k in np.unique(readings.station):
        rows = np.flatnonzero(readings.station == k)
        for _ in range(PARTNERS):
            order = rng.permutation(rows)
            found.append(np.column_stack([order, np.roll(order, 1)]))
    pairs = np.vstack(found)
    return np.asarray(pairs[pairs[:, 0] != pairs[:, 1]])


def equal_torque_pairs(robot: Robot, readings: Readings) -> Index:
    """Pairs (m, 2) whose elbow and wrist heights are most nearly equal, of one station: joints 2 and 3 bend alike.

    Nearest neighbours in the torques of the arm's own weight about joints 2 and 3 and in the payload.
    """
    # One reading of each posture: repeats are equal in everything and tell nothing.
    _, one = np.unique(np.column_stack([np.round(readings.q, 6), readings.target, readings.payload]), axis=0, return_index=True)
    few = readings.take(one)
    torque = weight_torques(robot, few.q)[:, 1:3]
    scale = torque.std(axis=0).mean() or 1.0
    apart = 1e3 * np.column_stack([few.station, few.payload])
    features = np.hstack([torque / scale, apart])
    _, near = cKDTree(features).query(features, k=min(PARTNERS + 1, len(few)))
    pairs = one[np.column_stack([np.repeat(np.arange(len(few)), near.shape[1] - 1), near[:, 1:].ravel()])]
    pairs = pairs[readings.station[pairs[:, 0]] == readings.station[pairs[:, 1]]]
    return np.unique(np.sort(pairs, axis=1), axis=0)


def placed(campaign: Campaign, state: State) -> State:
    """`state` with each station shifted to where its readings want it (robust mean of the residuals)."""
    c = campaign
    off = residuals(c.robot, c.readings, c.instrument, state)[:, :3]
    stations = state.stations.copy()
    for k in np.unique(c.readings.station):
        stations[k, :3, 3] += robust_mean(off[c.readings.station == k])
    return replace(state, stations=stations)


def robust_mean(rows: Array) -> Array:
    """Student-t mean (3,) of rows (n, 3) with a spread of their own."""
    mean = np.median(rows, axis=0)
    for _ in range(30):
        squared = ((rows - mean) ** 2).sum(axis=1)
        weight = tail_weights(squared / (np.median(squared) / MEDIAN_OF_THREE + 1e-30), 3)
        mean = (weight[:, None] * rows).sum(axis=0) / weight.sum()
    return np.asarray(mean)


def before(campaign: Campaign, choice: Choice = PLAIN) -> State:
    """The believed robot with only the tracker and its nests placed: what there is before calibration."""
    c = campaign
    return located(c, nominal_state(c.robot, c.readings, c.payloads, c.instrument, choice))


def errors_as_calibrated(campaign: Campaign, known: Calibration) -> Array:
    """Errors (n,) m of all readings by an arm as `known` has it, with the tracker and its nests placed by them."""
    c, bending = campaign, known.bending_joints
    choice = PLAIN if bending is None else Choice(joints=bending)
    state = nominal_state(c.robot, c.readings, c.payloads, c.instrument, choice)
    arm = state.arm.copy()
    for i, name in enumerate(ARM_NAMES):
        if name in known.names:
            arm[i] = known.values[known.names.index(name)]
    off = residuals(c.robot, c.readings, c.instrument, located(c, replace(state, arm=arm)))
    return np.asarray(np.linalg.norm(off[:, :3], axis=1))
