"""Force readings nobody has seen: the believed contact refitted, and corrected by the named effects, with one sigma."""

from dataclasses import replace

import numpy as np

from ocp.diagnosis.force.arm import arm_of
from ocp.diagnosis.force.balance import Balance
from ocp.diagnosis.force.believed import RUN_SD
from ocp.diagnosis.force.conditions import conditions_of
from ocp.diagnosis.force.fit import ForceFit, Problem, linear_normal, solve
from ocp.diagnosis.force.prediction import Predicted, Scene, predict
from ocp.diagnosis.system import Sealed
from ocp.force.log import ForceLog
from ocp.force.rows import prepare_force
from robots.pose import Array


def predict_sealed(before: tuple[Problem, ForceFit], after: tuple[Problem, ForceFit], sealed: ForceLog) -> Sealed:
    """Normal readings (n, 1) N of `sealed` without and with effects, what the sensor adds in, and one sigma of the noise-free
    value of the latter.

    The wheel's law is fitted again to cover both logs, and the contact refitted to the first on it. Raises BadInput: points off
    the blade.
    """
    problem, scene = after[0], after[0].scene
    setup = prepare_force(scene.cell, [problem.log, sealed])
    balance = Balance(scene.cell, setup.model.law)
    used = float(scene.conditions.clock.max())
    told = conditions_of(scene.cell, sealed, 0.0 if "clock_s" in scene.conditions.given else used)
    arm = arm_of(scene.cell, scene.theta, sealed.q, told)
    there = Scene(scene.cell, balance, setup.rows[1], told, arm, scene.theta, scene.given)
    found: list[tuple[ForceFit, Predicted]] = []
    for own, fit in (before, after):
        if found and fit is before[1]:  # no effect
            found.append(found[0])
            continue
        measured = replace(own, scene=replace(own.scene, balance=balance, rows=setup.rows[0]))
        again = solve(measured, fit.active, fit)
        at = predict(there, again.at.x, again.active)
        found.append((again, predict(there, again.at.x, again.active, at)))
    sigma = _sigma(problem, there, *found[1], _changed(problem.log, sealed))
    return Sealed(found[0][1].fn[:, None], found[1][1].fn[:, None], sigma[:, None])


def _sigma(problem: Problem, there: Scene, fit: ForceFit, at: Predicted, changed: float) -> Array:
    """One sigma (n,) N: unknowns of the fit, what runs differ by, and setpoints that were changed by a mean square N^2."""
    r, o = problem.sizes
    J = linear_normal(problem, there, at)
    keep = np.r_[np.arange(r), np.arange(r + o, len(fit.z))]
    covariance = np.linalg.inv(fit.information)[np.ix_(keep, keep)]
    variance = np.einsum("ni,ij,nj->n", J, covariance, J) + (RUN_SD**2 + changed) * there.rows.contact
    return np.asarray(np.sqrt(np.maximum(variance, 0.0)))


def _changed(log: ForceLog, sealed: ForceLog) -> float:
    """Mean square N^2 by which the setpoint was changed in a log that does not tell it, where readings nobody has seen do not
    tell it either."""
    if log.setpoint_sd is None or log.setpoint is None or sealed.setpoint is not None:
        return 0.0
    read_off = log.setpoint[log.contact]
    return float(np.mean((read_off - np.median(read_off)) ** 2))
