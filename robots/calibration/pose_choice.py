"""Which of many possible readings to take: greedy choice, then exchange of one for another while that helps (Fedorov 1972).

Adding or leaving out a reading changes the information matrix by rank three; the covariance and the gain of every candidate
follow by the Sherman-Morrison-Woodbury formula in one pass over the candidates (docs/poses.md).
"""

from copy import copy
from dataclasses import dataclass

import numpy as np
from scipy.linalg import solve_triangular

from robots.calibration.observability import identifiable_basis, observability
from robots.pose import Array
from robots.tracker_readings import Index

PASSES = 4  # of exchanges; the first two bring nearly all
ACTIVE = 1200  # candidates that a pass looks at
SHORTLIST = 48  # candidates whose singular values are worked out for O2, O3 and O4
NEGLIGIBLE = 1e-4  # singular values of what a criterion looks at, over the largest, that are left out
GAIN = 1e-6  # relative; a smaller improvement is no reason to exchange


@dataclass(frozen=True)
class Pool:
    """Candidates: rows (m, 3, p) over their noise, prior (p,) as in `Sensitivity`; `posture` (m,) and `group` (m,) say which
    share a posture (only one of these is chosen) and which a payload; `least` readings of every group. `J` (k, 3, p): where
    the criterion "zone" wants small errors, over the scatter that a reading there has anyway."""

    rows: Array
    prior: Array
    posture: Index
    group: Index
    least: int = 0
    J: Array | None = None


def choose(pool: Pool, count: int, criterion: str = "O1", passes: int = PASSES) -> Index:
    """`count` candidates (indices into the pool) for the criterion O1..O5 or "zone": the most information on readings
    at `pool.J` (their determinant; where it is large already, the smallest mean variance).

    The first choice is by determinant, whatever the criterion: the others are blind while directions are not yet seen.
    Every pass of exchanges looks at the candidates that were best at its start. Deterministic. Raises ValueError where fewer
    postures than `count` are in the pool.
    """
    if len(np.unique(pool.posture)) < count:
        raise ValueError(f"{count} postures of {len(np.unique(pool.posture))}")
    everything = _State(pool, count, criterion)
    for _ in range(count):
        everything.add(int(np.argmax(np.where(everything.allowed(), everything.determinant_gain(), -np.inf))))
    for _ in range(passes):
        everything.refresh()
        part = everything.narrowed(ACTIVE)
        changed = sum(part.exchange(place) for place in range(count))
        everything.chosen = part.index[part.chosen].tolist()
        if not changed:
            break
    return np.array(everything.chosen, dtype=np.int64)


class _State:
    """The running choice: covariance S of the identifiable directions and V_i = A_i S A_i^T of every candidate i.

    Coordinates are such that `count` average readings and the priors have information 1; `scale` (r,) leads back to units
    of the priors. `index` (m,) are the places of its candidates in the pool.
    """

    def __init__(self, pool: Pool, count: int, criterion: str) -> None:
        self.count, self.criterion, self.least = count, criterion, pool.least
        basis = identifiable_basis(pool.rows, pool.prior, count)
        plain = (pool.rows / pool.prior) @ basis
        value = 1.0 + count * (plain**2).sum(axis=(0, 1)) / len(plain)  # the basis is of eigenvectors
        self.r, self.scale = len(value), np.sqrt(value)
        self.A = np.ascontiguousarray(plain / self.scale)
        self.posture, self.group, self.index = pool.posture, pool.group, np.arange(len(plain))
        self.J = None if pool.J is None else (pool.J / pool.prior).reshape(-1, len(pool.prior)) @ basis / self.scale
        self.chosen: list[int] = []
        self.refresh()

    def narrowed(self, size: int) -> "_State":
        """The same choice among the chosen and the `size` most promising candidates."""
        gain = self._zone_gain() if self.criterion == "zone" else self.determinant_gain()
        keep = np.unique([*self.chosen, *np.argsort(gain)[-size:].tolist()])
        part = copy(self)
        part.A, part.V, part.posture, part.group = (x[keep] for x in (self.A, self.V, self.posture, self.group))
        part.index = self.index[keep]
        part.chosen = np.searchsorted(keep, self.chosen).tolist()
        return part

    def information(self, chosen: list[int]) -> Array:
        """Information (r, r) of the priors and of chosen candidates."""
        A = self.A[chosen].reshape(-1, self.r)
        return np.asarray(np.diag(self.scale**-2) + A.T @ A)

    def refresh(self) -> None:
        """S and V from the start, free of what rounding has left in them."""
        self.S = np.linalg.inv(self.information(self.chosen))
        self.V = ((self.A.reshape(-1, self.r) @ self.S).reshape(self.A.shape)) @ np.swapaxes(self.A, 1, 2)

    def add(self, k: int) -> None:
        """Choose candidate k."""
        self._change(k, 1.0)
        self.chosen.append(k)

    def _change(self, k: int, sign: float) -> None:
        """Information plus or minus A_k^T A_k."""
        B = self.S @ self.A[k].T  # (r, 3)
        core = np.linalg.inv(np.eye(3) + sign * self.A[k] @ B)
        C = (self.A.reshape(-1, self.r) @ B).reshape(-1, 3, 3)
        self.V -= C @ (sign * core) @ np.swapaxes(C, 1, 2)
        self.S = self.S - sign * B @ core @ B.T

    def determinant_gain(self) -> Array:
        """Factor (m,) by which the determinant of the information grows with each candidate."""
        return _determinant(np.eye(3) + self.V)

    def allowed(self, leaving: int | None = None) -> Array:
        """Mask of candidates that may be added beside the chosen without `leaving`."""
        stay = [k for k in self.chosen if k != leaving]
        used = np.zeros(int(self.posture.max()) + 1, bool)
        used[self.posture[stay]] = True
        mask = ~used[self.posture]
        groups = np.unique(self.group)
        missing = np.array([max(0, self.least - int((self.group[stay] == g).sum())) for g in groups])
        if missing.sum() >= self.count - len(stay):
            mask &= np.isin(self.group, groups[missing > 0])
        return mask

    def exchange(self, place: int) -> bool:
        """Put the best candidate in the place of a chosen one; whether that was another."""
        old = self.chosen[place]
        self._change(old, -1.0)
        score = np.where(self.allowed(old), self._scores(old), -np.inf)
        best = int(np.argmax(score))
        better = score[best] > score[old] + GAIN * abs(score[old])
        new = best if better else old
        self._change(new, 1.0)
        self.chosen[place] = new
        return new != old

    def _scores(self, old: int) -> Array:
        """Criterion (m,) after adding each candidate; -inf where it was not worked out."""
        if self.criterion == "O1":
            return self.determinant_gain()
        if self.criterion == "O5":
            return -self._traces()
        if self.criterion == "zone":
            return self._zone_gain()
        others = [k for k in self.chosen if k != old]
        information = self.information(others) * np.outer(self.scale, self.scale)
        value, vector = np.linalg.eigh(information)
        # First-order growth of the smallest and largest eigenvalue.
        plain = self.A * self.scale
        low, high = (((plain @ vector[:, i]) ** 2).sum(axis=1) for i in (0, -1))
        promise = low / value[0] - (high / value[-1] if self.criterion != "O3" else 0.0)
        promise = np.where(self.allowed(old), promise, -np.inf)
        listed = np.unique([old, *np.argsort(promise)[-SHORTLIST:].tolist()])
        grown = information + np.swapaxes(plain[listed], 1, 2) @ plain[listed]
        singular = np.sqrt(np.maximum(np.linalg.eigvalsh(grown), 1.0))  # the priors alone give 1
        scores = np.full(len(self.A), -np.inf)
        scores[listed] = observability(singular, self.count, self.criterion)
        return scores

    def _traces(self) -> Array:
        """Trace (m,) of the covariance of the unknowns after adding each candidate (O5)."""
        weight = np.diag(1 / self.scale)
        root = self.S * (1 / self.scale)
        fall = self._fall(root)
        return np.asarray(np.trace(weight @ self.S @ weight.T) - np.trace(fall, axis1=1, axis2=2))

    def _zone_gain(self) -> Array:
        """Fall (m,) of log det(1 + J S J^T), J over the readings' own scatter, with each candidate."""
        assert self.J is not None
        cross = self.S @ self.J.T
        C = np.linalg.cholesky(np.eye(len(self.J)) + self.J @ cross)
        root = solve_triangular(C, cross.T, lower=True).T
        fall = self._fall(root)
        return np.asarray(-np.log(_determinant(np.eye(3) - fall)))

    def _fall(self, root: Array) -> Array:
        """(1 + V_i)^-1 A_i root root^T A_i^T (m, 3, 3), root (r, k) cut down to its numerical rank."""
        u, value, _ = np.linalg.svd(root, full_matrices=False)
        keep = value > NEGLIGIBLE * value[0]
        B = (self.A.reshape(-1, self.r) @ (u[:, keep] * value[keep])).reshape(len(self.A), 3, -1)
        return np.asarray(np.linalg.inv(np.eye(3) + self.V) @ (B @ np.swapaxes(B, 1, 2)))


def _determinant(M: Array) -> Array:
    """Of matrices (m, 3, 3), (m,)."""
    return np.asarray(np.einsum("ij,ij->i", M[:, 0], np.cross(M[:, 1], M[:, 2])))
