"""Nuisance and coefficients of active effects, refitted jointly to both signals of a log: Gauss-Newton on the whole model.

Unknowns are standard normal before the log: x = mean + root z for the nuisance, a run's own offset, a = prior_sd z for the
coefficients. docs/diagnosis_force.md, eq. 6 to 8.
"""

from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np

from ocp.calibrate.force.fit import RunOffsets, unmodelled_force
from ocp.calibrate.force.log import ForceLog
from ocp.calibrate.force.noise import Whitener, channel_of
from ocp.diagnose.force.prediction import LogScene, Predicted, effect_derivatives, nuisance_derivatives, predict_forces
from ocp.diagnose.force.prior import NuisancePrior
from ocp.diagnose.rules import JOINTS_REPEAT
from ocp.effects.effect import Active, coefficients, effects_key, prior_sds, with_coefficients
from robots.errors import Infeasible
from robots.gauss_newton import Minimum, Rule, Valley, minimise
from robots.pose import Array

BLOCKS = (300, 150)  # of a log that are kept of its rows, of fn and ft: whitened rows are averaged to about so many
BY_CHANCE = 3  # standard deviations of the scatter of so many averages
CHANGED = 0.1  # relative change of a signal's scatter, of an effect's size, from which it is estimated anew


def refreshed(log: ForceLog, whitener: Whitener, residual: Array) -> Whitener:
    """The noise estimated about a later prediction: anew where the scatter has changed, else kept with new weights."""
    noise, slow = whitener.noise, whitener.short(residual[:, None])
    white = whitener.whole(residual[:, None])[:, 0]
    # Slow noise that held what only now has a name leaves averages smaller than chance does.
    changed = bool(np.mean(slow**2) < np.exp(-2.0 * max(CHANGED, BY_CHANCE / np.sqrt(2.0 * len(slow)))))
    for kind in noise.kinds.values():
        steps = np.diff(white[kind.rows])  # what is slow is not noise
        spread = 1.4826 * np.median(np.abs(steps - np.median(steps))) / np.sqrt(2.0) if len(steps) else 1.0
        changed |= abs(np.log(max(spread, 1e-3))) > CHANGED
    if changed:
        noise = channel_of(log, residual, noise)
    return whitener.with_noise(noise.reweighted(residual))


# At rest within 3 % of the posterior's standard deviations. Where far misfits of something nobody has named yet make the last
# steps slow all the same, they end where three steps together gain a hundredth of what one number more may explain. A search that
# ends otherwise is a fit where less than one of the squares is to be gained, which changes no answer.
VALLEY = Valley(over=3, still=0.01, close=1.0, tries=45, lost=2)
RULE = Rule(steps=25, rest=1e-3, reweighted=6, halvings=10, rise=1e-3, secant=True, valley=VALLEY)


@dataclass(frozen=True)
class ForceProblem:
    """A log and what is believed before it: scene and prior, and what was noticed of it."""

    log: ForceLog
    scene: LogScene
    believed: NuisancePrior
    notices: tuple[str, ...] = ()

    @cached_property
    def repeats(self) -> float:
        """N, one sigma: by which the arm comes back in each recording."""
        model, rows = self.scene.model, self.scene.rows
        return unmodelled_force(model, rows, self.believed.mean, np.full(len(rows), model.law.process_force), JOINTS_REPEAT)

    @cached_property
    def offsets(self) -> RunOffsets:
        """What recordings add."""
        return RunOffsets.of(self.log, self.scene.shear, self.repeats)

    @property
    def sizes(self) -> tuple[int, int]:
        """Unknowns of the nuisance, of the recordings."""
        return self.believed.root.shape[1], self.offsets.count

    def residuals(self, at: Predicted, z: Array) -> tuple[Array, ...]:
        """Measured less predicted (n,) N of each signal; what recordings add counts as predicted."""
        r, o = self.sizes
        own = z[r : r + o]
        normal = self.log.fn - at.fn - self.offsets.normal @ own
        return (normal,) if self.log.ft is None else (normal, self.log.ft - at.read[1] - self.offsets.shear @ own)

    def gap(self, at: Predicted, z: Array) -> Array:
        """Measured less predicted normal reading (n,) N where single runs' own offsets count as gap."""
        runs, (r, o) = self.offsets.runs, self.sizes
        return np.asarray(self.log.fn - at.fn - self.offsets.normal[:, runs:] @ z[r + runs : r + o])


@dataclass(frozen=True)
class Linear:
    """About a prediction: whitened residual (N,) and sensitivities (N, k) to z row by row, both signals one below the other; the
    sensitivities (n, k) N of fn itself; the force's slopes in theta and the joints."""

    residual: Array = field(repr=False)
    sensitivity: Array = field(repr=False)
    normal: Array = field(repr=False)
    slopes: tuple[Array, Array] = field(repr=False)


@dataclass(frozen=True)
class EffectFit(Linear):
    """A fit: z standard normal unknowns (nuisance, runs, coefficients in units of prior_sd), the prediction there with what is
    linear about it, one whitener a signal, whether it is at rest."""

    z: Array
    at: Predicted
    whiteners: tuple[Whitener, ...]
    rested: bool

    @cached_property
    def information(self) -> Array:
        """On z (k, k), in the noise's own law (Student's t), the prior's in."""
        parts = zip(self.whiteners, np.split(self.sensitivity, len(self.whiteners)), strict=True)
        return np.eye(len(self.z)) + np.asarray(sum(whitener.noise.information(part) for whitener, part in parts))

    @cached_property
    def square(self) -> Array:
        """Products (k, k) of the whitened sensitivities."""
        return self.sensitivity.T @ self.sensitivity

    @property
    def weight(self) -> Array:
        """Of each normal reading (n,), outliers low."""
        return self.whiteners[0].noise.weight

    @property
    def active(self) -> tuple[Active, ...]:
        """Active effects with values and covariance."""
        return self.at.active


def linear(problem: ForceProblem, z: Array, at: Predicted, whiteners: tuple[Whitener, ...]) -> Linear:
    """Linearise."""
    slopes = problem.scene.slopes(at)
    columns = _columns(problem, problem.scene, at, slopes, problem.offsets)
    rest = problem.residuals(at, z)
    both = np.concatenate([w.whole(np.column_stack([r, c])) for w, r, c in zip(whiteners, rest, columns, strict=False)])
    if not np.isfinite(both).all():
        raise Infeasible(f"{problem.log.path}: the fit of the force log leaves what can be computed; the cell is not the log's")
    return Linear(both[:, 0], both[:, 1:], columns[0], slopes)


def linear_normal(problem: ForceProblem, scene: LogScene, at: Predicted) -> Array:
    """Sensitivities (n, k) N of fn in other rows to the unknowns, those of the runs left out."""
    return _columns(problem, scene, at, scene.slopes(at), problem.offsets.none(len(at.F)))[0]


def _columns(problem: ForceProblem, scene: LogScene, at: Predicted, slopes: tuple[Array, Array], own: RunOffsets) -> Array:
    """Derivatives (2, n, k) N of fn and ft in z."""
    parts = [nuisance_derivatives(scene, at, slopes[0]) @ problem.believed.root, np.stack([own.normal, own.shear])]
    for one in at.active:
        made = effect_derivatives(scene, at, slopes, one.effect, one.joint, [one.scanned])
        if made is None:  # a value so far off that nothing touches, or everything
            raise Infeasible(f"{problem.log.path}: with {one.effect.name} the fit of the force log leaves what can be computed")
        parts.append(made[:, 0] * np.asarray(one.effect.prior_sd))
    return np.concatenate(parts, axis=2)


def fit_effects(problem: ForceProblem, active: tuple[Active, ...] = (), start: EffectFit | None = None) -> EffectFit:
    """The most probable nuisance and coefficients; the search starts from a fit nearby, else from the effects' own values.

    The noise comes from the scatter about the first prediction, then about the fit's. Raises Infeasible: no rest
    with effects. Without any the fit ends at the best it found: a log that no believed contact explains is to be told as such.
    """
    r, o = problem.sizes
    scale = prior_sds(active)
    z = np.concatenate([np.zeros(r + o) if start is None else start.z[: r + o], units_of(_known(active, start))])
    at = _at(problem, z, active, None if start is None else start.at)
    if start is None:
        each = zip(signals(problem.log), problem.residuals(at, z), BLOCKS, strict=False)
        whiteners = tuple(Whitener.of(channel_of(log, rest), blocks) for log, rest, blocks in each)
    else:
        whiteners = start.whiteners
    found = _settled(_Point(problem, z, at, whiteners))
    while effects_key(sized := as_sized(found.at.at.active)) != effects_key(found.at.at.active):
        other = minimise(replace(found.at, at=_at(problem, found.at.z, sized, found.at.at)), np.ones(len(z)), RULE)
        if not other.rested or replace(other.at, whiteners=found.at.whiteners).squares() >= found.at.squares():
            break
        found = other
    point = found.at
    rest = problem.residuals(point.at, point.z)
    anew = tuple(refreshed(log, w, e) for log, w, e in zip(signals(problem.log), point.whiteners, rest, strict=True))
    if any(w is not old for w, old in zip(anew, point.whiteners, strict=True)):
        found = _settled(replace(point, whiteners=anew))
        point = found.at
    z, at, white = point.z, point.at, point.whiteners
    fit = EffectFit(**vars(linear(problem, z, at, white)), z=z, at=at, whiteners=white, rested=found.rested)
    covariance = np.linalg.inv(fit.information)[r + o :, r + o :] * np.outer(scale, scale)
    return replace(fit, at=replace(at, active=with_coefficients(at.active, coefficients(at.active), covariance)))


def _known(active: tuple[Active, ...], near: EffectFit | None) -> tuple[Active, ...]:
    """Effects as a fit nearby has them, zero those that it does not hold: its nuisance follows them, and is no longer the nearest
    once they have their size."""
    held = {} if near is None else {a.key: a.a for a in near.active}
    return active if near is None else tuple(replace(a, a=held.get(a.key, np.zeros_like(a.a))) for a in active)


def as_sized(active: tuple[Active, ...]) -> tuple[Active, ...]:
    """Effects at the size that was found, where they acted as of another."""
    found = []
    for one in active:
        own = {} if one.effect.own_size is None else one.effect.own_size(one.a)
        if any(abs(np.log(own[key] / one.scanned[key])) > CHANGED for key in own):
            one = replace(one, scanned={**one.scanned, **own})
        found.append(one)
    return tuple(found)


def units_of(active: tuple[Active, ...]) -> Array:
    """Coefficients (m,) of effects in units of their priors."""
    scale = prior_sds(active)
    return coefficients(active) / np.where(scale > 0, scale, 1.0)


def signals(log: ForceLog) -> tuple[ForceLog, ...]:
    """The log once a signal, the signal in the place of fn."""
    return (log,) if log.ft is None else (log, replace(log, fn=log.ft, sigma_fn=log.sigma_ft))


def _at(problem: ForceProblem, z: Array, active: tuple[Active, ...], near: Predicted | None) -> Predicted:
    r, o = problem.sizes
    x = problem.believed.mean + problem.believed.root @ z[:r]
    return predict_forces(problem.scene, x, with_coefficients(active, prior_sds(active) * z[r + o :]), near)


@dataclass(frozen=True)
class _Point:
    """A point of the search (`robots.gauss_newton.Iterate`): unknowns z, prediction there, one whitener a signal."""

    problem: ForceProblem
    z: Array
    at: Predicted
    whiteners: tuple[Whitener, ...]

    def reweighted(self) -> "_Point":
        """With the weights of Student's t that follow from the residuals."""
        rest = self.problem.residuals(self.at, self.z)
        return replace(self, whiteners=tuple(w.reweighted(r) for w, r in zip(self.whiteners, rest, strict=True)))

    def residual(self) -> Array:
        """Whitened (N,)."""
        rest = self.problem.residuals(self.at, self.z)
        return np.concatenate([w.whole(r[:, None])[:, 0] for w, r in zip(self.whiteners, rest, strict=True)])

    def squares(self) -> float:
        """What the search lowers."""
        left = self.residual()
        return float(left @ left + self.z @ self.z)

    def linearised(self) -> tuple[Array, Array]:
        """Whitened residuals (N,) and sensitivities (N, k) to z."""
        line = linear(self.problem, self.z, self.at, self.whiteners)
        return line.residual, line.sensitivity

    def moved(self, change: Array) -> "_Point":
        """The point at z + change."""
        z = self.z + change
        return replace(self, z=z, at=_at(self.problem, z, self.at.active, self.at))


def _settled(start: _Point) -> Minimum[_Point]:
    """The most probable point at this noise."""
    found = minimise(start, np.ones(len(start.z)), RULE)
    if not found.rested and start.at.active:
        path, n = start.problem.log.path, found.steps
        raise Infeasible(f"{path}: the fit of the force log does not come to rest in {n} steps; the cell is not the log's")
    return found
