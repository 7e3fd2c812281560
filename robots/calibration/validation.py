"""How good a calibration is where it was not fitted: blocked folds, campaigns, payloads and joint ranges left out."""

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace

import numpy as np
from scipy.cluster.vq import kmeans2

from robots.calibration.fit import Fit, fit_campaign, predict_readings
from robots.calibration.noise import reading_covariance
from robots.calibration.residuals import linearise
from robots.calibration.solver import Campaign
from robots.calibration.student_t import NU, consistency
from robots.pose import Array
from robots.tracker_readings import Index

FOLDS = 5
LEAST_TRAIN, LEAST_TEST = 15, 3  # readings on each side of a fold
GROSS = 0.05  # weight in the full fit below which a reading is an outlier and is not held against a model


@dataclass(frozen=True)
class ReadingFold:
    """Readings of one kind left out: kind ("random", "region", "campaign", "payload", "joint range"), name, held rows."""

    kind: str
    name: str
    held: Index


@dataclass(frozen=True)
class FoldErrors:
    """Errors (m,) m of the readings `rows` (m,) that the model of a fold had not seen; score (m,): log density of each;
    squared (m,): squared error over its predicted covariance, 3 on average where that is honest; off (m, 3) m: measured less
    predicted in the tracker's frame."""

    fold: ReadingFold
    rows: Index
    error: Array
    score: Array
    squared: Array
    off: Array

    def figures(self) -> dict[str, float]:
        """rms, mean, standard deviation and maximum of the error in m, and error over prediction."""
        e = self.error
        over = float(np.sqrt(np.mean(self.squared) / 3))
        rms = float(np.sqrt(np.mean(e**2)))
        return {"rms": rms, "mean": float(e.mean()), "sd": float(e.std()), "max": float(e.max()), "over_predicted": over}


def folds(campaign: Campaign, seed: int = 0) -> Iterator[ReadingFold]:
    """All folds that the readings allow, repeats always on one side."""
    readings = campaign.readings
    group = readings.repeats()
    rng = np.random.default_rng(seed)
    part = rng.permutation(group.max() + 1) % FOLDS
    for k in range(FOLDS):
        yield ReadingFold("random", f"{k + 1} of {FOLDS}", np.flatnonzero(part[group] == k))
    # Regions in the space of the first three axes, where the arm is.
    q = readings.q[:, :3]
    _, label = kmeans2(q, FOLDS, seed=seed, minit="++")
    for k in np.unique(label):
        yield ReadingFold("region", f"{k + 1} of {FOLDS}", np.flatnonzero(label == k))
    for kind, index, names in (
        ("campaign", readings.session, readings.sessions),
        ("payload", readings.payload, readings.payloads),
    ):
        if len(np.unique(index)) > 1:
            for k in np.unique(index):
                yield ReadingFold(kind, names[k], np.flatnonzero(index == k))
    for j in range(6):
        middle = np.median(readings.q[:, j])
        if np.ptp(readings.q[:, j]) > np.radians(20):
            yield ReadingFold(
                "joint range", f"axis {j + 1} above {np.degrees(middle):.0f} deg", np.flatnonzero(readings.q[:, j] > middle)
            )


def hold_out(fit: Fit, fold: ReadingFold, refit: Callable[[Campaign, Fit], Fit] | None = None) -> FoldErrors | None:
    """Fit without the fold's readings and predict them; None where too few are left on a side.

    Readings with a nest or station that only the fold has cannot be predicted and are passed over, as are outliers.
    `refit` fits another model than `fit`'s to the campaign that is left.
    """
    c = fit.campaign
    n = len(c.readings)
    held = np.zeros(n, bool)
    held[fold.held] = True
    known = np.isin(c.readings.target, c.readings.target[~held]) & np.isin(c.readings.station, c.readings.station[~held])
    rows = np.flatnonzero(held & known & (fit.weight > GROSS))
    if (~held).sum() < LEAST_TRAIN or len(rows) < LEAST_TEST:
        return None
    left = replace(c, readings=c.readings.take(np.flatnonzero(~held)))
    other = refit(left, fit) if refit else again(left, fit)
    seen = replace(c.readings.take(rows), turn=None)
    points, covariance = predict_readings(other, seen)
    off = seen.point - points
    linear = linearise(c.robot, seen, c.instrument, other.layout, other.state)
    whole = covariance + other.spread**2 * reading_covariance(seen, c.instrument, other.noise, linear.d_joints)
    squared = np.einsum("ni,ni->n", off, np.linalg.solve(whole, off[..., None])[..., 0])
    _, logdet = np.linalg.slogdet(whole * consistency(3))
    score = -0.5 * ((NU + 3) * np.log1p(squared / (NU * consistency(3))) + logdet)
    return FoldErrors(fold, rows, np.linalg.norm(off, axis=1), score, squared, off)


def again(left: Campaign, fit: Fit) -> Fit:
    """The model of `fit` on other readings, from where it stands."""
    return fit_campaign(left, fit.choice, fit.priors, fit.noise, begin=fit.state)


def validate(fit: Fit, refit: Callable[[Campaign, Fit], Fit] | None = None) -> list[FoldErrors]:
    """Every fold that can be judged."""
    return [h for h in (hold_out(fit, fold, refit) for fold in folds(fit.campaign)) if h is not None]


def by_kind(found: list[FoldErrors]) -> dict[str, dict[str, float]]:
    """Figures of each kind of fold, its readings together."""
    table = {}
    for kind in dict.fromkeys(h.fold.kind for h in found):
        parts = [h for h in found if h.fold.kind == kind]
        together = FoldErrors(
            parts[0].fold, *(np.concatenate([getattr(h, a) for h in parts]) for a in ("rows", "error", "score", "squared", "off"))
        )
        table[kind] = together.figures() | {"readings": float(len(together.rows)), "folds": float(len(parts))}
    return table
