"""How much a set of effects helps on readings that were left out, by linear refits about the fit of all readings.

The fit without a fold differs from the whole fit by well below a millimetre; about the latter its second order is below a
micrometre, so one weighted least-squares solution with the priors stands for a nonlinear refit, a thousand times cheaper.
"""

from collections.abc import Sequence

import numpy as np

from ocp.diagnose.engine.system import Fold, HeldOut, drifts
from ocp.diagnose.tracker.motion import Seen, together
from ocp.diagnose.tracker.noise import plain
from ocp.diagnose.tracker.refit import RANK, Held, Task
from ocp.effects.effect import Active, prior_sds
from robots.calibration.noise import reading_covariance
from robots.gauss_newton import linear_step
from robots.pose import Array

GROSS = 0.1  # reliability below which a reading is an outlier and is not held against a model
LEAST_TRAIN, LEAST_TEST = 15, 3


def held_out(task: Task, fit: Held, fold: Fold, active: Sequence[Active]) -> HeldOut | None:
    """Mean squared 3D errors m^2 of the fold's readings, fitted without them: without effects and with `active`."""
    r = task.campaign.readings
    held = np.asarray(fold.held, bool)
    train = ~held
    known = np.isin(r.target, r.target[train]) & np.isin(r.station, r.station[train]) & (fit.weight > GROSS)
    rows = np.flatnonzero(held & known)
    if train.sum() < LEAST_TRAIN or len(rows) < LEAST_TEST:
        return None
    seen = Seen(
        task.campaign.robot, r, task.campaign.instrument, fit.state, fit.linear.point, task.reference, task.start.arm[30:]
    )
    whole = fit.linear.residual + added(fit.active, seen, fit)[1]
    extra, _ = added(active, seen, fit)
    before = _solved(task, fit, whole, np.zeros((len(r), 3, 0)), np.zeros(0), train)[0][rows]
    prior = prior_sds(active)
    errors, a, covariance = _solved(task, fit, whole, extra, prior, train)
    after = errors[rows]
    told = np.einsum("nim,mk,nik->n", extra[rows], covariance, extra[rows])
    moved = a - _solved(task, fit, whole, extra, prior, np.ones(len(r), bool))[1]
    drift = drifts(active, moved, covariance)
    S = reading_covariance(r.take(rows), task.campaign.instrument, plain(fit.noise), fit.linear.d_joints[rows])
    noise = np.trace(S, axis1=1, axis2=2)
    e, f = np.sum(before**2, axis=1), np.sum(after**2, axis=1)
    return HeldOut(fold, float(e.mean()), float(f.mean()), float(noise.mean()), e, f, noise, float(told.mean()), drift)


def added(active: Sequence[Active], seen: Seen, fit: Held) -> tuple[Array, Array]:
    """Columns (n, 3, m) m of effects about the fit, and what they add (n, 3) m at their values."""
    n = len(seen.readings)
    if not active:
        return np.zeros((n, 3, 0)), np.zeros((n, 3))
    parts, _, _ = together(active, seen)
    columns = [fit.linear.d_joints @ p[:, :6] + p[:, 6:] for p in parts]
    return np.concatenate(columns, axis=2), sum(c @ a.a for c, a in zip(columns, active, strict=True))  # type: ignore[return-value]


def _solved(task: Task, fit: Held, residual: Array, extra: Array, prior: Array, train: Array) -> tuple[Array, Array, Array]:
    """Errors (n, 3) m of all readings after the linear fit to `train`, coefficients (m,) and their covariance."""
    layout = task.layout
    sd = np.concatenate([layout.prior_sd, prior])
    offset = np.concatenate([np.where(np.isfinite(layout.prior_sd), fit.offset, 0.0), np.zeros(len(prior))])
    scale = np.where(np.isfinite(sd), sd, np.concatenate([layout.scale, np.ones(len(prior))]))
    J = np.concatenate([fit.linear.J, extra], axis=2)
    A = (fit.W[train] @ J[train]).reshape(-1, len(sd)) * scale
    y = np.einsum("nij,nj->ni", fit.W[train], residual[train]).ravel()
    found = linear_step(y, A, offset / scale, np.isfinite(sd).astype(float), RANK)
    step, last = scale * found.change, slice(layout.size, None)
    covariance = scale[last, None] * found.covariance[last, last] * scale[last]
    return np.asarray(residual - J @ step), step[last], covariance
