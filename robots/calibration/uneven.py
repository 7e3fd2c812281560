"""Readings of one nest, payload, session or stand, or one joint, that scatter more than others: what no one joint noise makes.

A fit has one joint noise for all readings, so a nest that flops raises it for all and is then noise. Here each group has its own,
`s` for its readings and `t` for the others, by Student's t:

    2 [log p(group | s) + log p(others | t) - max over one noise of both] ~ chi^2(1)

if all scatter alike. Noise acts through each reading's own levers: a nest farther out scatters more and is no such group.

So with one joint, whose levers tell it: an axis that errs by what nothing recorded tells (a hose that pulls it, a slipping belt)
raises the noise of all, and there, small beside the first axes' long levers, it is hardly seen.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize, minimize_scalar
from scipy.special import chdtrc

from robots.calibration.noise import JOINT_NOISE, Noise, reading_covariance, whitener
from robots.calibration.student_t import NU, consistency
from robots.pose import Array
from robots.tracker_readings import Index, Instrument, Readings

KINDS = {"target": "nest", "payload": "payload", "session": "session", "station": "station"}  # columns, in words
INSTRUMENT_NOISE = (0.1, 1e3)  # times the stated, where it is searched


@dataclass(frozen=True)
class GroupScatter:
    """Readings by their kind and name, or a joint by its number and all readings, and the share of all that they are; their joint
    noise rad and its ratio to the others'; rms m (3D) that they scatter beyond these; probability that they scatter like these,
    the number of groups allowed for."""

    kind: str
    name: str
    share: float
    joints: float
    ratio: float
    rms: float
    p_value: float

    @property
    def words(self) -> str:
        """Where, by how much and how sure."""
        where = f"{KINDS.get(self.kind, self.kind)} {self.name}"
        return f"{1e3 * self.rms:.2g} mm more at {where} than elsewhere (p {self.p_value:.1g})"

    def holds(self, readings: Readings) -> NDArray[np.bool_]:
        """Which of these readings (n,) are its and no others'; none are a joint's alone."""
        if self.kind == "joint":
            return np.zeros(len(readings), bool)
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
        joints, ratio = noise.joints * float(np.exp(level)), float(np.exp(level - usual))
        found.append(GroupScatter(kind, name, len(rows) / len(off), joints, ratio, rms, p))
    return found


def scatter_by_joint(off: Array, readings: Readings, instrument: Instrument, noise: Noise, d_joints: Array) -> list[GroupScatter]:
    """All joints, each with noise of its own beside that of all and of the instrument, whatever that is: an instrument worse than
    stated, or its tails, would else be the wrist's, of short levers. off, d_joints as in `scatter_by_group`."""
    still = reading_covariance(readings, instrument, Noise(0.0), d_joints)
    each = np.einsum("nij,nkj->jnik", d_joints, d_joints)
    parts = np.array([still, each.sum(axis=0), *each])
    searched = np.log([INSTRUMENT_NOISE, JOINT_NOISE, JOINT_NOISE])

    def least(shown: list[int], begin: Array) -> tuple[Array, float]:
        """Logarithms of the noises of these parts, and twice that of the likelihood, negative."""

        def unlikely(logs: Array) -> tuple[float, Array]:
            scale = consistency(3) * np.exp(2.0 * logs)
            covariance = np.tensordot(scale, parts[shown], 1)
            inverse = np.linalg.inv(covariance)
            w = np.einsum("nij,nj->ni", inverse, off)
            squared = np.einsum("ni,ni->n", off, w)
            value = np.sum((NU + 3) * np.log1p(squared / NU)) + np.linalg.slogdet(covariance)[1].sum()
            slope = inverse - ((NU + 3) / (NU + squared))[:, None, None] * w[:, :, None] * w[:, None, :]  # in the covariance
            return float(value), 2.0 * scale * np.tensordot(parts[shown], slope, 3)

        found = minimize(unlikely, begin, method="L-BFGS-B", jac=True, bounds=searched[: len(shown)])
        return found.x, float(found.fun)

    usual, alike = least([0, 1], np.log([1.0, noise.joints]))
    found = []
    for j, one in enumerate(each):
        (_, *logs), apart = least([0, 1, 2 + j], np.append(usual, usual[1]))
        of_all, own = np.exp(logs)
        p = min(1.0, len(each) * float(chdtrc(1, max(alike - apart, 0.0))))
        rms = float(own * np.sqrt(np.trace(one, axis1=1, axis2=2).mean()))
        joints = float(np.hypot(of_all, own))
        found.append(GroupScatter("joint", f"{j + 1}", 1.0, joints, joints / float(of_all), rms, p))
    return found


def _groups(r: Readings) -> list[tuple[str, str, NDArray[np.bool_]]]:
    """Kind, name and members (n,)."""
    found = []
    for kind in KINDS:
        index: Index = getattr(r, kind)
        found += [(kind, getattr(r, f"{kind}s")[k], index == k) for k in np.unique(index)]
    return found
