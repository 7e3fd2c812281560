"""The noise of a log's force readings as one linear filter, with a weight for every row: contact and air apart."""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from ocp.calibrate.force.log import ForceLog
from ocp.calibrate.force.noise import Noise, Runs, estimate_noise, student_weights, whiten
from robots.pose import Array

FEW = 20  # rows of a kind from which its noise is estimated


@dataclass(frozen=True)
class Whitened:
    """Innovations of the residuals (n,) and of the sensitivities (n, k), each of unit variance (eq. 6)."""

    residual: Array
    sensitivity: Array


@dataclass(frozen=True)
class Kind:
    """Rows of one kind (contact or air): their places, their stretches, their noise as a factor on `ForceChannel.base`."""

    rows: NDArray[np.int64]
    runs: Runs
    noise: Noise


@dataclass(frozen=True)
class ForceChannel:
    """base (n,) N: the sensor's own sigma, 1 where it gives none; weight (n,) of Student's t; kinds by contact (True) and air."""

    base: Array
    weight: Array
    kinds: dict[bool, Kind]

    def reweighted(self, residual: Array) -> "ForceChannel":
        """Weights for residuals (n,) N, outliers low."""
        weight = self.weight.copy()
        for kind in self.kinds.values():
            at = kind.rows
            weight[at] = student_weights(kind.runs, kind.noise, residual[at] / self.base[at], weight[at])
        return replace(self, weight=weight)

    def whitened(self, residual: Array, sensitivity: Array) -> Whitened:
        """Residuals (n,) and sensitivities (n, k), in N, through the filter."""
        columns = np.column_stack([residual, sensitivity]) / self.base[:, None]
        out = np.zeros_like(columns)
        for kind in self.kinds.values():
            out[kind.rows] = whiten(kind.runs, kind.noise, self.weight[kind.rows], columns[kind.rows])[0]
        return Whitened(out[:, 0], out[:, 1:])

    def information(self, sensitivity: Array) -> Array:
        """What whitened sensitivities (n, k) tell about the k unknowns, (k, k) (eq. 10)."""
        return np.asarray(sum(k.noise.information() * sensitivity[k.rows].T @ sensitivity[k.rows] for k in self.kinds.values()))

    def sigma(self) -> Array:
        """One sigma (n,) N of each reading."""
        out = self.base.copy()
        for kind in self.kinds.values():
            out[kind.rows] *= kind.noise.sigma
        return out

    def independent(self) -> float:
        """How many independent readings the rows in contact are worth for their mean."""
        kind = self.kinds[True]
        steps = kind.runs.step[np.isfinite(kind.runs.step) & (kind.runs.step > 0)]
        return len(kind.rows) / (kind.noise.samples_each(float(np.median(steps))) if len(steps) else 1.0)


def channel_of(log: ForceLog, residual: Array, before: ForceChannel | None = None) -> ForceChannel:
    """Noise of a log from the scatter of its residuals (n,) N, at least the sensor's own sigma where it gives one.

    `before`: an earlier estimate of the same log to start from.
    """
    base = np.ones(len(log)) if log.sigma_fn is None else log.sigma_fn
    kinds: dict[bool, Kind] = {}
    for contact in (True, False):
        rows = np.flatnonzero(log.contact == contact)
        if not len(rows):
            continue
        run, time = log.run[rows], log.time[rows]
        if len(rows) >= FEW:
            noise = estimate_noise(run, time, residual[rows] / base[rows], before.kinds[contact].noise if before else None)
        elif kinds:
            noise = kinds[True].noise
        else:
            noise = Noise(float(np.std(residual[rows] / base[rows])) or 1.0, 0.0, 1.0)
        if log.sigma_fn is not None:
            noise = replace(noise, sigma=max(noise.sigma, 1.0))
        kinds[contact] = Kind(rows, Runs.of(run, time), noise)
    return ForceChannel(base, before.weight if before else np.ones(len(log)), kinds)
