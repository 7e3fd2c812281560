"""Readings of one nest, payload, session or stand that scatter more than the others: what no one joint noise makes.

A fit has one joint noise for all readings, so a nest that flops raises it for all and is then noise. Here each group has its own,
`s` for its readings and `t` for the others, by Student's t:

    2 [log p(group | s) + log p(others | t) - max over one noise of both] ~ chi^2(1)

if all scatter alike. Noise acts through each reading's own levers: a nest farther out scatters more and is no such group.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize_scalar
from scipy.special import chdtrc

from robots.calibration.noise import JOINT_NOISE, Noise, reading_covariance, whitener
from robots.calibration.student_t import NU, consistency
from robots.pose import Array
from robots.tracker_readings import Index, Instrument, Readings

KINDS = {"target": "nest", "payload": "payload", "session": "session", "station": "station"}  # columns, in words


@dataclass(frozen=True)
class GroupScatter:
    """Readings by their kind and name, and the share of all that they are; ratio of their joint noise to the others'; rms m (3D)
    that they scatter beyond these; probability that they scatter like these, the number of groups allowed for."""

    kind: str
    name: str
    share: float
    ratio: float
    rms: float
    p_value: float

    @property
    def words(self) -> str:
        """Where, by how much and how sure."""
        return f"{1e3 * self.rms:.2g} mm more at {KINDS[self.kind]} {self.name} than elsewhere (p {self.p_value:.1g})"

    def holds(self, readings: Readings) -> NDArray[np.bool_]:
        """Which of these readings (n,) are its."""
        return np.asarray(np.array(getattr(readings, f"{self.kind}s"))[getattr(readings, self.kind)] == self.name)


def scatter_by_group(
    off: Array, readings: Readings, instrument: Instrument, noise: Noise, d_joints: Array, least: int
) -> list[GroupScatter]:
    """All groups of `least` readings and more, where as many are others; off (n, 3) m as large as without the fit, d_joints
    (n, 3, 6) in the tracker's frame, noise: of all readings."""
    S = reading_covariance(readings, instrument, noise, d_joints)
    W, expected = whitener(S), np.trace(S, axis1=1, axis2=2)
    moved = noise.joints * W @ d_joints
    share, turn = np.linalg.eigh(moved @ np.swapaxes(moved, 1, 2))  # of the variance, that is the joints', by direction
    squared = np.einsum("nji,nj->ni", turn, np.einsum("nij,nj->ni", W, off)) ** 2
    bounds = tuple(np.log(np.array(JOINT_NOISE) / noise.joints))
    lever = np.sum(d_joints**2, axis=(1, 2))

    def unlikely(log_level: float, rows: Index) -> float:
        variance = 1.0 + np.expm1(2.0 * log_level) * share[rows]
        distance = np.sum(squared[rows] / variance, axis=1) / consistency(3)
        return float(np.sum((NU + 3) * np.log1p(distance / NU)) + np.log(variance).sum())  # twice the logarithm

    def best(rows: Index) -> tuple[float, float]:
        found = minimize_scalar(unlikely, bounds=bounds, args=(rows,), method="bounded", options={"xatol": 1e-2})
        return float(found.x), float(found.fun)

    together = best(np.arange(len(off)))[1]
    groups = [one for one in _groups(readings) if least <= one[2].sum() <= len(off) - least]
    found = []
    for kind, name, inside in groups:
        rows, others = np.flatnonzero(inside), np.flatnonzero(~inside)
        (level, own), (usual, theirs) = best(rows), best(others)
        p = min(1.0, len(groups) * float(chdtrc(1, max(together - own - theirs, 0.0))))
        beyond = float(np.exp(2.0 * level) - np.exp(2.0 * usual)) * noise.joints**2 * lever[rows].mean()
        like_others = noise.joints**2 * float(np.expm1(2.0 * usual)) * lever[rows] + expected[rows]
        beyond = min(beyond, float(np.mean(np.sum(off[rows] ** 2, axis=1) - like_others)))  # gross readings are in the latter
        rms = float(np.sqrt(max(beyond, 0.0)))
        found.append(GroupScatter(kind, name, len(rows) / len(off), float(np.exp(level - usual)), rms, p))
    return found


def _groups(r: Readings) -> list[tuple[str, str, NDArray[np.bool_]]]:
    """Kind, name and members (n,)."""
    found = []
    for kind in KINDS:
        index: Index = getattr(r, kind)
        found += [(kind, getattr(r, f"{kind}s")[k], index == k) for k in np.unique(index)]
    return found
