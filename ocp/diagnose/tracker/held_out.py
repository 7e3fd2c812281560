"""How much a set of effects helps on readings that were left out, by linear refits about the fit of all readings; and predictions
of readings nobody has seen, by the believed cell refitted and with the named effects.

The fit without a fold differs from the whole fit by well below a millimetre; about the latter its second order is below a
micrometre, so one weighted least-squares solution with the priors stands for a nonlinear refit, a thousand times cheaper.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from scipy.cluster.vq import kmeans2

from ocp.diagnose.engine.channel_system import Fold, HeldOut, Predictable, Sealed, is_outlier, predictable
from ocp.diagnose.rules import FOLD_REST, FOLD_TIME, FOLD_WARMTH, LEAST_TURN
from ocp.diagnose.tracker.refit import RANK, Task, TrackerFit, gap_noise
from ocp.effects.effect import Active, prior_sds
from ocp.effects.engine.readings import PlacedReadings, has_columns, together
from robots.calibration.noise import reading_covariance
from robots.calibration.residuals import points
from robots.gauss_newton import linear_step
from robots.pose import Array, Index
from robots.tracker_readings import Readings

LEAST_TRAIN, LEAST_TEST = 15, 3  # readings on each side of a fold that is judged
PARTS = 5
LEAST = 8  # readings on each side of a fold that is made
OWN_STAND = ("session", "station")  # folds whose readings may stand by themselves


def tracker_folds(readings: Readings) -> list[Fold]:
    """Random and regional parts (a posture stays together), then payloads, sessions, warm and late readings, halves of joints'
    ranges, approach from one side."""
    r = readings
    group = r.postures()
    part = np.random.default_rng(0).permutation(np.arange(group.max() + 1) % PARTS)[group]
    found = [Fold(f"random={k + 1}", "random", part == k) for k in range(PARTS)]
    _, label = kmeans2(r.q[:, :3], PARTS, seed=0, minit="++")
    found += [Fold(f"block={k + 1}", "block", label == k) for k in np.unique(label)]
    stands = ("session", r.session, r.sessions) if len(np.unique(r.session)) > 1 else ("station", r.station, r.stations)
    for kind, index, names in (("payload", r.payload, r.payloads), stands):
        if len(np.unique(index)) > 1:
            found += [Fold(f"{kind}={names[k]}", kind, index == k) for k in np.unique(index)]
    # What a few readings of one session say of a thousand of another is no test of names.
    found = [f for f in found if f.kind not in OWN_STAND or (~f.held).mean() >= FOLD_REST]
    for kind, unit, values, least in (("temperature", "C", r.temperature, FOLD_WARMTH), ("time", "s", r.time, FOLD_TIME)):
        if values is not None and np.ptp(values) > least:
            cut = float(np.quantile(values, 2 / 3))
            found.append(Fold(f"{kind} above {cut:.4g} {unit}", kind, values > cut))
    for j in range(6):
        if np.ptp(r.q[:, j]) > LEAST_TURN:
            middle = float(np.median(r.q[:, j]))
            for side, held in (("above", r.q[:, j] > middle), ("below", r.q[:, j] <= middle)):
                found.append(Fold(f"joint {j + 1} {side} {np.degrees(middle):.0f} deg", "joint range", held))
    return [f for f in found if f.held.sum() >= LEAST and (~f.held).sum() >= LEAST]


def held_out_readings(
    task: Task, fit: TrackerFit, fold: Fold, active: Sequence[Active], seen: PlacedReadings, bare: Array
) -> HeldOut | None:
    """Mean squared 3D errors m^2 of the fold's readings, fitted without them: without effects and with `active`. A stand of the
    tracker that is left out as a whole has its place from the left-out readings, as everybody gives it who sets up there.
    seen: the readings as effects see them about the fit; bare (n, 3, p): the arm's derivatives without effects."""
    r = task.campaign.readings
    held = np.asarray(fold.held, bool)
    train = ~held
    good = np.isin(r.target, r.target[train]) & ~is_outlier(fit.weight)
    there = np.isin(r.station, r.station[train])
    own = [np.flatnonzero(held & good & (r.station == k)) for k in np.unique(r.station[~there])] if fold.kind in OWN_STAND else []
    own = [k for k in own if len(k) >= LEAST]
    rows = np.sort(np.concatenate([np.flatnonzero(held & good & there), *own]))
    if train.sum() < LEAST_TRAIN or len(rows) < LEAST_TEST:
        return None
    whole = fit.linear.residual + added(fit.active, seen, fit)[1]
    extra, _ = added(active, seen, fit)
    (before, unknown), (after, more) = (
        [placed_stands(task, fit, part, own)[rows] for part in _solved(task, fit, whole, columns, prior, train)]
        for columns, prior in ((bare, np.zeros(0)), (np.concatenate([fit.linear.J, extra], axis=2), prior_sds(active)))
    )
    # Not of the coefficients alone: an effect that the springs nearly imitate has large errors that these take back.
    added_by_effects = float((np.sum(more**2) - np.sum(unknown**2)) / len(rows))
    # Both errors hold what the believed cell is off by there, J u: their squares differ by 2 J u (before - after) for it,
    # whatever the effects.
    shared = 2.0 * np.einsum("ni,nip->p", before - after, unknown) / len(rows)
    S = reading_covariance(r.take(rows), task.campaign.instrument, gap_noise(fit.noise), fit.linear.d_joints[rows])
    squares = np.stack([np.sum(before**2, axis=1), np.sum(after**2, axis=1), np.trace(S, axis1=1, axis2=2)])
    return HeldOut(fold, squares, max(added_by_effects, 0.0), float(np.linalg.norm(shared)))


def placed_stands(task: Task, fit: TrackerFit, errors: Array, own: Sequence[Index]) -> Array:
    """Errors (n, 3, ...) m, each with the stands whose rows are `own` placed by these, as large as their freedom makes them."""
    found = errors.copy()
    for rows in own:
        J = fit.linear.J[rows][:, :, task.layout.station[task.campaign.readings.station[rows[0]]]]
        A, y = ((fit.W[rows] @ e).reshape(3 * len(rows), -1) for e in (J, errors[rows].reshape(len(rows), 3, -1)))
        left = errors[rows] - (J @ np.linalg.lstsq(A, y, rcond=None)[0]).reshape(errors[rows].shape)
        found[rows] = left * np.sqrt(len(A) / (len(A) - A.shape[1]))
    return found


def added(active: Sequence[Active], seen: PlacedReadings, fit: TrackerFit) -> tuple[Array, Array]:
    """Columns (n, 3, m) m of effects about the fit, and what they add (n, 3) m at their values."""
    none = np.zeros((len(seen.readings), 3))
    columns = [fit.linear.d_joints @ p[:, :6] + p[:, 6:] for p in together(active, seen)[0]]
    total = sum((c @ a.a for c, a in zip(columns, active, strict=True)), none)
    return np.concatenate(columns, axis=2) if columns else np.zeros((*none.shape, 0)), total


def _solved(task: Task, fit: TrackerFit, residual: Array, J: Array, prior: Array, train: Array) -> tuple[Array, Array]:
    """Errors (n, 3) m of all readings after the linear fit to `train` with derivatives J (n, 3, p), effects' last with their
    `prior`, and root (n, 3, r) m of what the errors of all unknowns leave there: times unit normals of r directions."""
    layout = task.layout
    sd = np.concatenate([layout.prior_sd, prior])
    offset = np.concatenate([np.where(np.isfinite(layout.prior_sd), fit.offset, 0.0), np.zeros(len(prior))])
    scale = np.where(np.isfinite(sd), sd, np.concatenate([layout.scale, np.ones(len(prior))]))
    A = (fit.W[train] @ J[train]).reshape(-1, len(sd)) * scale
    y = np.einsum("nij,nj->ni", fit.W[train], residual[train]).ravel()
    found = linear_step(y, A, offset / scale, np.isfinite(sd).astype(float), RANK)
    assert found.root is not None  # by singular values
    return np.asarray(residual - J @ (scale * found.change)), np.asarray((J * scale) @ found.root)


def predict_sealed_readings(
    before: tuple[Task, TrackerFit], after: tuple[Task, TrackerFit], lasting: Array, sealed: Readings
) -> Sealed:
    """`sealed` use the same names (targets, payloads, stations) as the readings that were fitted; `before` has no effects.
    lasting (6,): mean square rad^2 of each joint's errors that last (`background`)."""
    task, fit = after
    parted = _predictable(fit.active, sealed)
    seen = replace(sealed, turn=None, sigma_turn=None, point=np.nan_to_num(sealed.point))
    baseline = _points(*before, seen, lasting, Predictable((), (), np.zeros(0, np.int64)))[0]
    corrected, covariance = _points(task, fit, seen, lasting, parted)
    there = task.placed(fit.state, (*task.believed, *fit.active))
    usual = np.mean(added(parted.unknown, there, fit)[1] ** 2, axis=0)
    sigma = np.sqrt(np.maximum(np.einsum("nii->ni", covariance), 0.0) + usual)
    return Sealed(baseline, corrected, sigma, parted.lacking)


def _predictable(active: Sequence[Active], sealed: Readings) -> Predictable:
    """Effects parted by whether the conditions have what each needs."""
    return predictable(active, lambda effect: has_columns(effect, sealed))


def _points(task: Task, fit: TrackerFit, sealed: Readings, lasting: Array, parted: Predictable) -> tuple[Array, Array]:
    """Points (n, 3) m in the tracker's frame, with the effects that are known there, and covariance (n, 3, 3) m^2 of where
    noise-free reflectors will be; lasting (6,): mean square rad^2 of each joint's errors that are the same whenever its axis
    comes back, and so are in noise-free readings."""
    c = task.campaign
    # Effects of the tracker and of the base act on where the reflector is: predicted, as nobody measured it.
    place = points(c.robot, sealed, c.instrument, fit.state)
    believed = _predictable(task.believed, sealed).known
    asked = replace(task, campaign=replace(c, readings=replace(sealed, point=place)), believed=believed)
    linear, extra = asked.linearised(fit.state, parted.known)
    J = np.concatenate([linear.J, extra], axis=2)
    own = linear.J.shape[2]
    keep = np.r_[np.arange(own), own + parted.kept]
    covariance = fit.covariance[np.ix_(keep, keep)]
    D = linear.d_joints * np.sqrt(lasting)
    return linear.point, np.asarray(J @ covariance @ np.swapaxes(J, 1, 2) + D @ np.swapaxes(D, 1, 2))
