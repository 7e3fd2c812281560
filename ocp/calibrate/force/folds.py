"""Held-out error of a force fit by blocked folds: whole runs, lines, sessions, setpoints and belt directions left out.

Folds are solved in the linearised problem about the estimate, which is exact Gaussian updating (eq. 12).
"""

from dataclasses import dataclass

import numpy as np

from ocp.calibrate.force.fit import ForceSolution
from ocp.calibrate.force.log import Flags, ForceLog, Index
from ocp.calibrate.force.model import ForceRows
from robots.pose import Array


@dataclass(frozen=True)
class HeldOutForce:
    """Rows in contact that were predicted without them: what was left out, how many, rms and mean of measured minus
    predicted N, gap N (rms without the noise)."""

    left_out: str
    rows: int
    rms: float
    mean: float
    gap: float


@dataclass(frozen=True)
class Blocks:
    """A way to cut the log into blocks: block (n,) of each row, -1 for none; labels."""

    by: str
    block: Index
    labels: tuple[str, ...]


def blocks_of(log: ForceLog, rows: ForceRows) -> list[Blocks]:
    """Every way to cut the log that leaves at least two blocks in contact."""
    ways = [Blocks("run", log.run, log.runs), Blocks("session", log.session, log.sessions)]
    if log.line is not None:
        ways.append(_by_value("line", log.line.astype(float), log.contact))
    ways.append(_by_value("setpoint", np.round(rows.setpoint, 1), log.contact))
    ways.append(_by_value("belt direction", rows.belt, log.contact))
    return [way for way in ways if len(np.unique(way.block[log.contact])) > 1]


def _by_value(by: str, values: Array, contact: Flags) -> Blocks:
    levels = np.unique(values[contact])
    block = np.where(contact, np.searchsorted(levels, values).clip(max=len(levels) - 1), -1)
    return Blocks(by, block.astype(np.int64), tuple(f"{level:g}" for level in levels))


def held_out_blocks(solution: ForceSolution, log: ForceLog, rows: ForceRows) -> dict[str, list[HeldOutForce]]:
    """Errors of each block of each way to cut the log, predicted from the other blocks."""
    out: dict[str, list[HeldOutForce]] = {}
    for way in blocks_of(log, rows):
        present = [b for b in range(len(way.labels)) if (log.contact & (way.block == b)).any()]
        out[way.by] = [_fold(solution, log, way.labels[b], way.block == b) for b in present]
    return out


def pooled_blocks(folds: list[HeldOutForce]) -> HeldOutForce:
    """All folds of one way to cut the log as one figure; the mean is that of the folds' sizes |mean|."""
    n = np.array([fold.rows for fold in folds], float)

    def together(name: str) -> float:
        return float(np.sqrt(np.sum(n * np.array([getattr(fold, name) for fold in folds]) ** 2) / n.sum()))

    return HeldOutForce("each in turn", int(n.sum()), *(together(name) for name in ("rms", "mean", "gap")))


def without_rows(information: Array, sensitivity: Array, residual: Array) -> tuple[Array, Array]:
    """By how much unknowns (k,) move when rows are left out, and their covariance (k, k) then (eq. 12).

    information (k, k): of the rows that stay, the prior's in; whitened sensitivity (m, k) and residual (m,) of those left out.
    At the estimate the whole gradient is zero: what these rows pulled is what their absence lets go.
    """
    return np.asarray(-np.linalg.solve(information, sensitivity.T @ residual)), np.asarray(np.linalg.inv(information), float)


def _fold(solution: ForceSolution, log: ForceLog, label: str, left: Flags) -> HeldOutForce:
    """The block's readings from the other rows: a downdate of the information, a step of the unknowns."""
    white, channel = solution.whitened, solution.channel
    A, taken = white.sensitivity[left], np.zeros_like(solution.information)
    for kind in channel.kinds.values():
        at = kind.rows[left[kind.rows]]
        taken += kind.noise.information() * white.sensitivity[at].T @ white.sensitivity[at]
    change, _ = without_rows(solution.information - taken, A, white.residual[left])
    at = np.flatnonzero(left & log.contact)
    root = solution.jacobian[at] @ solution.prior.root
    error = log.fn[at] - solution.reading[at] - root @ change[: root.shape[1]]
    rms = float(np.sqrt(np.mean(error**2)))
    noise = float(np.mean(channel.sigma()[at] ** 2))
    return HeldOutForce(label, len(at), rms, float(error.mean()), float(np.sqrt(max(rms**2 - noise, 0.0))))
