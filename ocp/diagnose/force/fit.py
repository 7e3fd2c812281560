"""Nuisance and coefficients of active effects, refitted jointly to both signals of a log: Gauss-Newton on the whole model.

Unknowns are standard normal before the log: x = mean + root z for the nuisance, a run's own offset, a = prior_sd z for the
coefficients. docs/diagnosis_force.md, eq. 6 to 8.
"""

from dataclasses import dataclass, field, replace

import numpy as np

from ocp.calibrate.force.log import ForceLog
from ocp.calibrate.force.offsets import RunOffsets
from ocp.diagnose.force.prediction import (
    LogScene,
    Predicted,
    effect_derivatives,
    force_derivatives,
    nuisance_derivatives,
    predict_forces,
)
from ocp.diagnose.force.prior import NuisancePrior
from ocp.diagnose.force.whitening import Whitener, as_shear, refreshed, whiteners_of
from ocp.diagnose.rules import RUN_SD
from ocp.effects.effect import Active
from robots.errors import Infeasible
from robots.pose import Array

STEPS = 25
TRIES = 45  # predictions of all steps with their halvings; a fit that comes to rest takes less than half
REWEIGHTED = 6  # steps with new weights; then they stand
AT_REST = 1e-3  # squared length of a step in posterior standard deviations
CLOSE = 1.0  # of the squares, gained in the last steps of all: what less is to gain changes no answer
STILL = 0.01  # squares that `LAST` steps together must lower, else it rests: a hundredth of what one number more may explain
LAST = 3
SHORTEST = 1e-3  # share of a step
LOST = 2  # steps one after the other whose shortest part raises the squares by more than `CLOSE`: there is no way down


@dataclass(frozen=True)
class ForceProblem:
    """A log and what is believed before it: scene, readings fn and ft (n,) N (ft None where absent), prior, and what its
    recordings add."""

    log: ForceLog
    scene: LogScene
    believed: NuisancePrior
    offsets: RunOffsets
    notices: tuple[str, ...] = ()

    @staticmethod
    def of(log: ForceLog, scene: LogScene, believed: NuisancePrior, notices: tuple[str, ...] = ()) -> "ForceProblem":
        """The problem of a log."""
        return ForceProblem(log, scene, believed, RunOffsets.of(log, scene.shear, RUN_SD), notices)

    @property
    def sizes(self) -> tuple[int, int]:
        """Unknowns of the nuisance, of the recordings."""
        return self.believed.root.shape[1], self.offsets.count

    def residuals(self, at: Predicted, z: Array) -> tuple[Array, Array | None]:
        """Measured less predicted (n,) N of both signals; what recordings add counts as predicted."""
        r, o = self.sizes
        own = z[r : r + o]
        shear = None if self.log.ft is None else self.log.ft - at.ft - self.offsets.shear @ own
        return self.log.fn - at.fn - self.offsets.normal @ own, shear

    def gap(self, at: Predicted, z: Array) -> Array:
        """Measured less predicted normal reading (n,) N where single runs' own offsets count as gap."""
        r, o = self.sizes
        shared = slice(self.offsets.runs, o)
        return np.asarray(self.log.fn - at.fn - self.offsets.normal[:, shared] @ z[r : r + o][shared])


@dataclass(frozen=True)
class EffectFit:
    """A fit: z standard normal unknowns (nuisance, runs, coefficients in units of prior_sd), the prediction there, one whitener a
    signal, whitened residual (N,) and sensitivities (N, k) to z (row by row), normal (n, k) N: sensitivities of fn itself,
    information (k, k) with the prior's in, slopes of the force in theta and the joints, steps taken."""

    z: Array
    at: Predicted
    whiteners: tuple[Whitener, ...]
    residual: Array = field(repr=False)
    sensitivity: Array = field(repr=False)
    normal: Array = field(repr=False)
    information: Array = field(repr=False)
    slopes: tuple[Array, Array] = field(repr=False)
    steps: int

    @property
    def active(self) -> tuple[Active, ...]:
        """Active effects with values and covariance."""
        return self.at.active


def scale_of(active: tuple[Active, ...]) -> Array:
    """Prior sd of all coefficients in order."""
    return np.concatenate([np.asarray(a.effect.prior_sd, float) for a in active] or [np.zeros(0)])


def with_values(active: tuple[Active, ...], a: Array) -> tuple[Active, ...]:
    """The effects with coefficients a, one after the other."""
    edges = np.cumsum([a_.effect.size for a_ in active])[:-1]
    return tuple(replace(one, a=part) for one, part in zip(active, np.split(a, edges) if active else [], strict=True))


@dataclass(frozen=True)
class Linear:
    """About a prediction: whitened residual (N,) and sensitivities (N, k) to z row by row, both signals one below the other; the
    sensitivities (n, k) N of fn itself; the force's slopes in theta and the joints."""

    residual: Array
    sensitivity: Array
    normal: Array
    slopes: tuple[Array, Array]


def linear(problem: ForceProblem, z: Array, at: Predicted, whiteners: tuple[Whitener, ...]) -> Linear:
    """Linearise."""
    slopes = force_derivatives(problem.scene, at)
    columns = _columns(problem, problem.scene, at, slopes, problem.offsets)
    e = problem.residuals(at, z)
    parts = [w.whole(np.column_stack([r, c])) for w, r, c in zip(whiteners, e, columns, strict=False) if r is not None]
    both = np.concatenate(parts)
    if not np.isfinite(both).all():
        raise Infeasible(f"{problem.log.path}: the fit of the force log leaves what can be computed; the cell is not the log's")
    return Linear(both[:, 0], both[:, 1:], columns[0], slopes)


def linear_normal(problem: ForceProblem, scene: LogScene, at: Predicted) -> Array:
    """Sensitivities (n, k) N of fn in other rows to the unknowns, those of the runs left out."""
    return _columns(problem, scene, at, force_derivatives(scene, at), problem.offsets.none(len(at.F)))[0]


def _columns(
    problem: ForceProblem, scene: LogScene, at: Predicted, slopes: tuple[Array, Array], own: RunOffsets
) -> tuple[Array, Array]:
    """Derivatives (n, k) N of fn and ft in z."""
    fn, ft = nuisance_derivatives(scene, at, slopes[0])
    root = problem.believed.root
    normal, shear = [fn @ root, own.normal], [ft @ root, own.shear]
    for one in at.active:
        made = effect_derivatives(scene, at, slopes, one.effect, one.joint, [one.scanned])
        if made is None:  # a value so far off that nothing touches, or everything
            raise Infeasible(f"{problem.log.path}: with {one.effect.name} the fit of the force log leaves what can be computed")
        normal.append(made[0][0] * np.asarray(one.effect.prior_sd))
        shear.append(made[1][0] * np.asarray(one.effect.prior_sd))
    return np.hstack(normal), np.hstack(shear)


def fit_effects(problem: ForceProblem, active: tuple[Active, ...] = (), start: EffectFit | None = None) -> EffectFit:
    """The most probable nuisance and coefficients; effects' own values are where the search starts, `start` is a fit nearby.

    The noise comes from the scatter about the first prediction, then about the fit's. Raises Infeasible: no rest.
    """
    r, o = problem.sizes
    scale = scale_of(active)
    given = np.concatenate([one.a for one in active] or [np.zeros(0)]) / np.where(scale > 0, scale, 1.0)
    z = np.concatenate([np.zeros(r + o) if start is None else start.z[: r + o], given])
    at = _at(problem, z, active, None if start is None else start.at)
    if start is None:
        # The stroke's sign, and with it friction, comes from a first prediction.
        at = _at(problem, z, active, at)
        whiteners = whiteners_of(problem.log, *problem.residuals(at, z))
    else:
        whiteners = start.whiteners
    z, at, whiteners, first = _settle(problem, z, at, whiteners)
    rest = problem.residuals(at, z)
    anew = tuple(refreshed(log, w, e) for log, w, e in zip(signals(problem.log), whiteners, rest, strict=False) if e is not None)
    second = 0
    if any(w is not old for w, old in zip(anew, whiteners, strict=True)):
        z, at, whiteners, second = _settle(problem, z, at, anew)
    line = linear(problem, z, at, whiteners)
    information = np.eye(len(z)) + reading_information(whiteners, line.sensitivity)
    covariance = np.linalg.inv(information)[r + o :, r + o :] * np.outer(scale, scale)
    edges = np.cumsum([0, *(one.effect.size for one in active)])
    fitted = tuple(
        replace(one, covariance=covariance[i:j, i:j]) for one, i, j in zip(at.active, edges[:-1], edges[1:], strict=True)
    )
    return EffectFit(
        z, replace(at, active=fitted), whiteners, line.residual, line.sensitivity, line.normal, information, line.slopes,
        first + second,
    )  # fmt: skip


def signals(log: ForceLog) -> tuple[ForceLog, ...]:
    """The log once a signal, the signal in the place of fn."""
    return (log,) if log.ft is None else (log, as_shear(log))


def reading_information(whiteners: tuple[Whitener, ...], sensitivity: Array) -> Array:
    """What whitened sensitivities (N, k) tell about z, (k, k), in the noise's own law (Student's t)."""
    n = len(sensitivity) // len(whiteners)
    total = np.zeros((sensitivity.shape[1], sensitivity.shape[1]))
    for i, whitener in enumerate(whiteners):
        total += whitener.noise.information(sensitivity[i * n : (i + 1) * n])
    return total


def _at(problem: ForceProblem, z: Array, active: tuple[Active, ...], near: Predicted | None) -> Predicted:
    r, o = problem.sizes
    x = problem.believed.mean + problem.believed.root @ z[:r]
    return predict_forces(problem.scene, x, with_values(active, scale_of(active) * z[r + o :]), near)


def _settle(
    problem: ForceProblem, z: Array, at: Predicted, whiteners: tuple[Whitener, ...]
) -> tuple[Array, Predicted, tuple[Whitener, ...], int]:
    """Gauss-Newton at this noise; weights of Student's t follow in the first steps.

    Columns leave out how an effect's interference turns with the arm. Where a step lowers nothing, what they missed along it is
    added to them (Broyden's update), so that the next one knows. Far misfits of something nobody has named yet make the last
    steps slow (the squares' own curvature is left out); they end where nothing is gained any more.
    """
    missed, squares, tries, lost = np.zeros((0, len(z))), list[float](), 0, 0
    for step in range(STEPS):
        if step < REWEIGHTED:
            e = problem.residuals(at, z)
            whiteners = tuple(w.reweighted(r) for w, r in zip(whiteners, e, strict=False) if r is not None)
        line = linear(problem, z, at, whiteners)
        A, e_white = line.sensitivity + missed if len(missed) else line.sensitivity, line.residual
        H = np.eye(len(z)) + A.T @ A
        change = np.asarray(np.linalg.solve(H, A.T @ e_white - z), float)
        squares.append(float(e_white @ e_white + z @ z))
        moved, at, left, share = _moved(problem, z, at, whiteners, change, squares[-1])
        tries += 1 - round(np.log2(share))
        took = moved - z
        if share < 1.0 and took @ took > 0:
            update = np.outer(e_white - left - A @ took, took / (took @ took))
            missed = missed + update if len(missed) else update
        z = moved
        still = step >= REWEIGHTED + LAST and squares[-1 - LAST] - squares[-1] < STILL
        if change @ H @ change < AT_REST or still:
            return z, at, whiteners, step + 1
        lost = lost + 1 if share < SHORTEST and left @ left + moved @ moved > squares[-1] + CLOSE else 0
        if tries > TRIES or lost == LOST:
            break
    if len(squares) > REWEIGHTED + LAST and squares[-1 - LAST] - squares[-1] < CLOSE:
        return z, at, whiteners, len(squares)  # to and fro along a valley whose floor is reached
    raise Infeasible(
        f"{problem.log.path}: the fit of the force log does not come to rest in {step + 1} steps; the cell is not the log's"
    )


def _moved(
    problem: ForceProblem, z: Array, at: Predicted, whiteners: tuple[Whitener, ...], change: Array, now: float
) -> tuple[Array, Predicted, Array, float]:
    """The step, halved until the weighted squares do not rise: unknowns, prediction and whitened residual (N,) there, share
    taken."""
    share = 1.0
    while True:
        trial = z + share * change
        there = _at(problem, trial, at.active, at)
        e = problem.residuals(there, trial)
        left = np.concatenate([w.whole(r[:, None])[:, 0] for w, r in zip(whiteners, e, strict=False) if r is not None])
        if float(left @ left + trial @ trial) <= now * (1.0 + 1e-9) + 1e-3 or share < SHORTEST:
            return trial, there, left, share
        share *= 0.5
