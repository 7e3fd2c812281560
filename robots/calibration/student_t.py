"""Student-t errors of NU degrees of freedom on a reading as a whole: weights, scale, and how both relate to Gaussian errors.

Lange, Little and Taylor 1989; docs/calibration.md, eq. 3.
"""

from functools import cache

import numpy as np
from scipy.optimize import brentq
from scipy.special import gammaincinv  # chi-square by hand: scipy.stats takes half a second to import

from robots.pose import Array

NU = 8.0  # heavy tails, at 2 % of the efficiency on Gaussian errors
# Weight in the full fit (Student's t, one at no distance: some 11 sigma) below which a reading is an outlier and is not held
# against a model. A diagnosis has weights of another scale, probabilities, and another number.
GROSS = 0.05
MEDIAN_OF_THREE = 2.366  # of chi-square with three degrees of freedom, for scales from medians


def tail_weights(squared: Array, k: int, freedom: float = NU, share: float = 1.0) -> Array:
    """Weights (n,) of readings of k components by Student's t of so many degrees of freedom; squared (n,): squared distances
    over a variance, of which `share` is the square of the t's own scale."""
    return np.asarray((freedom + k) / (freedom * share + squared))


def weights(squared: Array, k: int) -> Array:
    """Weights (n,) of readings of k components whose whitened squared distances over the spread are `squared` (n,)."""
    return tail_weights(squared, k, share=consistency(k))


def moments(squared: Array, k: int) -> tuple[float, float, float]:
    """Of psi = w z: mean square of a component, mean slope, and variance of the slope."""
    w = weights(squared, k)
    slopes = w - 2.0 * w * squared / (NU * consistency(k) + squared) / k
    return float(np.mean(w**2 * squared)) / k, float(np.mean(slopes)), float(np.var(slopes))


@cache
def gaussian_moments(k: int) -> tuple[float, float, float]:
    """`moments` of Gaussian errors."""
    return moments(_quantiles(k), k)


def _quantiles(k: int) -> Array:
    return np.asarray(2.0 * gammaincinv(0.5 * k, (np.arange(4000) + 0.5) / 4000))


def spread_of(squared: Array, k: int, freedom: float = 1.0) -> float:
    """Scale of the residuals over the noise model that the Student-t likelihood wants, one for Gaussian errors.

    The root of mean (NU + k) u / (NU a + u) = k freedom with u = squared / spread^2 and `consistency` a.
    """
    a = consistency(k)
    scale2 = float(np.median(squared)) / _chi2_median(k)
    for _ in range(50):
        u = squared / scale2
        before, scale2 = scale2, scale2 * float(np.mean((NU + k) * u / (NU * a + u))) / (k * freedom)
        if abs(scale2 / before - 1) < 1e-6:
            break
    return float(np.sqrt(scale2))


@cache
def _chi2_median(k: int) -> float:
    return float(2.0 * gammaincinv(0.5 * k, 0.5))


@cache
def consistency(k: int) -> float:
    """Share a of the variance that a Student-t of k dimensions takes for the scale of Gaussian errors."""

    def excess(a: float) -> float:
        u = _quantiles(k)
        return float(np.mean((NU + k) * u / (NU * a + u)) - k)

    return float(brentq(excess, 0.1, 1.0))
