"""How far the gap shrinks once the named effects are in the model: predicted before anyone opens anything sealed.

    G^2 = max(0, mean square of the error - noise^2),    shrinkage = 1 - G_after / G_before          (FORMATS)

Two ways. Force logs and encoders: what readings that were left out say, interpolation folds and conditions withheld as a whole
(`from_folds`). Tracker: what the effects change on the campaign's postures with every payload the cell names, beside what remains
in any case, the parameters' errors and gear errors too small to name (`from_model`, docs/diagnose.md, eq. 2).
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ocp.diagnosis.anticipated import Group
from ocp.diagnosis.system import HeldOut
from robots.pose import Array

NULL = 0.2  # of the noise: a gap below it is none to speak of (FORMATS)
LEVEL = 0.9  # of the interval
DRAWS = 2000
STRETCHES = 60  # parts of a fold that are drawn as wholes
NEW = 0.25  # weight of extrapolation folds among the draws
WORST = -1.0  # a shrinkage below this says no more than "harmful"
# Share of the joint noise that is the same whenever an axis comes back: beta distributed, 0.4 on average, 0.07 to 0.8. On 24
# worlds of the virtual arm it was 0.20 to 0.50; what repeats say of it was uncorrelated with what it was.
LASTING = (1.5, 2.2)
UNSURE = 0.3  # one sigma of the logarithm of the parameters' variance
_ROWS = ("before_rows", "after_rows", "noise_rows")


@dataclass(frozen=True)
class Shrinkage:
    """1 - G_after / G_before to expect on new data, with a 90 % interval."""

    predicted: float
    low: float
    high: float


NONE = Shrinkage(0.0, 0.0, 0.0)
"""Where no effect is named nothing changes."""


def realised(before: float, after: float, noise: float) -> float | None:
    """Shrinkage from mean squares; None where the gap before is below a fifth of the noise."""
    gap = before - noise
    if gap <= NULL**2 * noise or gap <= 0:
        return None
    return float(1.0 - np.sqrt(max(after - noise, 0.0) / gap))


def from_model(groups: Sequence[Group], held: Sequence[HeldOut], noise: float, seed: int = 0) -> Shrinkage | None:
    """Of tracker readings: one group a payload, folds for what the effects leave unexplained, noise: mean square m^2. The mixture
    of payloads, the share of joint noise that lasts and the parameters' variance are drawn. None: no gap to speak of."""
    rng = np.random.default_rng(seed)
    moved, estimation, joints = (np.array([getattr(g, k) for g in groups]) for k in ("moved", "estimation", "noise"))
    mixture = rng.dirichlet(np.ones(len(groups)), DRAWS)
    lasting = rng.beta(*LASTING, DRAWS)
    left = mixture @ estimation * np.exp(UNSURE * rng.normal(size=DRAWS)) + lasting * (mixture @ joints)
    after = left + _unexplained(held, float(estimation.mean()))
    gap = after + mixture @ moved
    if np.median(gap) <= NULL**2 * noise:
        return None
    return _interval(1.0 - np.sqrt(after / gap))


def from_folds(held: Sequence[HeldOut], estimation: float, seed: int = 0) -> Shrinkage | None:
    """Of one signal from its folds; estimation: mean square SI^2 that the parameters' errors leave in any case. None where the
    gap is below a fifth of the noise or nothing could be left out."""
    inside = [h for h in held if not h.fold.extrapolates]
    outside = [h for h in held if h.fold.extrapolates]
    if not inside:
        inside, outside = outside, []
    if not inside:
        return None
    before, after, noise = (float(np.mean(np.concatenate([getattr(h, k) for h in inside]))) for k in _ROWS)
    if realised(before, after, noise) is None:
        return None
    rng = np.random.default_rng(seed)
    whole = [_drawn(rng, inside, estimation) for _ in range(DRAWS)]
    found = [s for s in whole if s is not None]
    judged = [h for h in outside if realised(h.before, h.after, h.noise) is not None]
    if judged:
        count = int(len(found) * NEW / (1.0 - NEW))
        pick = rng.integers(len(judged), size=count)
        found += [s for s in (_drawn(rng, [judged[k]], estimation) for k in pick) if s is not None]
    return _interval(np.array(found or [0.0]))


def _interval(draws: Array) -> Shrinkage:
    draws = np.maximum(draws, WORST)
    low, middle, high = np.quantile(draws, [0.5 - LEVEL / 2, 0.5, 0.5 + LEVEL / 2])
    return Shrinkage(float(middle), float(low), float(high))


def _unexplained(held: Sequence[HeldOut], estimation: float) -> float:
    """Mean square m^2 by which readings left out at random are worse than noise and estimation make them, less chance:
    x times x^2 / (x^2 + se^2)."""
    rows = [h.after_rows - h.noise_rows for h in held if h.fold.kind == "random"]
    if not rows:
        return 0.0
    excess = np.concatenate(rows)
    x, error = float(excess.mean()) - 1.25 * estimation, float(excess.std()) / len(excess) ** 0.5  # fitted to four fifths
    return x**3 / (x**2 + error**2) if x > 0 else 0.0


def _drawn(rng: np.random.Generator, held: Sequence[HeldOut], estimation: float) -> float | None:
    """One bootstrap draw of the shrinkage over stretches of the folds' readings."""
    sums, count, excused = np.zeros(3), 0, 0.0
    for h in held:
        n = len(h.before_rows)
        pieces = np.array_split(np.arange(n), min(n, STRETCHES))
        pick = np.concatenate([pieces[k] for k in rng.integers(len(pieces), size=len(pieces))])
        sums += [getattr(h, name)[pick].sum() for name in _ROWS]
        count += len(pick)
        excused += h.estimation * len(pick)
    before, after, noise = sums / count
    after -= excused / count  # what the fold's own want of readings did; that of all readings is `estimation`
    gap = before - noise
    if gap <= NULL**2 * noise or gap <= 0.0:
        return None
    # What is left is known to chance only; the parameters' errors are there in any case.
    return float(1.0 - np.sqrt(max(after - noise, min(estimation, gap)) / gap))
