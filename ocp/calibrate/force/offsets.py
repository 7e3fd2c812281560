"""What runs differ by beyond the noise and the model: an offset of each run as one more random quantity.

Wear, a changed friction, a blade gripped anew move whole runs. Unless the fit allows for it, it takes them for
registration and is far too sure of it. Calibration finds the offsets' size (`offset_size`, docs/force_registration.md, eq. 11).
The diagnosis names such causes: it takes a small size as known, and has beside it setpoints that were read off the log
(`RunOffsets`).
"""

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from ocp.calibrate.force.log import ForceLog
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
