"""How good a calibration is where it was not fitted: blocked folds, campaigns, payloads and joint ranges left out."""

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.cluster.vq import kmeans2

from robots.calibration.fit import Fit, fit_campaign, predict_readings
from robots.calibration.noise import reading_covariance
from robots.calibration.residuals import linearise
from robots.calibration.solver import Campaign, OpenDirection
from robots.calibration.student_t import GROSS, NU, consistency
from robots.pose import Array
from robots.tracker_readings import Index, Readings

Mask = NDArray[np.bool_]

FOLDS = 5
LEAST_TRAIN, LEAST_TEST = 15, 3  # readings on each side of a fold
LEAST_SWEEP = np.radians(20.0)  # of an axis, whose upper half is left out: less tells nothing of how far it carries
LEAST_PLACED = 4  # postures that place a station or nest


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
    """All folds that the readings allow, a posture always on one side, under whatever load and with whatever nest it was read.

    Random ones take their share of each station, nest and payload; regions and halves of a joint's range leave a station or nest
    alone that would keep too few readings to be placed.
    """
    readings = campaign.readings
    part = _stratified(readings, np.random.default_rng(seed))
    for k in range(FOLDS):
        yield ReadingFold("random", f"{k + 1} of {FOLDS}", np.flatnonzero(part == k))
    # Regions in the space of the first three axes, where the arm is.
    q = readings.q[:, :3]
    _, label = kmeans2(q, FOLDS, seed=seed, minit="++")
    for k in np.unique(label):
        yield ReadingFold("region", f"{k + 1} of {FOLDS}", np.flatnonzero(_spared(readings, label == k)))
    parts = ("campaign", readings.session, readings.sessions), ("payload", readings.payload, readings.payloads)
    for kind, index, names in parts:
        if len(np.unique(index)) > 1:
            for k in np.unique(index):
                yield ReadingFold(kind, names[k], np.flatnonzero(index == k))
    for j in range(6):
        middle = np.median(readings.q[:, j])
        if np.ptp(readings.q[:, j]) > LEAST_SWEEP:
            yield ReadingFold(
                "joint range",
                f"axis {j + 1} above {round(float(np.degrees(middle)))} deg",
                np.flatnonzero(_spared(readings, readings.q[:, j] > middle)),
            )


def _stratified(readings: Readings, rng: np.random.Generator) -> Index:
    """Part (n,) of each reading, 0 to FOLDS - 1; each stratum is dealt out in turn, a posture with all of its readings."""
    group = readings.postures()
    part, dealt = np.full(group.max() + 1, -1), 0
    for rows in readings.strata():
        postures = np.unique(group[rows])
        postures = rng.permutation(postures[part[postures] < 0])
        part[postures] = (dealt + np.arange(len(postures))) % FOLDS
        dealt += len(postures)
    return np.asarray(part[group])


def _placed(readings: Readings, left: Mask) -> Mask:
    """Readings (n,) whose station and nest are placed by the readings `left` (n,): LEAST_PLACED postures of each."""
    seen = np.ones(len(readings), bool)
    group = readings.postures()
    for index in (readings.station, readings.target):
        for k in np.unique(index):
            seen[index == k] &= len(np.unique(group[left & (index == k)])) >= LEAST_PLACED
    return seen


def _spared(readings: Readings, held: Mask) -> Mask:
    """`held` (n,) without the stations and nests that would not be placed by what is left."""
    return np.asarray(held & _placed(readings, ~held))


def hold_out(fit: Fit, fold: ReadingFold, refit: Callable[[Campaign, Fit], Fit] | None = None) -> FoldErrors | None:
    """Fit without the fold's readings and predict them; None where too few are left on a side.

    Readings with a nest or station that the rest does not place cannot be predicted and are passed over on both sides, as are
    outliers; so is a fold without which the readings leave something open.
    `refit` fits another model than `fit`'s to the campaign that is left.
    """
    c = fit.campaign
    n = len(c.readings)
    held = np.zeros(n, bool)
    held[fold.held] = True
    known = _placed(c.readings, ~held)
    rows = np.flatnonzero(held & known & (fit.weight > GROSS))
    if (known & ~held).sum() < LEAST_TRAIN or len(rows) < LEAST_TEST:
        return None
    left = replace(c, readings=c.readings.take(np.flatnonzero(known & ~held)))
    try:
        other = refit(left, fit) if refit else again(left, fit)
    except OpenDirection:
        return None
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
