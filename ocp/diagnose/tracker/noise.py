"""How sure a reading is while its gap is under diagnosis, and which readings are outliers.

The joint noise is told by three voices: the residual itself (Student-t likelihood), repeats where there are any, and what is
usual. The first is what the diagnosis explains, so an effect not yet named hides in it; it is estimated anew after every
acceptance, and the evidence integrates over the scale on top (docs/diagnosis.md, 'Noise').
"""

import numpy as np
from scipy.optimize import minimize_scalar
from scipy.special import expit

from robots.calibration.noise import Noise, Repeats, reading_covariance
from robots.calibration.solver import JOINT_NOISE
from robots.calibration.student import NU, consistency
from robots.pose import Array
from robots.tracker_readings import Instrument, Readings

USUAL, USUAL_SD = 1e-5, 0.7  # rad, joints' repeatability (KR 210: 0.06 mm at 2.7 m) and one sigma of its logarithm
RESTLESS = 3.5  # of the usual joint noise
REPEATED_SD = 0.3  # of the logarithm where repeats tell it
OUTLIER, WIDE = 0.02, 30.0  # share of outliers and their size against good readings


def plain(noise: Noise) -> Noise:
    """The joint noise that a gap is told against: what the residual asks for unless that is far above the usual (`is_restless`),
    for then it is the gap itself."""
    return Noise(USUAL) if is_restless(noise.joints) else noise


def is_restless(joints: float) -> bool:
    """Whether joint noise (rad) is far above what such joints usually scatter."""
    return joints > RESTLESS * USUAL


def reliability(squared: Array) -> Array:
    """Probability (n,) that a reading of whitened squared distance `squared` (three components) is none of the outliers: flat
    at one for good readings, so that Gaussian evidence stays exact, and zero for gross ones."""
    log_odds = np.log((1 - OUTLIER) / OUTLIER) + 3 * np.log(WIDE) - 0.5 * squared * (1 - 1 / WIDE**2)
    return np.asarray(expit(log_odds))


def joint_noise(
    readings: Readings, instrument: Instrument, off: Array, d_joints: Array, used: float, repeats: Repeats | None
) -> Noise:
    """Most probable joint noise for residuals off (n, 3) m of a fit that used `used` degrees of freedom."""
    freedom = max(1.0 - used / (3.0 * len(off)), 0.1)
    plain = reading_covariance(readings, instrument, Noise(0.0), d_joints)
    per_joint = d_joints @ np.swapaxes(d_joints, 1, 2)
    told = repeats is not None and repeats.freedom >= 12 and repeats.joints > 0
    centre, sd = np.log(USUAL), USUAL_SD
    if told and repeats is not None:
        centre, sd = np.log(max(repeats.joints, JOINT_NOISE[0])), REPEATED_SD + 2.0 / np.sqrt(repeats.freedom)

    def unlikely(log_joints: float) -> float:
        covariance = freedom * consistency(3) * (plain + np.exp(2 * log_joints) * per_joint)
        _, logdet = np.linalg.slogdet(covariance)
        squared = np.einsum("ni,ni->n", off, np.linalg.solve(covariance, off[..., None])[..., 0])
        return float(0.5 * ((NU + 3) * np.log1p(squared / NU) + logdet).sum() + 0.5 * ((log_joints - centre) / sd) ** 2)

    found = minimize_scalar(unlikely, bounds=tuple(np.log(JOINT_NOISE)), method="bounded", options={"xatol": 1e-2})
    return Noise(float(np.exp(found.x)))
