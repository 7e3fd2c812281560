"""What readings say of columns, exactly: the nuisance projected out, coefficients integrated, and what size is seen.

**Projected out**: geometry, frames and springs are free to follow. With unit noise, nuisance columns A of prior sd s_k and
residual y about the prior's mean, y ~ N(A m, 1 + A S A^T): with the singular values sigma of A S^1/2 and its left vectors U
the symmetric root of the inverse covariance is

    M = 1 - U diag(1 - 1 / sqrt(1 + sigma^2)) U^T        (free unknowns: sigma infinite, taken out altogether)

so that M y is white and |M C a|^2 is the detectability lambda of columns C with coefficients a (docs/diagnosis.md, eq. 2).
Nothing is inverted: a covariance inverted without its singular values ruined the intervals of a prototype.

**Integrated** over priors of several sizes, the noise's scale with them. For columns C of an effect (projected, unit noise),
coefficients a ~ N(0, t^2) in units of the prior's upper end, and data y, with G = C^T C, b = C^T y:

    R(t) = y^T y - b^T (G + 1 / t^2)^-1 b                       what is left
    log Z(t) = -1/2 log det(1 + t^2 G) - (nu + nu0) / 2 log(nu0 + R)  + const          (docs/diagnosis.md, eqs. 3 and 4)

The noise model's scale is known only so well: its inverse variance has a gamma prior worth nu0 rows, integrated in closed
form (a Student-t evidence). Sizes t stand on a logarithmic grid up to the upper end of the typical range, from its lower end
on or, where readings show it, from less, which stands for log-uniform priors. Coefficients that physics holds positive have
half-normal priors: a factor of twice their posterior probability of being positive each (and a chance `WRONG_SIGN` of a sign or
a mounting that is not as believed).

**Seen**: the size at which an effect's evidence beats 'no gap' in nine data sets of ten. At detectability lambda the
quadratic form b^T G^-1 b that m coefficients gain is noncentral chi-square distributed; its tenth percentile x(lambda) puts
the log evidence (eq. 4, noise scale known, g: mean square of a column) at

    log Z = log mean_t [(1 + t^2 g)^(-m/2) exp(x t^2 g / (1 + t^2 g) / 2)] - log V                                        (8)

and the effect is named where log Z and its prior odds outweigh none and what the background would make of the same gap.
"""

from dataclasses import dataclass
from functools import lru_cache
from itertools import pairwise

import numpy as np
from scipy.special import chndtrix, gammaln, stdtr

from ocp.diagnose.engine.channel_system import Channel, System
from ocp.diagnose.rules import MISSED, NOISE_TRUST, TAILS, TAILS_TOLD, WRONG_SIGN
from robots.pose import Array, Index

TAIL_STEPS = 8  # of the scale of tails: what is left of its error is in every set alike
RANK = 1e-10  # singular values below this share of the largest are no direction of their own


@dataclass(frozen=True)
class Projection:
    """M as U (N, r) and what it takes of each direction (r,): 1 for free ones; free: how many are."""

    U: Array
    take: Array
    free: int

    def apply(self, rows: Array) -> Array:
        """M rows, rows (N,) or (N, m)."""
        inner = self.U.T @ rows
        taken = self.U @ (self.take * inner if rows.ndim == 1 else self.take[:, None] * inner)
        return np.subtract(rows, taken, out=taken)


def project(columns: Array, prior_sd: Array) -> Projection:
    """Projection of columns (N, p) with prior sd (p,), infinite where free."""
    free = ~np.isfinite(prior_sd)
    parts, takes, count = [], [], 0
    rest = columns[:, ~free] * prior_sd[~free]
    if free.any():
        loose = columns[:, free]
        size = np.linalg.norm(loose, axis=0)
        U, s, _ = np.linalg.svd(loose / np.where(size > 0, size, 1.0), full_matrices=False)
        U = U[:, s > RANK * max(s[0], 1e-300)] if len(s) else U
        count = U.shape[1]
        parts.append(U)
        takes.append(np.ones(count))
        rest = rest - U @ (U.T @ rest)
    if rest.shape[1]:
        U, s, _ = np.linalg.svd(rest, full_matrices=False)
        keep = s > 1e-6
        parts.append(U[:, keep])
        takes.append(1.0 - 1.0 / np.sqrt(1.0 + s[keep] ** 2))
    if not parts:
        return Projection(np.zeros((len(columns), 0)), np.zeros(0), 0)
    return Projection(np.hstack(parts), np.concatenate(takes), count)


def about_prior(system: System) -> Array:
    """Residual (N,) about the prior's mean of the nuisance instead of the estimate, to first order."""
    known = np.isfinite(system.prior_sd)
    return np.asarray(system.residual + system.nuisance[:, known] @ system.offset[known])


@dataclass(frozen=True)
class Tails:
    """Rows of readings whose errors as a whole may follow Student's t: which rows, and (n,) where each reading's begin."""

    rows: slice
    starts: Index

    def gain(self, rest: Array) -> float:
        """By how much more likely what is left (N,) is by Student's t than by a normal law, each of the scale that suits it best;
        zero where the normal law suits it as well (Lange, Little and Taylor 1989, eq. 1)."""
        squared = np.add.reduceat(rest[self.rows] ** 2, self.starts)
        n, k, nu = len(squared), (self.rows.stop - self.rows.start) / len(squared), TAILS[:, None]
        normal = max(float(squared.mean()) / k, 1e-12)
        scale2 = np.full_like(nu, normal)
        for _ in range(TAIL_STEPS):
            scale2 = ((nu + k) / (nu + squared / scale2)) @ squared[:, None] / (k * n)
        spread = 0.5 * (TAILS + k) * np.log1p(squared / (nu * scale2)).sum(axis=1)
        each = gammaln(0.5 * (TAILS + k)) - gammaln(0.5 * TAILS) - 0.5 * k * np.log(0.5 * TAILS * scale2[:, 0] / normal)
        return max(float(np.max(n * (each + 0.5 * k) - spread)) - TAILS_TOLD, 0.0)


@dataclass(frozen=True)
class Stack:
    """Channels one below the other: projections and row blocks; y (N,): white under 'no effect'; freedom: squares that noise
    alone leaves, rows less free nuisance and what picked rows have more; active effects' columns are put back into y (about
    zero coefficients); tails: channels whose readings may have some."""

    projections: tuple[Projection, ...]
    blocks: tuple[slice, ...]
    y: Array
    freedom: int
    tails: tuple[Tails, ...] = ()

    def apply(self, columns: Array) -> Array:
        """M columns, columns (N, m) of all channels."""
        own = [p.apply(columns[b]) for p, b in zip(self.projections, self.blocks, strict=True)]
        return own[0] if len(own) == 1 else np.concatenate(own)


def stack(channels: tuple[Channel, ...], put_back: Array) -> Stack:
    """Stack of the channels' systems; put_back (N,): what the active effects add to the predictions, to be explained
    again."""
    systems = [c.system for c in channels]
    blocks = tuple(slice(a, b) for a, b in pairwise(np.cumsum([0, *(len(s.residual) for s in systems)]).tolist()))
    projections = tuple(project(s.nuisance, s.prior_sd) for s in systems)
    y = np.concatenate([p.apply(about_prior(s) + put_back[b]) for p, s, b in zip(projections, systems, blocks, strict=True)])
    tailed = [(b, s.reading) for b, s in zip(blocks, systems, strict=True) if s.tailed]
    tails = tuple(Tails(b, np.flatnonzero(np.diff(reading, prepend=-1)).astype(np.int64)) for b, reading in tailed)
    freedom = len(y) - sum(p.free for p in projections) + round(sum(s.picked for s in systems))
    return Stack(projections, blocks, y, freedom, tails)


SIZES = 4  # of the grid of prior widths


def size_grid(ratio: float) -> Array:
    """Prior widths (T,) as shares of the upper end, from `ratio` (lower over upper end) to 1."""
    return np.asarray(np.geomspace(float(np.clip(ratio, 0.01, 0.5)), 1.0, SIZES))


def log_evidence(G: Array, b: Array, sizes: Array, positive: Array, left: float, freedom: float) -> Array:
    """Log evidence (V, T) of V variants at T sizes over what is given.

    G (V, m, m), b (V, m); sizes (V, T) shares of the upper end; positive (V, m) coefficients held positive; left: y^T y now;
    freedom: rows of y less free nuisance.
    """
    if G.shape[1] == 2 and not positive.any():
        return _of_two(G, b, sizes, left, freedom)
    if G.shape[1] == 1:
        values, turned, vectors = np.maximum(G[:, :, 0], 0.0), b, None  # what is given may leave less than rounding
    else:
        values, vectors = np.linalg.eigh(G)
        values = np.maximum(values, 0.0)
        turned = np.einsum("vik,vi->vk", vectors, b)
    t2 = sizes[:, :, None] ** 2
    spread = t2 / (1.0 + t2 * values[:, None, :])  # posterior variances along the eigenvectors (V, T, m)
    gained = (turned[:, None, :] ** 2 * spread).sum(axis=2)
    rest = np.maximum(left - gained, 1e-9)
    log = -0.5 * np.log1p(t2 * values[:, None, :]).sum(axis=2)
    log -= 0.5 * (freedom + NOISE_TRUST) * np.log((NOISE_TRUST + rest) / (NOISE_TRUST + left))
    held = np.flatnonzero(positive.any(axis=1))
    if len(held):
        log[held] += _half(held, turned, spread, vectors, positive, rest, freedom)
    return np.asarray(log)


def _of_two(G: Array, b: Array, sizes: Array, left: float, freedom: float) -> Array:
    """As `log_evidence` for two coefficients, without eigenvalues: waves of every order are most of all variants."""
    t2 = sizes**2
    p, r = t2 * G[:, None, 0, 0] + 1.0, t2 * G[:, None, 1, 1] + 1.0
    q = t2 * G[:, None, 0, 1]
    det = np.maximum(p * r - q * q, 1.0)
    gained = t2 * (r * b[:, None, 0] ** 2 - 2 * q * b[:, None, 0] * b[:, None, 1] + p * b[:, None, 1] ** 2) / det
    rest = np.maximum(left - gained, 1e-9)
    return np.asarray(-0.5 * np.log(det) - 0.5 * (freedom + NOISE_TRUST) * np.log((NOISE_TRUST + rest) / (NOISE_TRUST + left)))


def _half(k: Index, turned: Array, spread: Array, vectors: Array | None, positive: Array, rest: Array, freedom: float) -> Array:
    """Log of twice the posterior probability (a Student t) that a coefficient held positive is, one by one; of rows k, (k, T)."""
    mean, variance = turned[k][:, None, :] * spread[k], spread[k]
    if vectors is not None:
        mean = np.einsum("vik,vtk->vti", vectors[k], mean)
        variance = np.einsum("vik,vtk->vti", vectors[k] ** 2, variance)
    scale2 = (NOISE_TRUST + rest[k]) / (NOISE_TRUST + freedom)
    right = stdtr(freedom + NOISE_TRUST, mean / np.sqrt(variance * scale2[..., None]))
    each = np.log(WRONG_SIGN + 2.0 * (1.0 - WRONG_SIGN) * right)
    return np.asarray(np.where(positive[k][:, None, :], each, 0.0).sum(axis=2))


_LAMBDA = np.geomspace(3.0, 400.0, 500)
NONE: Array = np.zeros(0)


@dataclass(frozen=True)
class Rival:
    """A family of the background that can take an effect's gap: prior sizes (T,) as shares of the upper end, log prior odds of
    each variant, coefficients that it pays for beside the effect's own."""

    sizes: Array
    log_odds: float
    beside: int


def visible_lambda(
    energy: float, coefficients: int, sizes: Array, log_odds: float, rival: Rival | None = None, beside: Array | None = None
) -> float:
    """Detectability lambda from which an effect is named nine times of ten; inf above 400.

    energy: mean square g of its columns at the upper end; sizes (T,) and log_odds of its prior, of each variant; beside (k,):
    mean squares of what else the rival has (default: as many as its `beside` says, each like the effect's own). What these
    readings hardly show costs a rival nothing.
    """
    gain = _percentile(coefficients)
    log = _mean_evidence(gain, energy, coefficients, sizes) + log_odds
    against = np.zeros_like(gain)
    if rival is not None:
        others = np.full(rival.beside, energy) if beside is None else beside
        against = np.logaddexp(0.0, _mean_evidence(gain, energy, coefficients, rival.sizes, others) + rival.log_odds)
    named = np.flatnonzero(log > against)
    return float(_LAMBDA[named[0]]) if len(named) else np.inf


@lru_cache
def _percentile(coefficients: int) -> Array:
    """Gain (k,) that an effect of each detectability reaches nine times of ten."""
    return np.asarray(chndtrix(MISSED, coefficients, _LAMBDA))


def _mean_evidence(gain: Array, energy: float, coefficients: int, sizes: Array, beside: Array = NONE) -> Array:
    """Log evidence of gains (k,) averaged over prior sizes; beside: mean squares of coefficients whose spread is paid for too."""
    square = np.asarray(sizes)[:, None] ** 2
    spread = square * energy
    each = -0.5 * coefficients * np.log1p(spread) + 0.5 * gain * spread / (1.0 + spread)
    each = each - 0.5 * np.log1p(square * beside).sum(axis=1, keepdims=True)
    return np.asarray(np.logaddexp.reduce(each, axis=0) - np.log(len(sizes)))
