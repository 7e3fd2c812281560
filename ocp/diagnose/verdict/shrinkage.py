"""How far the gap shrinks once the named effects are in the model: predicted before anyone has measured there.

    G^2 = max(0, mean square of the error - noise^2),    shrinkage = 1 - G_after / G_before          (FORMATS)

Three ways. Tracker: what the effects change on the campaign's postures with every payload the cell names, beside what remains in
any case, the parameters' errors and gear errors too small to name (`from_model`, docs/diagnose.md, eq. 2). Force logs: the same
on the log's recordings, later (`ocp.diagnose.force.shrinkage`). Encoders: what readings that were left out say, interpolation
folds and conditions withheld as a whole (`from_folds`).
"""

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from scipy.special import expit, log_ndtr, ndtri_exp

from ocp.diagnose import rules
from ocp.diagnose.engine.channel_system import SCALE, Channel, HeldOut
from ocp.model.theta import covariance_root
from robots.pose import Array

DRAWS = 1000
STRETCHES = 60  # parts of a fold that are drawn as wholes


@dataclass(frozen=True)
class Shrinkage:
    """1 - G_after / G_before to expect, with a 90 % interval; draws (k,) that these are of."""

    predicted: float
    low: float
    high: float
    draws: Array = field(default_factory=lambda: np.zeros(1), repr=False, compare=False)


NONE = Shrinkage(0.0, 0.0, 0.0)
"""Where no effect is named nothing changes."""


@dataclass(frozen=True)
class NewReadings:
    """New readings with one payload at one temperature. moved (a, n, 3) m: what each alternative adds to the baseline; errors
    (n, 3, p) m per unit of the accepted model's parameters; joints (n, 6) m^2 per rad^2: weight of the joints' lasting errors."""

    payload: str
    moved: Array
    errors: Array
    joints: Array


@dataclass(frozen=True)
class Anticipated:
    """Groups of new readings; measured: names of the campaign's payloads; probability (a,) of every alternative, the accepted one
    first; covariance (p, p) of the parameters of the accepted model; lasting (k, 6) draws of the joints' mean squares rad^2 that
    no fit takes away; whole: of these very readings, all of them."""

    groups: tuple[NewReadings, ...]
    measured: tuple[str, ...]
    probability: Array
    covariance: Array
    lasting: Array
    whole: bool = False


def realised(before: float, after: float, noise: float) -> float | None:
    """Shrinkage from mean squares; None where the gap before is below a fifth of the noise."""
    gap = before - noise
    return float(1.0 - np.sqrt(max(after - noise, 0.0) / gap)) if gap > max(rules.NO_GAP**2 * noise, 0.0) else None


def from_model(
    new: Anticipated, held: Sequence[HeldOut], noise: float, carried: tuple[float, float] | None = None
) -> Shrinkage | None:
    """Of tracker readings: what is anticipated, folds for what the effects leave unexplained, noise: mean square m^2. Drawn are
    which alternative is true, payloads and temperature, postures, parameters' errors and the joints' lasting errors; `carried`:
    and which share (mean, sd) of what alternatives add to the last one is there in new readings. None: no gap to speak of."""
    rng = np.random.default_rng(0)
    errors = drawn_errors(new.covariance, rng)
    lasting = new.lasting[rng.integers(len(new.lasting), size=DRAWS)]
    true = rng.choice(len(new.probability), DRAWS, p=new.probability)
    there = None if carried is None else np.random.default_rng(0).normal(*carried, DRAWS)[:, None, None]
    after, before = np.zeros(DRAWS), np.zeros(DRAWS)
    for share, g in zip(_conditions(new, rng).T, new.groups, strict=True):
        n = g.errors.shape[0]
        off = (errors @ g.errors.reshape(3 * n, -1).T).reshape(-1, n, 3)
        if new.whole:
            rows = np.full((DRAWS, n), 1.0 / sum(len(one.joints) for one in new.groups))
        else:  # postures drawn anew (Rubin 1981, the Bayesian bootstrap)
            rows = share[:, None] * rng.dirichlet(np.ones(n), DRAWS)
        joints = lasting @ g.joints.T
        truth = g.moved[true] if there is None else g.moved[-1] + there * (g.moved[true] - g.moved[-1])
        after += np.sum(rows * (np.sum((g.moved[0] - truth + off) ** 2, axis=2) + joints), axis=1)
        before += np.sum(rows * (np.sum((off - truth) ** 2, axis=2) + joints), axis=1)
    each = [np.einsum("nij,jk,nik->n", g.errors, new.covariance, g.errors, optimize=True).mean() for g in new.groups]
    rest = unexplained(held, float(np.mean(each)), rng)  # their mean: what the parameters' errors leave, m^2
    if np.median(before + rest) <= rules.NO_GAP**2 * noise:
        return None
    return interval(1.0 - np.sqrt((after + rest) / (before + rest)))


def drawn_errors(covariance: Array, rng: np.random.Generator) -> Array:
    """Draws (k, p) of the parameters' errors. Their root is the symmetric one, which the last digits of a covariance do not
    move: eigenvectors turn with them where eigenvalues are close, and a promise would be another on another machine."""
    sd = np.sqrt(np.diag(covariance))
    scale = np.where(sd > 0, sd, 1.0)
    turned, size, _ = np.linalg.svd(covariance_root(covariance) / scale[:, None], full_matrices=False)
    return np.asarray((rng.normal(size=(DRAWS, len(sd))) @ turned * size) @ turned.T * sd)


def _conditions(new: Anticipated, rng: np.random.Generator) -> Array:
    """Draws (k, g) of the share of every group: payloads mixed, one temperature at a time."""
    names = list(dict.fromkeys(g.payload for g in new.groups))
    mixture = rng.dirichlet([rules.MEASURED_PAYLOAD if n in new.measured else rules.UNMEASURED_PAYLOAD for n in names], DRAWS)
    of = np.array([names.index(g.payload) for g in new.groups])
    rank = np.array([np.sum(of[:i] == p) for i, p in enumerate(of)])  # of the temperature
    return np.asarray(mixture[:, of] * (rank == rng.integers(rank.max() + 1, size=DRAWS)[:, None]))


def from_folds(held: Sequence[HeldOut], estimation: float) -> Shrinkage | None:
    """Of one signal from its folds; estimation: mean square SI^2 that the parameters' errors leave in any case. None where the
    gap is below a fifth of the noise or nothing could be left out."""
    inside = [h for h in held if not h.fold.extrapolates]
    outside = [h for h in held if h.fold.extrapolates]
    if not inside:
        inside, outside = outside, []
    if not inside:
        return None
    before, after, noise = np.concatenate([h.rows for h in inside], axis=1).mean(axis=1)
    if realised(before, after, noise) is None:
        return None
    rng = np.random.default_rng(0)
    found = [_drawn(rng, inside, estimation, DRAWS)]
    judged = [h for h in outside if realised(*h.means) is not None]
    if judged:
        count = int(len(found[0]) * rules.NEW_CONDITIONS / (1.0 - rules.NEW_CONDITIONS))
        pick = np.bincount(rng.integers(len(judged), size=count), minlength=len(judged))
        found += [_drawn(rng, [h], estimation, int(k)) for h, k in zip(judged, pick, strict=True) if k]
    every = np.concatenate(found)
    return interval(every if len(every) else np.zeros(1))


def interval(draws: Array) -> Shrinkage:
    """Median and interval of draws (k,) of the shrinkage."""
    draws = np.maximum(draws, rules.HARMFUL)
    low, middle, high = np.quantile(draws, [0.5 - rules.INTERVAL / 2, 0.5, 0.5 + rules.INTERVAL / 2])
    return Shrinkage(float(middle), float(low), float(high), draws)


ANOTHER_DAY = "another day"
KINDS = {"joint range": "another region", "time": "later", "station": "another session"}  # others after what was left out


def fold_kind(held: HeldOut) -> str:
    """What new data are like that one fold stands for."""
    return KINDS.get(held.fold.kind, f"another {held.fold.kind}")


def promised_by_kind(held: Sequence[HeldOut]) -> dict[str, Shrinkage]:
    """What left-out conditions say of new data, by what is new about these, which are like one of them or another; kinds without
    a gap to speak of are left out. The same readings left out under several names (a payload carried last, and warm) say what
    they say once, of the first: nobody can tell which of the names it was."""
    groups: dict[str, list[HeldOut]] = {}
    seen: dict[bytes, HeldOut] = {}
    for h in held:
        if h.fold.extrapolates and seen.setdefault(h.fold.held.tobytes(), h) is h and realised(*h.means) is not None:
            groups.setdefault(fold_kind(h), []).append(h)
    rng = np.random.default_rng(0)
    drawn = {
        kind: np.concatenate([_drawn(rng, [h], h.estimation, DRAWS // len(some)) for h in some]) for kind, some in groups.items()
    }
    return {kind: interval(draws) for kind, draws in drawn.items() if len(draws)}


def promised_later(told: Shrinkage, chosen: bool) -> Shrinkage:
    """A promise for another day: a share g of what the names explain is there again, whatever else stays,

        before^2 = rest^2 + g^2 D^2,   after^2 = rest^2 + (1 - g)^2 D^2,   rest = 1 - shrinkage,  D^2 = 1 - rest^2,

    g ~ N(mean, sd^2) as `rules.CARRIED` has it, for names `chosen` on held-out errors or not."""
    mean, sd = rules.CARRIED_CHOSEN if chosen else rules.CARRIED
    g = np.random.default_rng(0).normal(mean, sd, len(told.draws))
    rest = (1.0 - told.draws) ** 2
    named = np.maximum(1.0 - rest, 0.0)
    return interval(np.where(named > 0, 1.0 - np.sqrt((rest + (1.0 - g) ** 2 * named) / (rest + g**2 * named)), told.draws))


def unexplained(held: Sequence[HeldOut], estimation: float, rng: np.random.Generator) -> Array:
    """Draws (k,) of the mean square SI^2 by which something is unexplained, given how much worse than noise and estimation make
    them random folds are: nothing with prior probability `NOTHING_UNEXPLAINED`, else exponential about `UNEXPLAINED_SIZE`."""
    rows = [(h.rows[1] - h.rows[2], h.rows[2]) for h in held if h.fold.kind == "random"]
    if not rows:
        return np.zeros(DRAWS)
    excess, noise = (np.concatenate(part) for part in zip(*rows, strict=True))
    worse = float(excess.mean()) - 1.25 * estimation  # fitted to four fifths of the readings
    error, scale = max(float(excess.std()) / len(excess) ** 0.5, 1e-300), rules.UNEXPLAINED_SIZE * float(noise.mean())
    # A normal likelihood times an exponential prior is a normal about `centre`, cut at zero.
    centre = worse - error**2 / scale
    log = 0.5 * (centre / error) ** 2 + float(log_ndtr(centre / error)) + np.log(error / scale) + 0.5 * np.log(2 * np.pi)
    there = expit(log + np.log((1 - rules.NOTHING_UNEXPLAINED) / rules.NOTHING_UNEXPLAINED))
    uniform = rng.uniform(size=DRAWS)
    size = centre - error * ndtri_exp(log_ndtr(centre / error) + np.log1p(-uniform))
    return np.where(rng.uniform(size=DRAWS) < there, np.maximum(size, 0.0), 0.0)


def _drawn(rng: np.random.Generator, held: Sequence[HeldOut], estimation: float, draws: int) -> Array:
    """Bootstrap draws (up to `draws`,) of the shrinkage over stretches of the folds' readings; none where a draw has no gap."""
    sums, count, excused = np.zeros((draws, 3)), np.zeros(draws), np.zeros(draws)
    for h in held:
        n = h.rows.shape[1]
        pieces = min(n, STRETCHES)
        starts = np.array([part[0] for part in np.array_split(np.arange(n), pieces)])
        whole = np.add.reduceat(h.rows, starts, axis=1).T
        sizes = np.diff(np.append(starts, n)).astype(float)
        pick = rng.integers(pieces, size=(draws, pieces))
        sums += whole[pick].sum(axis=1)
        if h.shared > 0.0:
            sums[:, 1] += sizes[pick].sum(axis=1) * h.shared * rng.normal(size=draws)
        taken = sizes[pick].sum(axis=1)
        count += taken
        excused += h.estimation * taken
    before, after, noise = (sums / count[:, None]).T
    after = after - excused / count  # what the fold's own want of readings did; that of all readings is `estimation`
    gap = before - noise
    there = (gap > rules.NO_GAP**2 * noise) & (gap > 0.0)
    # What is left is known to chance only; the parameters' errors are there in any case.
    left = np.maximum(after - noise, np.minimum(estimation, gap))[there]
    return np.asarray(1.0 - np.sqrt(left / gap[there]))


def estimation_variance(channel: Channel) -> float:
    """Mean square SI^2 of a reading that the unknowns' errors leave, those of the channel's active effects with them.

    With leverage h of a row, a fit without it predicts it with the variance h / (1 - h) of its noise (Allen 1974, PRESS)."""
    system = channel.system
    known = np.isfinite(system.prior_sd)
    shown = [(one, *channel.variants(one.effect, one.joint, [one.scanned])) for one in channel.active]
    effects = [columns[:, 0] * np.asarray(one.effect.prior_sd) for one, found, columns in shown if found]
    A = np.hstack([system.nuisance * np.where(known, system.prior_sd, 1.0), *effects])
    held = np.append(known, np.ones(A.shape[1] - len(known), bool))
    prior = np.where(held, 1.0, 1e-9 * np.linalg.norm(A, axis=0))
    U, s, _ = np.linalg.svd(np.vstack([A, np.diag(prior)]), full_matrices=False)
    leverage = np.minimum((U[: len(A), s > 1e-12 * s[0]] ** 2).sum(axis=1), 0.9)
    return float((channel.noise_floor / SCALE[channel.unit]) ** 2 * np.mean(leverage / (1.0 - leverage)))
