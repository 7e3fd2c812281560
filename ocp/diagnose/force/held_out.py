"""How much effects help on force readings that were left out, and force readings nobody has seen.

Left out: linear refits about the fits of all rows. With the left-out rows' part of the normal equations taken off, the
unknowns move by what a refit without them gives to first order (`ocp.calibrate.force.assessment.without_rows`); a fit with
effects and one without have unknowns of their own. Nobody has seen: the believed contact refitted, and corrected by the named
effects, with one sigma.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from scipy.linalg import block_diag

from ocp.calibrate.force.assessment import without_rows
from ocp.calibrate.force.log import ForceLog
from ocp.calibrate.force.model import ForceRows
from ocp.calibrate.force.noise import ReadingNoise
from ocp.calibrate.force.rows import log_conditions, prepare_force
from ocp.diagnose.engine.channel_system import Fold, HeldOut, Predictable, Sealed, is_outlier, predictable
from ocp.diagnose.force.fit import EffectFit, ForceProblem, fit_effects, linear_normal, units_of
from ocp.diagnose.force.prediction import LogScene, Predicted, predict_forces
from ocp.diagnose.rules import FOLD_PARTS, FOLD_PIECE, FOLD_REST, FOLD_ROWS
from ocp.effects.effect import Active, Effect, coefficients, prior_sds, with_coefficients
from robots.errors import Infeasible
from robots.pose import Array, Index, Mask

Fitted = tuple[ForceProblem, EffectFit]


def force_folds(log: ForceLog, scene: LogScene) -> list[Fold]:
    """Pieces of runs (random) and stretches of the passes (block); then runs, lines, setpoints, feeds, belts, directions of
    travel, sessions, times, each left out as a whole."""
    c = scene.conditions
    rng = np.random.default_rng(0)
    piece = np.zeros(len(log), np.int64)
    for r in np.unique(log.run):
        at = np.flatnonzero(log.run == r)
        piece[at] = 1000 * int(r) + np.arange(len(at)) // FOLD_PIECE
    kinds, index = np.unique(piece, return_inverse=True)
    part = rng.permutation(np.arange(len(kinds)) % FOLD_PARTS)[index]
    found = [Fold(f"random={k + 1}", "random", part == k) for k in range(FOLD_PARTS)]
    edges = np.quantile(c.s[log.contact], np.linspace(0, 1, FOLD_PARTS + 1))
    stretch = np.searchsorted(edges[1:-1], c.s)
    found += [Fold(f"stretch={k + 1}", "block", (stretch == k) & log.contact) for k in range(FOLD_PARTS)]
    ways: dict[str, Any] = {name: getattr(log, name) for name in ("run", "line", "feed", "belt")} | {"travel": c.travel}
    if log.setpoint_sd is None:
        ways["setpoint"] = log.setpoint
    if len(log.sessions) > 1:
        ways["session"] = log.session
    for kind, values in ways.items():
        if values is not None:
            found += _left_out(kind, np.round(values, 6), log)
    clock = c.clock if "clock_s" in c.given else None
    if clock is not None and np.ptp(clock) > 0:
        cut = float(np.quantile(clock[log.contact], 2 / 3))
        found.append(Fold(f"time after {cut:.0f} s", "time", clock > cut))
    if log.wheel_temperature is not None and np.ptp(log.wheel_temperature) > 1.0:
        cut = float(np.quantile(log.wheel_temperature, 2 / 3))
        found.append(Fold(f"wheel above {cut:.1f} C", "temperature", log.wheel_temperature > cut))
    rest = max(FOLD_ROWS, FOLD_REST * log.contact.sum())
    return [f for f in found if (f.held & log.contact).sum() >= FOLD_ROWS and (~f.held & log.contact).sum() >= rest]


def _left_out(kind: str, values: Array, log: ForceLog) -> list[Fold]:
    """One fold for each value."""
    levels = np.unique(values[log.contact])
    scale = {"feed": 1e3}.get(kind, 1.0)
    names = {v: log.runs[int(v)] if kind == "run" else f"{scale * v:g}" for v in levels}
    held = [(v, (values == v) & (log.contact | (kind == "run"))) for v in levels]
    return [Fold(f"{kind}={names[v]}", kind, rows) for v, rows in held] if len(levels) > 1 else []


def force_fold_errors(before: Fitted, after: Fitted, fold: Fold, own: ReadingNoise) -> HeldOut | None:
    """Squared errors N^2 of the fold's normal readings in contact, everything refitted on the rest, without and with effects;
    own: noise that says which readings are held against a model, and how well they are known, the same whatever the effects, so
    that errors can be compared.

    What the believed contact itself cannot know there without them counts as noise. Where that is more than a reading's own
    noise nothing is judged: another side of the blade stands where its registration has it, whatever the effect.
    """
    log, held, good = after[0].log, np.asarray(fold.held, bool), ~is_outlier(own.weight)
    if log.setpoint_sd is not None:  # a setpoint that the readings gave is not known without them
        good &= log.setpoint_sd == 0
    rows = held & log.contact & good
    if rows.sum() < FOLD_ROWS or (~held & log.contact).sum() < FOLD_ROWS:
        return None
    changes, covariances = zip(*(_moved_without(fit, held) for _, fit in (before, after)), strict=True)
    off, left = (_errors(*fitted, change)[rows] for fitted, change in zip((before, after), changes, strict=True))
    (r, o), nuisance, covariance = after[0].sizes, before[1].normal[rows, : before[0].sizes[0]], covariances[1]
    known = covariances[0][: nuisance.shape[1], : nuisance.shape[1]]
    noise, unknown = own.sigma()[rows] ** 2, np.sum(nuisance @ known * nuisance, axis=1)
    # Both errors hold the same unknown u: their squares differ by 2 u (off - left) for it, whatever the effects.
    shared = 2.0 * nuisance.T @ (off - left) / len(off)
    if fold.extrapolates and unknown.mean() > noise.mean():
        return None
    noise = noise + unknown
    # What errors of estimation without the held rows bring into these, beyond what they bring without effects: an effect that
    # the nuisance imitates has a value that is hardly known, and a prediction that is.
    columns = after[1].normal[rows].copy()
    columns[:, r : r + o] = 0.0
    estimation = np.maximum(np.sum(columns @ covariance * columns, axis=1) - unknown, 0.0)
    squares = np.stack([off**2, left**2, noise])
    return HeldOut(fold, squares, float(estimation.mean()), float(np.sqrt(shared @ known @ shared)))


def _moved_without(fit: EffectFit, held: Mask) -> tuple[Array, Array]:
    """By how much the unknowns (k,) move without the held rows, and their covariance (k, k) then."""
    out = np.tile(held, len(fit.whiteners))
    left = fit.sensitivity[out]
    return without_rows(np.eye(len(fit.z)) + fit.square - left.T @ left, left, fit.residual[out])


def _errors(problem: ForceProblem, fit: EffectFit, change: Array) -> Array:
    """Measured less predicted normal reading (n,) N with the unknowns moved by `change`."""
    r = problem.sizes[0]
    columns = fit.normal.copy()
    columns[:, r : r + problem.offsets.runs] = 0.0  # a run's own offset does not carry over
    return np.asarray(problem.gap(fit.at, fit.z) - columns @ change)


@dataclass(frozen=True)
class Asked:
    """Conditions that are asked for, and the log before them, with one law of the wheel for both: rows of the log, the scene
    there. What the fit without effects says is kept: every alternative is compared with it."""

    sealed: ForceLog
    measured: ForceRows
    there: LogScene
    kept: dict[str, Any] = field(default_factory=dict, repr=False)

    @staticmethod
    def of(log: ForceLog, scene: LogScene, sealed: ForceLog) -> "Asked":
        """The scene of conditions; what the cell states and they say nothing of is left out. Raises BadInput: points off the
        blade."""
        setup = prepare_force(scene.cell, [log, sealed]).at(scene.theta)
        known = log_conditions(scene.cell, sealed, 0.0 if sealed.clock is not None else float(scene.conditions.clock.max()))
        told = predictable(scene.given, lambda effect: known.given.issuperset(effect.needs)).known
        there = replace(scene, model=setup.model, given=told).over(setup.rows[1], known)
        return Asked(sealed, setup.rows[0], there)

    def says(self, effect: Effect) -> bool:
        """Whether they have every column that an effect needs."""
        return self.there.conditions.given.issuperset(effect.needs)


def predict_sealed_force(before: Fitted, after: Fitted, asked: Asked, known: Sequence[Active] = ()) -> Sealed:
    """Normal readings (n, 1) N of conditions without and with effects, what the sensor adds in, and one sigma of the noise-free
    value of the latter; known: effects at sizes that other signals show too.

    Effects for which they lack a column are left out of the correction and counted in sigma, as they were in the log.
    The wheel's law was fitted again to cover both logs, and the contact is refitted to the first on it.
    """
    problem, scene, there = after[0], after[0].scene, asked.there

    def told(own: ForceProblem, fit: EffectFit, known: Sequence[Active]) -> tuple[EffectFit, Array, Predicted, float]:
        measured = replace(own, scene=replace(own.scene, model=there.model, rows=asked.measured))
        try:
            again, apart = fit_effects(measured, fit.active, fit), 0.0
        except Infeasible:  # the fit as it was stands, as unsure as the two laws differ there
            again, other = fit, predict_forces(measured.scene, fit.at.x, fit.active)
            apart = float(np.mean((other.fn - fit.at.fn)[own.scene.rows.contact] ** 2))
        x, active, covariance = at_known_sizes(own, again, known)
        again = replace(again, at=replace(again.at, x=x, active=active))
        return again, covariance, predict_forces(there, x, predictable(active, asked.says).known), apart

    if not all(one is another for one, another in zip(asked.kept.get("of", (None, None)), before, strict=True)):
        asked.kept.update(of=before, told=told(*before, ()))
    bare = asked.kept["told"]
    fit, covariance, corrected, apart = bare if after[1] is before[1] else told(*after, known)
    parted = predictable(fit.active, asked.says)
    setpoint = scene.cell.flange.setpoint if scene.cell.flange is not None else 0.0
    more = _changed(problem.log, asked.sealed, setpoint) + _unshown(scene, fit, parted) + apart
    sigma = _sigma(problem, there, covariance, corrected, parted.kept, more)
    return Sealed(bare[2].fn[:, None], corrected.fn[:, None], sigma[:, None], parted.lacking)


def at_known_sizes(problem: ForceProblem, fit: EffectFit, known: Sequence[Active]) -> tuple[Array, tuple[Active, ...], Array]:
    """A fit's x, its effects and the covariance (k, k) of its unknowns with known effects at their sizes, as sure as those are;
    all else follows by the fit's own covariance."""
    (r, o), told, scale = problem.sizes, {a.key: a for a in known}, prior_sds(fit.active)
    better = tuple(told.get(a.key, a) for a in fit.active)
    there = r + o + np.flatnonzero(np.repeat([a.key in told for a in better], [len(a.a) for a in better]))
    covariance, off = np.asarray(np.linalg.inv(fit.information), float), units_of(better) - units_of(fit.active)
    sure = block_diag(np.zeros((0, 0)), *(a.covariance for a in better)) / np.outer(scale, scale)
    follows = np.linalg.solve(covariance[np.ix_(there, there)], covariance[there]).T
    moved = follows @ off[there - r - o]
    wider = sure[np.ix_(there - r - o, there - r - o)] - covariance[np.ix_(there, there)]
    active = with_coefficients(better, coefficients(fit.active) + scale * moved[r + o :])
    return fit.at.x + problem.believed.root @ moved[:r], active, covariance + follows @ wider @ follows.T


def _unshown(scene: LogScene, fit: EffectFit, parted: Predictable) -> float:
    """Mean square N^2 of what the unknown ones of the active effects do to the normal reading in the log."""
    if not parted.unknown:
        return 0.0
    ends = [predict_forces(scene, fit.at.x, active).fn for active in (fit.active, parted.known)]
    return float(np.mean((ends[1] - ends[0])[scene.rows.contact] ** 2))


def _sigma(problem: ForceProblem, there: LogScene, covariance: Array, at: Predicted, shown: Index, more: float) -> Array:
    """One sigma (n,) N: unknowns of the fit, of its effects' coefficients those `shown`, what runs differ by, and `more` N^2 of
    what else is not known."""
    r, o = problem.sizes
    J = linear_normal(problem, there, at)
    keep = np.r_[np.arange(r), r + o + shown]
    variance = np.sum(J @ covariance[np.ix_(keep, keep)] * J, axis=1) + (problem.repeats**2 + more) * there.rows.contact
    return np.asarray(np.sqrt(np.maximum(variance, 0.0)))


def _changed(log: ForceLog, sealed: ForceLog, own: float) -> float:
    """Mean square N^2 by which setpoints were off the cell's `own` N in a log that does not tell them, where readings nobody has
    seen do not tell them either."""
    if log.setpoint_sd is None or log.setpoint is None or sealed.setpoint is not None:
        return 0.0
    return float(np.mean((log.setpoint[log.contact] - own) ** 2))
