"""Exact Gaussian evidence of effects: coefficients integrated over priors of several sizes, the noise's scale with them.

For columns C of an effect (projected, unit noise), coefficients a ~ N(0, t^2) in units of the prior's upper end, and data y,
with G = C^T C, b = C^T y:

    R(t) = y^T y - b^T (G + 1 / t^2)^-1 b                       what is left
    log Z(t) = -1/2 log det(1 + t^2 G) - (nu + nu0) / 2 log(nu0 + R)  + const          (docs/diagnosis.md, eqs. 4 and 5)

The noise model's scale is known only so well: its inverse variance has a gamma prior worth nu0 rows, integrated in closed
form (a Student-t evidence). Sizes t stand on a logarithmic grid between the lower and the upper end of the typical range,
which stands for log-uniform priors. Coefficients that physics holds positive have half-normal priors: a factor of twice
their posterior probability of being positive each (and a chance `WRONG_SIGN` of a sign or a mounting that is not as believed).
"""

import numpy as np
from scipy.special import stdtr

from ocp.diagnose.rules import NOISE_TRUST, WRONG_SIGN
from robots.pose import Array
from robots.tracker_readings import Index

SIZES = 4  # of the grid of prior widths


def size_grid(ratio: float) -> Array:
    """Prior widths (T,) as shares of the upper end, from `ratio` (lower over upper end) to 1."""
    return np.geomspace(float(np.clip(ratio, 0.01, 0.5)), 1.0, SIZES)


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


def _half(
    rows: Index, turned: Array, spread: Array, vectors: Array | None, positive: Array, rest: Array, freedom: float
) -> Array:
    """Log of twice the posterior probability (a Student t) that a coefficient held positive is, one by one; (rows, T)."""
    mean, variance = turned[rows][:, None, :] * spread[rows], spread[rows]
    if vectors is not None:
        mean = np.einsum("vik,vtk->vti", vectors[rows], mean)
        variance = np.einsum("vik,vtk->vti", vectors[rows] ** 2, variance)
    scale2 = (NOISE_TRUST + rest[rows]) / (NOISE_TRUST + freedom)
    right = stdtr(freedom + NOISE_TRUST, mean / np.sqrt(variance * scale2[..., None]))
    each = np.log(WRONG_SIGN + 2.0 * (1.0 - WRONG_SIGN) * right)
    return np.asarray(np.where(positive[rows][:, None, :], each, 0.0).sum(axis=2))


def coefficients_given(C: Array, y: Array, prior_sd: Array) -> tuple[Array, Array]:
    """Mean (m,) and covariance (m, m) of coefficients with prior sd (m,), of columns C (N, m) with unit noise; by SVD."""
    U, s, Vt = np.linalg.svd(C * prior_sd, full_matrices=False)
    V = prior_sd[:, None] * Vt.T
    mean = V @ (s / (1.0 + s**2) * (U.T @ y))
    covariance = np.diag(prior_sd**2) - (V * (s**2 / (1.0 + s**2))) @ V.T
    return np.asarray(mean), np.asarray(covariance)
