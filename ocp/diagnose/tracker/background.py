"""What of the joint noise comes back: play and gear ripple too small to name, found in what a fit leaves.

A fit's joint noise holds repeatability, new at every reading, and errors that are the same whenever an axis comes back from the
same side. Only the latter are in a reading free of noise, so only they limit what a corrected model can reach. They are learnt
as a population, joints alike (hierarchical normal prior, its size on a grid, evenly but for a share at zero):

    y = M sum_j d_j [ b_j s_j + c_j cos(k_j q_j) + d_j sin(k_j q_j) ] + e,    b_j ~ N(0, p^2),  c_j, d_j ~ N(0, r^2)        (1)

y: projected residual of the fit, e: white, k_j: one order a joint, unknown. The sums over k_j are done joint by joint, each given
what the others explain (mean field, Bishop 2006, section 10.1). A gear may have further lines of that size.
"""

from dataclasses import dataclass

import numpy as np
from scipy.special import logsumexp

from ocp.diagnose.engine.evidence import Projection, project
from ocp.diagnose.rules import BACKGROUND_SIZES, FURTHER_LINES, NO_BACKGROUND, NO_OTHER_RIPPLE
from ocp.diagnose.tracker.refit import Task, TrackerFit, is_restless, usual_noise
from robots.pose import Array, Index

ORDERS = np.arange(3, 301)  # waves per turn, as the catalogue's gear_harmonic
SWEEPS = 3
MOST = 400  # readings that are looked at, evenly taken
DRAWS = 500


@dataclass(frozen=True)
class Background:
    """Lasting joint errors: draws (k, 6) of each joint's mean square rad^2 from the posterior; others (6, s): posterior of the
    ripple's size on `BACKGROUND_SIZES` that the other five joints show, what is believed of one before it is looked at."""

    draws: Array
    others: Array


def background(task: Task, fit: TrackerFit) -> Background:
    """The background that a fit's residual shows, its named effects taken out."""
    rng = np.random.default_rng(0)
    n = len(task.campaign.readings)
    rows = np.unique(np.linspace(0, n - 1, min(n, MOST)).astype(np.int64))
    D = fit.linear.d_joints[rows]
    y, columns, projection = _projected(task, fit, rows)
    approach = task.campaign.readings.approach
    found = np.zeros((DRAWS, 6))
    if approach is not None and np.ptp(approach[rows], axis=0).any():
        play = projection.apply(columns * np.repeat(approach[rows], 3, axis=0)) / _scale(y, projection)
        mean, draws = _play(play, y / _scale(y, projection), rng)
        found += draws**2
        y = y - _scale(y, projection) * (play @ mean)
    squares, sizes, others = _ripple(task.campaign.readings.q[rows], columns, projection, y, rng)
    found += 0.5 * squares
    levers = np.sum(D**2, axis=(0, 1))
    return Background(_with_further(task, fit, found, found @ levers / levers.sum(), sizes, rng), others)


def _projected(task: Task, fit: TrackerFit, rows: Index) -> tuple[Array, Array, Projection]:
    """Residual (3 r,) white about zero effects and the prior's nuisance, joints' columns (3 r, 6) not yet projected."""
    layout = task.layout
    J = np.concatenate([fit.linear.J, fit.extra], axis=2)
    A = (fit.W[rows] @ J[rows]).reshape(3 * len(rows), -1)
    sd = np.concatenate([layout.prior_sd, *[np.asarray(a.effect.prior_sd, float) for a in fit.active]])
    offset = np.concatenate([np.where(np.isfinite(layout.prior_sd), fit.offset, 0.0), *[a.a for a in fit.active]])
    projection = project(A, sd)
    residual = np.einsum("nij,nj->ni", fit.W[rows], fit.linear.residual[rows]).ravel()
    columns = (fit.W[rows] @ fit.linear.d_joints[rows]).reshape(3 * len(rows), 6)
    return projection.apply(residual + A @ offset), columns, projection


def _scale(y: Array, projection: Projection) -> float:
    """Rms of white rows: the noise level of a fit is not quite that of its residual."""
    return float(np.sqrt(max(float(y @ y), 1e-12) / max(len(y) - projection.free, 1)))


def _weights(log: Array, even: bool = True) -> Array:
    """Posterior (s,) of the population's size from log evidences over size zero; even: as much of an even density as each stands
    for, else all of them alike."""
    each = np.gradient(BACKGROUND_SIZES)[1:] if even else np.ones(len(BACKGROUND_SIZES) - 1)
    none = NO_BACKGROUND if even else NO_OTHER_RIPPLE
    prior = np.append(none, (1.0 - none) * each / each.sum())
    log = log + np.log(prior)
    return np.asarray(np.exp(log - logsumexp(log)))


def _play(C: Array, y: Array, rng: np.random.Generator) -> tuple[Array, Array]:
    """Mean (6,) and draws (k, 6) of half widths rad of all joints' play."""
    G, b = C.T @ C, C.T @ y
    log, means, roots = [0.0], [np.zeros(6)], [np.zeros((6, 6))]
    for size in BACKGROUND_SIZES[1:]:
        precision = np.eye(6) / size**2 + G
        V = np.linalg.inv(precision)
        log.append(0.5 * float(b @ V @ b - np.linalg.slogdet(size**2 * precision)[1]))
        means.append(V @ b)
        roots.append(np.linalg.cholesky(V))
    weight = _weights(np.array(log))
    pick = rng.choice(len(BACKGROUND_SIZES), DRAWS, p=weight)
    draws = np.array(means)[pick] + np.einsum("kij,kj->ki", np.array(roots)[pick], rng.normal(size=(DRAWS, 6)))
    return weight @ np.array(means), draws


@dataclass(frozen=True)
class _Line:
    """Waves of one joint: cosines, then sines of each order (r, 2 k) at r readings; column (r, 3): what a rad of it makes of the
    white reading before `projection`; G (3, k): squares of cosines, of sines, products behind it."""

    waves: Array
    column: Array
    projection: Projection
    G: Array

    def met(self, y: Array) -> Array:
        """Products (s, 2, k) of the waves with rows y (s, N)."""
        rows = self.projection.apply(y.T).T.reshape(len(y), -1, 3)
        return np.asarray((np.einsum("snc,nc->sn", rows, self.column) @ self.waves).reshape(len(y), 2, -1))

    def explained(self, waves: "_Waves") -> Array:
        """Expected rows (s, N)."""
        turn = (waves.weight[:, None] * waves.mean).reshape(len(waves.log), -1) @ self.waves.T
        return self.projection.apply((turn[:, :, None] * self.column).reshape(len(turn), -1).T).T


@dataclass(frozen=True)
class _Waves:
    """A wave of unknown order, for each size: log evidence (s,), posterior (s, k) of the order, means (s, 2, k) rad, covariance
    (s, 3, k) rad^2."""

    log: Array
    weight: Array
    mean: Array
    V: Array


def _with_further(task: Task, fit: TrackerFit, found: Array, each: Array, sizes: Array, rng: np.random.Generator) -> Array:
    """Draws (k, 6) rad^2 of what was found, `each` (k,) a joint on average, and of gears' further lines, which do not stand out:
    none to FURTHER_LINES as large as the population's `sizes` (k,) rad, drawn again by how usual the repeatability is that is
    left. Where the noise is far above what joints repeat to, all of it beyond the usual repeatability lasts."""
    usual, sd = usual_noise(task.repeats)
    if is_restless(fit.noise.joints):
        beyond = fit.noise.joints**2 - (usual * np.exp(sd * rng.normal(size=DRAWS))) ** 2 - each
        return np.asarray(found + np.maximum(beyond, 0.0)[:, None])
    further = rng.integers(FURTHER_LINES + 1, size=DRAWS) * sizes**2
    left = np.sqrt(np.maximum(fit.noise.joints**2 - each - further, 1e-3 * usual**2))
    weight = np.exp(-0.5 * (np.log(left / usual) / sd) ** 2)
    return np.asarray((found + further[:, None])[rng.choice(DRAWS, DRAWS, p=weight / weight.sum())])


def _ripple(q: Array, columns: Array, projection: Projection, y: Array, rng: np.random.Generator) -> tuple[Array, Array, Array]:
    """Draws (k, 6) of squared amplitudes rad^2, one wave a joint, and (k,) of their size rad; posterior (6, s) of it from the
    other joints."""
    scale = _scale(y, projection)
    y = y / scale
    lines = [_line(q[:, j], columns[:, j], projection, scale) for j in range(6)]
    sizes = BACKGROUND_SIZES[1:]
    means, waves = np.zeros((6, len(sizes), len(y))), {}
    for _ in range(SWEEPS):
        for j, line in enumerate(lines):
            waves[j] = _waves(line, y - means.sum(axis=0) + means[j], sizes)
            means[j] = line.explained(waves[j])
    draws = np.zeros((len(BACKGROUND_SIZES), DRAWS, 6))
    for k, j in np.ndindex(len(sizes), 6):
        draws[k + 1, :, j] = _amplitudes(waves[j], k, rng)
    each = np.vstack([np.zeros(6), _evidence(lines, means, y, sizes)])
    pick = rng.choice(len(BACKGROUND_SIZES), DRAWS, p=_weights(each.sum(axis=1)))
    # Large sizes are no likelier before any reading where a name is at stake: they would take its place.
    others = np.array([_weights(each.sum(axis=1) - each[:, j], even=False) for j in range(6)])
    return draws[pick, np.arange(DRAWS)], BACKGROUND_SIZES[pick], others


def _line(q: Array, column: Array, projection: Projection, scale: float) -> _Line:
    """Waves of every order of a joint with angles q (r,) and whitened column (3 r,), per rad of amplitude. A reading's three
    rows have one wave: they are put together before the orders are."""
    phase = np.outer(q, ORDERS)
    waves, column = np.hstack([np.cos(phase), np.sin(phase)]), column.reshape(-1, 3) / scale
    c, s = np.hsplit(waves, 2)
    weight = (column**2).sum(axis=1)
    plain = np.stack([weight @ (c * c), weight @ (s * s), weight @ (c * s)])
    inner = np.einsum("ncr,nc->rn", projection.U.reshape(len(q), 3, -1), column) @ waves
    c, s = np.hsplit(inner, 2)
    take = projection.take * (2.0 - projection.take)  # of the projection used twice
    return _Line(waves, column, projection, plain - np.stack([take @ (c * c), take @ (s * s), take @ (c * s)]))


def _waves(line: _Line, y: Array, sizes: Array) -> _Waves:
    """Of rows y (s, N) left for waves of each size (s,) rad."""
    b = line.met(y)
    more = sizes[:, None] ** -2
    p, q, r = line.G[0] + more, line.G[1] + more, line.G[2]
    det = p * q - r * r
    V = np.stack([q / det, p / det, -r / det], axis=1)
    mean = np.stack([V[:, 0] * b[:, 0] + V[:, 2] * b[:, 1], V[:, 2] * b[:, 0] + V[:, 1] * b[:, 1]], axis=1)
    log = 0.5 * (b * mean).sum(axis=1) - 0.5 * np.log(det * sizes[:, None] ** 4)
    total = np.asarray(logsumexp(log, axis=1))
    return _Waves(total - np.log(len(ORDERS)), np.exp(log - total[:, None]), mean, V)


def _evidence(lines: list[_Line], means: Array, y: Array, sizes: Array) -> Array:
    """Log evidence (s, 6) of the six waves over none, one joint after the other, the largest first."""
    found, rest = np.zeros((len(sizes), len(lines))), np.tile(y, (len(sizes), 1))
    order = np.argsort(-(means**2).sum(axis=2), axis=0)
    for joints in order:
        for j in np.unique(joints):
            rows = np.flatnonzero(joints == j)
            waves = _waves(lines[j], rest[rows], sizes[rows])
            found[rows, j] = waves.log
            rest[rows] -= lines[j].explained(waves)
    return found


def _amplitudes(waves: _Waves, k: int, rng: np.random.Generator) -> Array:
    """Draws of the squared amplitude rad^2 of size k."""
    weight, mean, V = waves.weight[k], waves.mean[k], waves.V[k]
    pick = rng.choice(len(weight), DRAWS, p=weight)
    one, other = rng.normal(size=(2, DRAWS))
    root = np.sqrt(V[0, pick])
    slope = V[2, pick] / root
    c = mean[0, pick] + root * one
    s = mean[1, pick] + slope * one + np.sqrt(np.maximum(V[1, pick] - slope**2, 0.0)) * other
    return np.asarray(c**2 + s**2)
