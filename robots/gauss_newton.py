"""Gauss-Newton to the most probable unknowns: residuals with their derivatives, a Gaussian prior, weights that follow the fit.

The unknowns z (k,) are zero at the prior's mean. What is lowered, at given noise and weights, is

    |e(z)|^2 + sum_i precision_i z_i^2                                                                                  (1)

with e the residuals (measured less predicted), whitened and weighted. A step d solves the same with the prediction linear in z,
(A^T A + diag(precision)) d = A^T e - precision z, A the sensitivities of the whitened prediction (Gill, Murray and Wright 1981,
section 4.7.2). Weights of a law with heavy tails are estimated anew before a step and stand during it: iteratively reweighted
least squares, where each step that lowers (1) also lowers the law's own misfit (Lange, Little and Taylor 1989). What (1) curves
beyond A^T A, where residuals stay large, may be learnt from the steps (`Rule.secant`).
"""

from dataclasses import dataclass
from typing import Generic, Protocol, Self, TypeVar

import numpy as np

from robots.pose import Array

RELATIVE_RISE = 1e-9  # of the cost: rounding
LEAST_SHARE = 0.2  # of a step that is relaxed
FURTHER = 2.0  # times a step of the linear problem that one with curvature may go


class Iterate(Protocol):
    """A point of the search: the unknowns, the model there, and the noise and weights that its residuals are seen with."""

    @property
    def z(self) -> Array:
        """Unknowns (k,), zero at the prior's mean."""

    def reweighted(self) -> Self:
        """The same point with the noise and weights that follow from its own residuals."""

    def residual(self) -> Array:
        """Measured less predicted, whitened and weighted (N,)."""

    def linearised(self) -> tuple[Array, Array]:
        """Residual (N,) and the prediction's sensitivities (N, k) to z, both whitened and weighted."""

    def moved(self, change: Array) -> Self:
        """The point at z + change (k,), with the same noise and weights."""


P = TypeVar("P", bound=Iterate)


@dataclass(frozen=True)
class Valley:
    """When a search that creeps along a flat valley has arrived, and when it has lost its way.

    still: where the last `over` steps together lower the cost by less, it is at rest; close: the same where the search ends for
    another reason. It ends after `tries` predictions, those of halved steps included, or after `lost` steps one after the other
    whose shortest part still raises the cost by more than `close`.
    """

    over: int
    still: float
    close: float
    tries: int
    lost: int


NO_VALLEY = Valley(1, -np.inf, -np.inf, 10**9, 10**9)  # such a search ends by its steps alone


@dataclass(frozen=True)
class Rule:
    """How a search steps and when it ends.

    steps: at most so many. rest: it is at rest after a step whose squared length, in posterior standard deviations, is less.
    reweighted: so many steps begin with new weights, then they stand (None: all do). halvings: a step is halved at most so often
    until it raises the cost by no more than `rise`; 0: steps are taken whole. rank: None: normal equations; else the singular
    values of the sensitivities, directions below this share of the largest stay where they are. relaxed: shorter steps where they
    overshoot in turn to either side. secant: what the prediction's curvature adds to the normal equations where residuals are
    large is learnt from how gradients change along steps (not beside `rank`).
    """

    steps: int
    rest: float = 0.0
    reweighted: int | None = None
    halvings: int = 0
    rise: float = 1e-6
    rank: float | None = None
    relaxed: bool = False
    secant: bool = False
    valley: Valley = NO_VALLEY


@dataclass(frozen=True)
class LinearStep:
    """Step (k,) to the minimum of the linear problem, or as far as known curvature lets it go, normal (k, k): half the second
    derivatives of the linear problem, and where singular values were used a root (k, r) of the covariance."""

    change: Array
    normal: Array
    root: Array | None = None

    @property
    def covariance(self) -> Array:
        """Of z (k, k)."""
        return np.asarray(np.linalg.inv(self.normal) if self.root is None else self.root @ self.root.T)


@dataclass(frozen=True)
class Minimum(Generic[P]):
    """Where a search ended: the point, the linear step that led to it, steps taken, and whether it came to rest."""

    at: P
    last: LinearStep
    steps: int
    rested: bool


def linear_step(residual: Array, sensitivity: Array, z: Array, precision: Array, rank: float | None = None) -> LinearStep:
    """Step from z to the minimum of eq. 1 for residual (N,) and sensitivities (N, k); rank as in `Rule`.

    Raises LinAlgError: by normal equations, where neither residuals nor prior hold some direction.
    """
    if rank is None:
        normal = sensitivity.T @ sensitivity + np.diag(precision)
        if not (precision > 0).all():
            np.linalg.cholesky(normal)  # refuses what is open in some direction, which `solve` need not notice
        return LinearStep(np.asarray(np.linalg.solve(normal, sensitivity.T @ residual - precision * z)), normal)
    root, known = np.sqrt(precision), precision > 0
    A = np.vstack([sensitivity, np.diag(root)[known]])
    U, s, Vt = np.linalg.svd(A, full_matrices=False)
    safe = s > rank * s[0]
    V = Vt[safe].T / s[safe]
    return LinearStep(V @ (U[:, safe].T @ np.concatenate([residual, -(root * z)[known]])), A.T @ A, V)


def minimise(start: P, precision: Array, rule: Rule) -> Minimum[P]:
    """The minimum of eq. 1 nearest to `start`; precision (k,) of the prior, 0 where an unknown is free."""
    at, share, tries, lost = start, 1.0, 0, 0
    costs, previous = list[float](), np.zeros(len(precision))
    curvature, taken = np.zeros((len(precision),) * 2), None
    reweighted = rule.steps if rule.reweighted is None else rule.reweighted
    valley = rule.valley

    def gained_less(least: float) -> bool:
        return len(costs) > reweighted + valley.over and costs[-1 - valley.over] - costs[-1] < least

    for _ in range(rule.steps):
        if len(costs) < reweighted:
            at = at.reweighted()
        residual, sensitivity = at.linearised()
        if taken is not None:
            curvature = _learnt(curvature, *taken, at.z, residual, sensitivity, precision)
        step = _curved(linear_step(residual, sensitivity, at.z, precision, rule.rank), curvature)
        costs.append(_cost(residual, at.z, precision))
        if rule.relaxed:
            share = _relaxed(share, previous, step)
            previous = step.change
        there, left, halvings = _shortened(at, share * step.change, precision, costs[-1], rule)
        taken = (at.z, residual, sensitivity) if rule.secant else None
        if taken is not None and len(costs) < reweighted:  # what comes next has other weights
            if halvings or curvature.any():
                curvature = _learnt(curvature, *taken, there.z, *there.linearised(), precision)
            taken = None
        at = there
        if step.change @ step.normal @ step.change < rule.rest or gained_less(valley.still):
            return Minimum(at, step, len(costs), True)
        tries += 1 + halvings
        astray = halvings == rule.halvings and _cost(left, at.z, precision) > costs[-1] + valley.close
        lost = lost + 1 if astray else 0
        if tries > valley.tries or lost == valley.lost:
            break
    return Minimum(at, step, len(costs), gained_less(valley.close))


def _curved(step: LinearStep, curvature: Array) -> LinearStep:
    """The step with what is known of the prediction's curvature (k, k) in the normal equations, in no direction more than
    `FURTHER` times as long."""
    if not curvature.any() or step.root is not None:
        return step
    root = np.linalg.cholesky(step.normal)
    half = np.linalg.solve(root, curvature)
    size, turn = np.linalg.eigh(np.eye(len(root)) + np.linalg.solve(root, half.T))
    inner = turn @ ((turn.T @ (root.T @ step.change)) / np.maximum(size, 1.0 / FURTHER))
    return LinearStep(np.linalg.solve(root.T, inner), step.normal)


def _learnt(known: Array, before: Array, e0: Array, A0: Array, after: Array, e1: Array, A1: Array, precision: Array) -> Array:
    """Of half the second derivatives of eq. 1 (k, k) what products of sensitivities lack, after a step from z `before` to `after`
    with residuals e and sensitivities A at the same weights: structured secant update, sized (Dennis, Gay and Welsch 1981, An
    adaptive nonlinear least-squares algorithm)."""
    took = after - before
    missed = (A0 - A1).T @ e1
    turned = precision * took - A1.T @ e1 + A0.T @ e0
    along, had = float(took @ turned), float(took @ known @ took)
    if along <= 0.0:
        return known
    known = known * (min(1.0, abs(float(took @ missed) / had)) if had else 1.0)
    more = missed - known @ took
    both = np.outer(more, turned)
    return np.asarray(known + (both + both.T) / along - (more @ took) * np.outer(turned, turned) / along**2)


def _cost(residual: Array, z: Array, precision: Array) -> float:
    return float(residual @ residual + z @ (precision * z))


def _shortened(at: P, change: Array, precision: Array, now: float, rule: Rule) -> tuple[P, Array, int]:
    """The point after a step halved until the cost does not rise, the residual there (empty where steps are taken whole), and how
    often it was halved."""
    if not rule.halvings:
        return at.moved(change), np.zeros(0), 0
    for halvings in range(rule.halvings + 1):
        there = at.moved(0.5**halvings * change)
        left = there.residual()
        if _cost(left, there.z, precision) <= now * (1.0 + RELATIVE_RISE) + rule.rise:
            break
    return there, left, halvings


def _relaxed(share: float, previous: Array, step: LinearStep) -> float:
    """Share of the next step. Where residuals are large, Gauss-Newton steps overshoot in turn to either side: how much of the
    step before comes back says which share would have met the middle."""
    length = float(previous @ step.normal @ previous)
    back = float(previous @ step.normal @ step.change) / length if length > 0 else 0.0
    return float(np.clip(share / max(1.0 - back, 1e-3), LEAST_SHARE, 1.0))
