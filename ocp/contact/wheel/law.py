"""The wheel's law: indentation under a force on any quadratic blade shape, smooth, for CasADi and for NumPy.

d = offset + p (polynomial in the features) + baseline; every symbol in docs/wheel.md, eq. 5-8. The two evaluations
share no code but the strips' places, so that each checks the other.

Seven inputs become four numbers and a baseline, translation, scaling and symmetry used exactly: the quadratic gap is moved to
the middle of the wheel and to its ridge along x (exact: the cover is the same everywhere along x); what is left is (curvature
across the ridge, along it, shear, slope). Forces and shapes scale together (exact: elasticity is linear). The baseline is a row
of strips with an exponential law.
"""

from dataclasses import dataclass
from typing import Any

import casadi as ca
import numpy as np

from ocp.contact.wheel.cover import WheelGeometry
from robots.pose import Array

# Strips over the width: STRIPS_A_LENGTH for each patch length sqrt(d / across) at the process force, within these bounds.
STRIPS_A_LENGTH, LEAST_STRIPS, MOST_STRIPS = 2.4, 15, 53
# Strips crowd a little towards the edges of the wheel, where hollow blades bear: y + CROWDING sin(pi y) / pi.
CROWDING = 0.3
N_FEATURES = 5
ROUND = 0.05  # of the decay where the force bends over, by which the two edges of the wheel are rounded into each other at touch


@dataclass(frozen=True)
class Reduced:
    """Quadratic gaps (n,) at the middle of the wheel and the ridge, the lowest line of the gap: curvature `across` it and
    along the width on it (`ridge`) 1/m, `shear` kxy/kxx, `slope` of the ridge; `offset` m to add to the indentation."""

    across: Array
    ridge: Array
    shear: Array
    slope: Array
    offset: Array


def reduce_shape(kxx: Array, kyy: Array, kxy: Array, lateral: Array, tilt_x: Array, tilt_y: Array) -> Reduced:
    """Complete the square along x and move the origin to the middle of the wheel; docs/wheel.md, eq. 5, 6."""
    shear = kxy / kxx
    ridge = kyy - shear * kxy
    lean = tilt_x - kxy * lateral
    slope = tilt_y - ridge * lateral - shear * tilt_x
    offset = 0.5 * kyy * lateral**2 - tilt_y * lateral - 0.5 * lean**2 / kxx
    return Reduced(kxx * (1.0 + shear**2), ridge, shear, slope, offset)


def strip_count(force: float, across: float, modulus: float, width: float) -> int:
    """How many strips resolve the patch of `force` N; odd, so that one lies in the middle."""
    length = np.cbrt(force / (modulus * across))
    wanted = np.clip(STRIPS_A_LENGTH * width / length, LEAST_STRIPS, MOST_STRIPS)
    return 2 * int(np.ceil(0.5 * (wanted - 1))) + 1


def strips(count: int) -> tuple[Array, Array]:
    """Places (count,) in half widths, both edges among them, and weights with sum 1."""
    y = np.linspace(-1.0, 1.0, count)
    y = y + CROWDING * np.sin(np.pi * y) / np.pi
    weight = np.gradient(y)
    return y, weight / weight.sum()


def force_scale(force: Array, across: Array, modulus: float) -> Array:
    """Indentation scale (F/E)^(2/3) across^(1/3), m: Hertz's, without its number."""
    return np.cbrt((force / modulus) ** 2 * across)


def strip_baseline(decay: Array, ridge: Array, slope: Array, width: float, count: int) -> tuple[Array, Array]:
    """Indentation -p ln(mean exp(-h/p)) (n,) m of strips with the law exp(d/p), and features (n, 3) of the load.

    decay (n,) p in m; h = slope y + ridge y^2 / 2. Features: log of the loaded share of the width, square of the load's
    mean place, its variance, in half widths.
    """
    y, weight = strips(count)
    at = 0.5 * width * y
    h = (slope[:, None] * at + 0.5 * ridge[:, None] * at**2) / decay[:, None]
    lowest = h.min(axis=1, keepdims=True)
    share = weight * np.exp(lowest - h)
    total = share.sum(axis=1, keepdims=True)
    share = share / total
    level = np.log(total[:, 0]) - lowest[:, 0]
    mean = share @ y
    features = np.column_stack([level + (share * h).sum(axis=1), mean**2, share @ y**2 - mean**2])
    return -decay * level, features


def first_touch(ridge: Array, slope: Array, width: float, rounded: Array) -> Array:
    """Least (n,) m of slope y + ridge y^2 / 2 over the width, where bodies that do not press meet; at a hollow's two edges, which
    change places where it does not lean, a hyperbola `rounded` (n,) m below their corner."""
    lean = np.hypot(0.5 * width * slope, rounded)
    sag = 0.125 * width**2 * ridge
    inside = 2 * sag > lean
    return np.where(inside, -0.25 * lean**2 / np.where(inside, sag, 1.0), sag - lean)


def all_features(force: Array, reduced: Reduced, decay: Array, modulus: float, width: float, count: int) -> tuple[Array, Array]:
    """Baseline (n,) m over `count` strips and the N_FEATURES numbers (n, 5) the correction depends on."""
    base, load = strip_baseline(decay, reduced.ridge, reduced.slope, width, count)
    stiff = np.log(force / (modulus * reduced.across * width**3))
    turned = reduced.shear**2 / (1.0 + reduced.shear**2)
    return base, np.column_stack([stiff, load, turned])


def exponents(degree: int, variables: int = N_FEATURES) -> Array:
    """Exponents (terms, variables) of all products up to total `degree`, the constant first."""
    grid = np.stack(np.meshgrid(*[np.arange(degree + 1)] * variables, indexing="ij"), axis=-1).reshape(-1, variables)
    return grid[grid.sum(axis=1) <= degree]


def chebyshev_products(u: Array, terms: Array) -> Array:
    """Products of Chebyshev polynomials (n, terms) at u (n, variables), each scaled to -1..1."""
    values = [np.ones_like(u), u]
    while len(values) <= terms.max():
        values.append(2 * u * values[-1] - values[-2])
    powers = np.stack(values)
    product = np.ones((len(u), len(terms)))
    for v in range(u.shape[1]):
        product *= powers[terms[:, v], :, v].T
    return product


@dataclass(frozen=True)
class WheelLaw:
    """Fitted law of one wheel; build it with `ocp.contact.wheel.law_fit.fit_wheel_law`.

    limits: ranges of force N, kxx 1/m, lateral m, tilt_x, tilt_y (slopes) for which it was made; error m: the largest on
    held-out direct solutions at the process force.
    decay: p over the force scale; count: strips. low, high (5,): ranges of the features; terms (k, 5), coefficients (k,):
    correction.
    """

    geometry: WheelGeometry
    process_force: float
    decay: float
    count: int
    low: Array
    high: Array
    terms: Array
    coefficients: Array
    limits: dict[str, tuple[float, float]]
    error: float

    def indentation(self, F: ca.SX, kxx: ca.SX, kyy: ca.SX, kxy: ca.SX, lateral: ca.SX, tilt_x: ca.SX, tilt_y: ca.SX) -> ca.SX:
        """Interference d (m) at the planned point under `F` >= 0 N; arguments scalar, as in docs/architecture.md.

        Exact derivatives, smooth for kxx above its limit; below it kxx is bent to stay positive so that an optimiser
        may pass through. Below the least force of the table it goes down with the root of the force to the lowest gap under the
        wheel's width, where it touches first.
        """
        g, least = self.geometry, 0.5 * self.limits["force"][0]  # it bends over below the table
        u = F / least
        asked, F = F, ca.if_else(u < 2, least * (1 + ca.fmax(u, 0) ** 3 * (4 - u) / 16), F)
        floor = 0.5 * self.limits["kxx"][0]
        kxx = ca.if_else(kxx > floor, kxx, floor * ca.exp(ca.fmin(kxx, floor) / floor - 1))
        shear = kxy / kxx
        ridge = kyy - shear * kxy
        lean = tilt_x - kxy * lateral
        slope = tilt_y - ridge * lateral - shear * tilt_x
        offset = 0.5 * kyy * lateral**2 - tilt_y * lateral - 0.5 * lean**2 / kxx
        across = kxx * (1 + shear**2)
        p = self.decay * ca.exp((2 * ca.log(F / g.modulus) + ca.log(across)) / 3)

        a, b = slope * (0.5 * g.width) / p, 0.5 * ridge * (0.5 * g.width) ** 2 / p
        full, mean, square = self._strip_load(a, b)
        bears = ca.if_else(u < 2, _rise(asked, least) / _rise(F, least), 1)
        steep = ca.sqrt(a**2 + ROUND**2)
        touch = ca.if_else(2 * b > steep, -(steep**2) / (4 * ca.fmax(b, 0.5 * steep)), b - steep)
        energy = a * mean + b * square
        stiff = ca.log(F / (g.modulus * across * g.width**3))
        features = [stiff, full + energy, mean**2, square - mean**2, shear**2 / (1 + shear**2)]
        return offset + p * (touch + bears * (self._correction(features) - full - touch))

    def _strip_load(self, a: ca.SX, b: ca.SX) -> tuple[ca.SX, ca.SX, ca.SX]:
        """Of strips with gaps a y + b y^2 in decays: log of the mean of exp(-gap); mean and mean square of the load's place."""
        places, weights = strips(self.count)
        # Any reference level gives the same sums; the lowest gap keeps every exponent in range. Its derivative cancels.
        steep = ca.fabs(a)
        reference = ca.if_else(2 * b > steep, -(a**2) / (ca.fmax(4 * b, 2 * steep) + 1e-9), b - steep)
        share = [w * ca.exp(reference - (a * y + b * y**2)) for w, y in zip(weights, places, strict=True)]
        total = sum(share)
        mean = sum(s * y for s, y in zip(share, places, strict=True)) / total
        square = sum(s * y**2 for s, y in zip(share, places, strict=True)) / total
        return ca.log(total) - reference, mean, square

    def _correction(self, features: list[ca.SX]) -> ca.SX:
        """The polynomial in Chebyshev products, factored variable by variable."""
        powers: list[list[ca.SX]] = []
        for v, feature in enumerate(features):
            u = (2 * feature - self.low[v] - self.high[v]) / (self.high[v] - self.low[v])
            chebyshev = [ca.SX(1), u]
            for _ in range(2, int(self.terms.max()) + 1):
                chebyshev.append(2 * u * chebyshev[-1] - chebyshev[-2])
            powers.append(chebyshev)
        return _nested(self.terms, self.coefficients, powers, 0)

    def evaluate(self, F: Array, kxx: Array, kyy: Array, kxy: Array, lateral: Array, tilt_x: Array, tilt_y: Array) -> Array:
        """`indentation` in NumPy for arrays (n,) that broadcast, m."""
        F, *shape = (np.atleast_1d(a) for a in np.broadcast_arrays(F, kxx, kyy, kxy, lateral, tilt_x, tilt_y))
        reduced = reduce_shape(*shape)
        g, least = self.geometry, 0.5 * self.limits["force"][0]  # it bends over below the table
        within = np.where(F < 2 * least, least * (1 + (F / least) ** 3 * (4 - F / least) / 16), F)
        p = self.decay * force_scale(within, reduced.across, g.modulus)
        base, features = all_features(within, reduced, p, g.modulus, g.width, self.count)
        correction = chebyshev_products(self._unit(features), self.terms) @ self.coefficients
        bears = _rise(F, least) / _rise(within, least)
        touch = first_touch(reduced.ridge, reduced.slope, g.width, ROUND * p)
        return reduced.offset + touch + bears * (base + p * correction - touch)

    def _unit(self, features: Array) -> Array:
        """Features scaled to -1..1 over the sampled ranges."""
        return (2 * features - self.low - self.high) / (self.high - self.low)


def _rise(F: Any, least: float) -> Any:
    """(F + e)^(1/2) - e^(1/2), e a hundredth of `least`: no infinite slope at F = 0; the root met direct solutions best."""
    e = 0.01 * least
    return (F + e) ** 0.5 - e**0.5


def _nested(terms: Array, coefficients: Array, powers: list[list[ca.SX]], variable: int) -> ca.SX:
    """Sum of coefficient times product of powers, factored variable by variable: about one multiplication a term."""
    if variable == len(powers):
        return ca.SX(float(coefficients.sum()))
    total = ca.SX(0)
    for e in np.unique(terms[:, variable]):
        chosen = terms[:, variable] == e
        total += powers[variable][e] * _nested(terms[chosen], coefficients[chosen], powers, variable + 1)
    return total
