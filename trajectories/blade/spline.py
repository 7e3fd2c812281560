"""Bicubic smoothing spline surfaces through scattered points, and what differential geometry says of them."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike
from scipy import sparse
from scipy.interpolate import BSpline, NdBSpline
from scipy.sparse.linalg import splu

from robots.pose import Array

_DEGREE = 3


@dataclass(frozen=True)
class SplineSurface:
    """x(u, v) = sum B_i(u) B_j(v) c_ij: knots (with fourfold ends) and coefficients (nu, nv, 3) m."""

    knots_u: Array
    knots_v: Array
    coefficients: Array

    def __call__(self, u: ArrayLike, v: ArrayLike, du: int = 0, dv: int = 0) -> Array:
        """Points, or mixed derivatives of order (du, dv), (..., 3); outside the knots the end pieces go on."""
        spline = NdBSpline((self.knots_u, self.knots_v), self.coefficients, _DEGREE, extrapolate=True)
        at = np.stack(np.broadcast_arrays(np.asarray(u, float), np.asarray(v, float)), axis=-1)
        return np.asarray(spline(at, nu=(du, dv)))


def clamped_knots(breaks: Array) -> Array:
    """Knot vector with fourfold ends over the given increasing breaks."""
    return np.concatenate([[breaks[0]] * _DEGREE, breaks, [breaks[-1]] * _DEGREE])


def fit_surface(
    u: Array, v: Array, points: Array, weights: Array, knots: tuple[Array, Array], lengths: tuple[float, float], smoothing: float
) -> SplineSurface:
    """Least squares with a bending penalty: minimise mean w |x - p|^2 + mean l^4 |second derivatives|^2.

    u, v (n,) parameters of points (n, 3) m; weights (n,); lengths: metres per unit of u and of v. l = smoothing times
    the length of the spline piece; a wave of wave number q is damped by 1 / (1 + (l q)^4). O'Sullivan 1986, eq. 2.
    """
    rows = _rowwise_product(_design(knots[0], u), _design(knots[1], v))
    w = weights / weights.sum()
    normal = rows.T @ sparse.diags(w) @ rows
    system = (normal + _bending(knots, lengths, smoothing)).tocsc()
    # A whisper of ridge keeps the system definite where a corner has no data at all.
    system = system + sparse.eye(system.shape[0], format="csc") * (1e-13 * system.diagonal().max())
    coefficients = splu(system).solve(np.asarray(rows.T @ (w[:, None] * points)))
    shape = (len(knots[0]) - _DEGREE - 1, len(knots[1]) - _DEGREE - 1, 3)
    return SplineSurface(knots[0], knots[1], coefficients.reshape(shape))


def _design(knots: Array, x: Array, order: int = 0) -> sparse.csr_array:
    """Matrix of basis functions (or a derivative) at x, (n, number of coefficients)."""
    x = np.clip(x, knots[_DEGREE], knots[-_DEGREE - 1])
    if order == 0:
        return BSpline.design_matrix(x, knots, _DEGREE)
    n = len(knots) - _DEGREE - 1
    return sparse.csr_array(BSpline(knots, np.eye(n), _DEGREE).derivative(order)(x))


def _rowwise_product(a: sparse.csr_array, b: sparse.csr_array) -> sparse.csr_array:
    """Row-wise Kronecker product of two design matrices with four entries a row."""
    k = _DEGREE + 1
    ia, ib = a.indices.reshape(-1, k, 1), b.indices.reshape(-1, 1, k)
    columns = (ia * b.shape[1] + ib).reshape(-1)
    values = (a.data.reshape(-1, k, 1) * b.data.reshape(-1, 1, k)).reshape(-1)
    pointer = np.arange(a.shape[0] + 1) * k * k
    return sparse.csr_array((values, columns, pointer), shape=(a.shape[0], a.shape[1] * b.shape[1]))


def _bending(knots: tuple[Array, Array], lengths: tuple[float, float], smoothing: float) -> sparse.csr_array:
    """Mean over the patch of l_u^4 x_uu^2 + 2 l_u^2 l_v^2 x_uv^2 + l_v^4 x_vv^2 as a quadratic form."""
    gram = []
    for t, length in zip(knots, lengths, strict=True):
        breaks = np.unique(t)
        nodes, w = np.polynomial.legendre.leggauss(4)
        size = np.diff(breaks)[:, None]
        x = (0.5 * size * (nodes + 1.0) + breaks[:-1, None]).ravel()
        weight = (0.5 * size * w).ravel() / (breaks[-1] - breaks[0])
        local = np.repeat(smoothing * size[:, 0] * length, 4)
        bases = [_design(t, x, order) for order in range(3)]
        gram.append([m.T @ sparse.diags(weight * (local / length) ** (2 * k)) @ m for k, m in enumerate(bases)])
    (u0, u1, u2), (v0, v1, v2) = gram
    return sparse.csr_array(sparse.kron(u2, v0) + 2.0 * sparse.kron(u1, v1) + sparse.kron(u0, v2))


def curvature_in_frame(surface: SplineSurface, u: Array, v: Array, n: Array, t: Array) -> Array:
    """k_tt, k_bb, k_tb (m, 3) in 1/m with b = n x t; positive where the surface bends away from n (convex).

    In the tangent basis (x_u, x_v) the second fundamental form is h = (x_uu.n, x_uv.n, x_vv.n); a tangent vector
    with parameters d has z = h(d, d)/2, hence k = -h of the frame's parameters (do Carmo 1976, section 3-3).
    """
    xu, xv = surface(u, v, 1, 0), surface(u, v, 0, 1)
    h = np.empty((len(xu), 2, 2))
    for i, j, du, dv in ((0, 0, 2, 0), (0, 1, 1, 1), (1, 1, 0, 2)):
        h[:, i, j] = h[:, j, i] = np.einsum("ni,ni->n", surface(u, v, du, dv), n)
    jacobian = np.stack([xu, xv], axis=2)
    frame = np.stack([t, np.cross(n, t)], axis=2)
    d = np.linalg.pinv(jacobian) @ frame
    k = -np.swapaxes(d, 1, 2) @ h @ d
    return np.stack([k[:, 0, 0], k[:, 1, 1], k[:, 0, 1]], axis=1)


def nearest_parameters(surface: SplineSurface, points: Array, u: Array, v: Array, iterations: int = 8) -> tuple[Array, Array]:
    """Parameters (n,), (n,) of the foot points nearest to points (n, 3), by Gauss-Newton from the guess u, v."""
    u, v = u.copy(), v.copy()
    span_u = surface.knots_u[-1] - surface.knots_u[0]
    span_v = surface.knots_v[-1] - surface.knots_v[0]
    for _ in range(iterations):
        gap = points - surface(u, v)
        xu, xv = surface(u, v, 1, 0), surface(u, v, 0, 1)
        e, f, g = (np.einsum("ni,ni->n", a, b) for a, b in ((xu, xu), (xu, xv), (xv, xv)))
        ru, rv = np.einsum("ni,ni->n", gap, xu), np.einsum("ni,ni->n", gap, xv)
        det = np.maximum(e * g - f * f, 1e-30)
        du, dv = (g * ru - f * rv) / det, (e * rv - f * ru) / det
        u = np.clip(u + np.clip(du, -0.1 * span_u, 0.1 * span_u), surface.knots_u[0], surface.knots_u[-1])
        v = np.clip(v + np.clip(dv, -0.1 * span_v, 0.1 * span_v), surface.knots_v[0], surface.knots_v[-1])
        if max(np.abs(du).max(initial=0.0) / span_u, np.abs(dv).max(initial=0.0) / span_v) < 1e-9:
            break
    return u, v
