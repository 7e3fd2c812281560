"""How sure one reading is: the tracker's beam, the joints' repeatability, and what repeats say of both."""

from dataclasses import dataclass

import numpy as np
from scipy.optimize import minimize_scalar

from robots.calibration.student_t import MEDIAN_OF_THREE, NU, consistency
from robots.pose import Array
from robots.tracker_readings import Index, Instrument, Readings

JOINT_NOISE = (1e-6, 3e-3)  # rad, where the joint noise is searched
TURN_SD = np.radians(0.01)  # of a 6D target where the file gives none


@dataclass(frozen=True)
class Noise:
    """Joint noise rad (one sigma, the same for all axes): repeatability and what else moves joints without being modelled."""

    joints: float = 1e-5


def reading_covariance(readings: Readings, instrument: Instrument, noise: Noise, d_joints: Array) -> Array:
    """Covariance (n, 3, 3) m^2 of the readings in their tracker's frame.

    Along the beam the range noise, across it range noise + transverse noise times range (FORMATS, [tracker]); a sigma
    column replaces both. d_joints (n, 3, 6) m/rad in the same frame carries the joint noise.
    """
    if readings.sigma is not None:
        tracker = readings.sigma[:, None, None] ** 2 * np.eye(3)
    else:
        distance = np.linalg.norm(readings.point, axis=1)
        beam = readings.point / distance[:, None]
        along = beam[:, :, None] * beam[:, None, :]
        across = (instrument.range_noise + instrument.transverse_noise * distance) ** 2
        tracker = across[:, None, None] * (np.eye(3) - along) + instrument.range_noise**2 * along
    return np.asarray(tracker + noise.joints**2 * d_joints @ np.swapaxes(d_joints, 1, 2))


def whitener(covariance: Array) -> Array:
    """W (n, k, k) with W covariance W^T = 1."""
    return np.linalg.inv(np.linalg.cholesky(covariance))


def joint_noise(
    off: Array,
    readings: Readings,
    instrument: Instrument,
    d_joints: Array,
    used: float,
    usual: float,
    usual_sd: float,
    pairs: Index | None = None,
) -> Noise:
    """Most probable joint noise for residuals off (n, 3) m of a fit that took up `used` degrees of freedom (Student's t): of the
    readings for what the tracker scatters, of the postures for the joints, whose errors come back with the axes.

    Before any reading it is `usual` rad, with one sigma `usual_sd` of its logarithm. d_joints as in `reading_covariance`; pairs
    (m, 2): the residuals (m, 3) are those of differences between readings.
    """
    freedom = max(1.0 - used / (3.0 * len(off)), 0.1)
    of_joints = max(1.0 - used / (3.0 * (readings.postures().max() + 1)), 0.1) if pairs is None else freedom
    still = reading_covariance(readings, instrument, Noise(0.0), d_joints)
    per_joint = d_joints @ np.swapaxes(d_joints, 1, 2)
    if pairs is not None:
        still, per_joint = (m[pairs[:, 0]] + m[pairs[:, 1]] for m in (still, per_joint))

    def unlikely(log_joints: float) -> float:
        covariance = consistency(3) * (freedom * still + of_joints * np.exp(2 * log_joints) * per_joint)
        _, logdet = np.linalg.slogdet(covariance)
        squared = np.einsum("ni,ni->n", off, np.linalg.solve(covariance, off[..., None])[..., 0])
        known = (log_joints - np.log(usual)) / usual_sd
        return float(0.5 * ((NU + 3) * np.log1p(squared / NU) + logdet).sum() + 0.5 * known**2)

    found = minimize_scalar(unlikely, bounds=tuple(np.log(JOINT_NOISE)), method="bounded", options={"xatol": 1e-2})
    return Noise(float(np.exp(found.x)))


@dataclass(frozen=True)
class Repeats:
    """Scatter of repeated readings about their groups' means: number of groups and of degrees of freedom (3D), rms m (3D),
    joint noise rad that explains it beside the tracker's, and drift of the repeats m/h where times are known."""

    groups: int
    freedom: int
    rms: float
    joints: float
    drift: Array | None


def repeat_scatter(readings: Readings, instrument: Instrument, d_joints: Array) -> Repeats | None:
    """What repeated readings say, or None where nothing was repeated. d_joints (n, 3, 6) in the tracker's frame.

    A common drift over time is taken out first and reported. The joint noise is found by the method of moments on
    median squares, which outliers do not move.
    """
    group = readings.repeats()
    count = np.bincount(group)
    rows = np.flatnonzero(count[group] > 1)
    if not len(rows):
        return None
    group, point = group[rows], readings.point[rows]
    centred, drift = _centred(group, point), None
    if readings.time is not None and np.ptp(readings.time[rows]) > 60.0:
        hours = readings.time[rows, None] / 3600.0
        spread = _centred(group, hours)
        if (spread**2).sum() > 1e-6:
            drift = (spread * centred).sum(axis=0) / (spread**2).sum()
            centred = centred - spread * drift
    dof = 1.0 - 1.0 / count[group]
    still = reading_covariance(readings.take(rows), instrument, Noise(0.0), d_joints[rows])
    per_joint = d_joints[rows] @ np.swapaxes(d_joints[rows], 1, 2)
    squares = (centred**2).sum(axis=1) / dof
    expected, slope = np.trace(still, axis1=1, axis2=2), np.trace(per_joint, axis1=1, axis2=2)
    chi = MEDIAN_OF_THREE / 3.0  # median over mean of such squares
    ratio = float(np.median(squares) / chi)
    joints = float(np.sqrt(max(ratio - np.median(expected), 0.0) / np.median(slope)))
    return Repeats(len(np.unique(group)), 3 * (len(rows) - len(np.unique(group))), float(np.sqrt(ratio)), joints, drift)


def _centred(group: Index, values: Array) -> Array:
    """Values (n, k) less the mean of their group."""
    _, at = np.unique(group, return_inverse=True)
    sums = np.zeros((at.max() + 1, values.shape[1]))
    np.add.at(sums, at, values)
    return values - (sums / np.bincount(at)[:, None])[at]
