"""What runs differ by beyond the noise and the model: an offset of each run as one more random quantity.

Wear, a changed friction, a blade gripped anew move whole runs. Unless the fit allows for it, it takes them for
registration and is far too sure of it. docs/force_registration.md, eq. 11.
"""

import numpy as np
from numpy.typing import NDArray

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
