"""A tracker (or base) that was moved while one station was read: the one split of its rows after which all lie elsewhere.

With whitened residuals r of a fit, its sensitivities A and priors P, and C the six columns of a rigid motion of the later rows,
what the motion would gain, the fit's unknowns moving along, is

    g^T K^-1 g,   g = C^T M r,   K = C^T M C,   M = 1 - A (A^T A + P)^-1 A^T

chi-square with six degrees of freedom where nothing moved.
"""

from dataclasses import dataclass

import numpy as np
from scipy.special import chdtrc

from robots.calibration.fit import Fit
from robots.tracker_readings import Index, Readings

LEAST = 6  # readings on either side
SURE = 1e-6  # chance of such a gain, the number of splits allowed for
SHARE = 0.2  # of what is left over that one motion takes away: gears and heat, which go with the rows too, leave less at once


@dataclass(frozen=True)
class MovedStand:
    """The line from which on readings of a station lie elsewhere, by how far (m, at their middle)."""

    station: str
    line: int
    distance: float

    @property
    def words(self) -> str:
        """What it looks like and what to do."""
        where = f" of station {self.station}" if self.station else ""
        return (
            f"From about line {self.line} on readings{where} lie {1e3 * self.distance:.2g} mm off those before, as if tracker, "
            "base or load were not the same: give the later ones a station (or payload) of their own."
        )


def moved_stands(fit: Fit) -> list[MovedStand]:
    """Of each station the split that explains most, where it is sure and takes a good part of what is left over."""
    found = (_moved(fit, np.flatnonzero(fit.campaign.readings.station == k)) for k in np.unique(fit.campaign.readings.station))
    return [one for one in found if one is not None]


def _moved(fit: Fit, rows: Index) -> MovedStand | None:
    r = fit.campaign.readings
    order = _in_time(r, rows)
    count = len(order)
    if count < 2 * LEAST:
        return None
    W = fit.W[:, :3, :3] * np.sqrt(np.minimum(fit.weight, 1.0))[:, None, None] / fit.spread
    A = (W @ fit.J[:, :3]) * fit.layout.scale
    inner = np.linalg.inv(np.einsum("nip,niq->pq", A, A) + np.diag(fit.layout.precision + 1e-12))
    off = (W @ fit.residual[:, :3, None])[..., 0]
    off = off - np.einsum("nip,pq,q->ni", A, inner, np.einsum("nip,ni->p", A, off))  # at the fit's rest next to nothing
    point = r.point[order] - r.point[order].mean(axis=0)
    turn = np.cross(np.eye(3)[None], point[:, None])  # column j is e_j x p, (n, 3, 3)
    C = W[order] @ np.concatenate([np.tile(np.eye(3), (count, 1, 1)), np.swapaxes(turn, 1, 2)], axis=2)
    later = [
        np.cumsum(each[::-1], axis=0)[::-1]
        for each in (
            np.einsum("nij,nik->njk", C, C),
            np.einsum("nij,nip->njp", C, A[order]),
            np.einsum("nij,ni->nj", C, off[order]),
        )
    ]
    splits = np.arange(LEAST, count - LEAST + 1)
    CC, CA, g = (each[splits] for each in later)
    K = CC - CA @ inner @ np.swapaxes(CA, 1, 2)
    motion = np.linalg.solve(K, g[..., None])[..., 0]
    gain = np.einsum("sj,sj->s", g, motion)
    best = int(np.argmax(gain))
    if chdtrc(6, gain[best]) * len(splits) > SURE or gain[best] < SHARE * np.sum(off[order] ** 2):
        return None
    first = order[splits[best]]
    middle = point[splits[best] :].mean(axis=0)
    shift = motion[best, :3] + np.cross(motion[best, 3:], middle)
    return MovedStand(r.stations[r.station[first]], int(r.line[first]), float(np.linalg.norm(shift)))


def _in_time(readings: Readings, rows: Index) -> Index:
    """Rows in the order of sessions and times, of the file where it tells none."""
    if readings.time is None:
        return rows
    return rows[np.lexsort([readings.time[rows], readings.session[rows]])]
