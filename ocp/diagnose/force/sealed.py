"""Force readings nobody has seen: the believed contact refitted, and corrected by the named effects, with one sigma."""

from dataclasses import replace

import numpy as np

from ocp.calibrate.force.log import ForceLog, Index
from ocp.calibrate.force.model import ForceModel
from ocp.calibrate.force.rows import log_conditions, prepare_force
from ocp.diagnose.engine.channel_system import Predictable, Sealed, predictable
from ocp.diagnose.force.arm import logged_arm
from ocp.diagnose.force.fit import EffectFit, ForceProblem, fit_effects, linear_normal
from ocp.diagnose.force.prediction import LogScene, Predicted, predict_forces
from ocp.diagnose.rules import RUN_SD
from ocp.effects.effect import Effect
from robots.pose import Array


def predict_sealed_force(
    before: tuple[ForceProblem, EffectFit], after: tuple[ForceProblem, EffectFit], sealed: ForceLog
) -> Sealed:
    """Normal readings (n, 1) N of `sealed` without and with effects, what the sensor adds in, and one sigma of the noise-free
    value of the latter.

    Effects for which `sealed` lacks a column are left out of the correction and counted in sigma, as they were in the log.
    The wheel's law is fitted again to cover both logs, and the contact refitted to the first on it. Raises BadInput: points off
    the blade.
    """
    problem, scene = after[0], after[0].scene
    setup = prepare_force(scene.cell, [problem.log, sealed])
    model = ForceModel(scene.cell, setup.model.law)
    used = float(scene.conditions.clock.max())
    known = log_conditions(scene.cell, sealed, 0.0 if sealed.clock is not None else used)
    arm = logged_arm(scene.cell, scene.theta, sealed.q, known)
    there = LogScene(scene.cell, model, setup.rows[1], known, arm, scene.theta, scene.given)
    found: list[tuple[EffectFit, Predicted]] = []

    def has(effect: Effect) -> bool:
        return set(effect.needs) <= known.given

    for own, fit in (before, after):
        if found and fit is before[1]:  # no effect
            found.append(found[0])
            continue
        measured = replace(own, scene=replace(own.scene, model=model, rows=setup.rows[0]))
        again = fit_effects(measured, fit.active, fit)
        effects = predictable(again.active, has).known
        at = predict_forces(there, again.at.x, effects)
        found.append((again, predict_forces(there, again.at.x, effects, at)))
    (_, baseline), (fit, corrected) = found
    parted = predictable(fit.active, has)
    setpoint = scene.cell.flange.setpoint if scene.cell.flange is not None else 0.0
    more = _changed(problem.log, sealed, setpoint) + _usual(scene, fit, parted)
    sigma = _sigma(problem, there, fit, corrected, parted.kept, more)
    return Sealed(baseline.fn[:, None], corrected.fn[:, None], sigma[:, None], parted.lacking)


def _usual(scene: LogScene, fit: EffectFit, parted: Predictable) -> float:
    """Mean square N^2 of what the unknown ones of the active effects do to the normal reading in the log."""
    if not parted.unknown:
        return 0.0
    ends = [
        predict_forces(scene, fit.at.x, active, predict_forces(scene, fit.at.x, active)).fn
        for active in (fit.active, parted.known)
    ]
    return float(np.mean((ends[1] - ends[0])[scene.rows.contact] ** 2))


def _sigma(problem: ForceProblem, there: LogScene, fit: EffectFit, at: Predicted, shown: Index, more: float) -> Array:
    """One sigma (n,) N: unknowns of the fit, of its effects' coefficients those `shown`, what runs differ by, and `more` N^2 of
    what else is not known."""
    r, o = problem.sizes
    J = linear_normal(problem, there, at)
    keep = np.r_[np.arange(r), r + o + shown]
    covariance = np.linalg.inv(fit.information)[np.ix_(keep, keep)]
    variance = np.einsum("ni,ij,nj->n", J, covariance, J) + (RUN_SD**2 + more) * there.rows.contact
    return np.asarray(np.sqrt(np.maximum(variance, 0.0)))


def _changed(log: ForceLog, sealed: ForceLog, own: float) -> float:
    """Mean square N^2 by which setpoints were off the cell's `own` N in a log that does not tell them, where readings nobody has
    seen do not tell them either."""
    if log.setpoint_sd is None or log.setpoint is None or sealed.setpoint is not None:
        return 0.0
    return float(np.mean((log.setpoint[log.contact] - own) ** 2))
