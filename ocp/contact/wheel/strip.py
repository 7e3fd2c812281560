"""From the wheel's seven inputs to four numbers and a baseline: translation, scaling and symmetry used exactly.

The quadratic gap is moved to the middle of the wheel and to its ridge along x (exact: the cover is the same everywhere
along x); what is left is (curvature across the ridge, along it, shear, slope). Forces and shapes scale together (exact:
elasticity is linear). The strip_baseline is a row of strips with an exponential law. NumPy only; docs/wheel.md, eq. 5-8.
"""

from dataclasses import dataclass

import numpy as np

from robots.pose import Array

# Strips over the width: STRIPS_A_LENGTH for each patch length sqrt(d / across) at the process force, within these bounds.
STRIPS_A_LENGTH, LEAST_STRIPS, MOST_STRIPS = 2.4, 15, 53
# Strips crowd a little towards the edges of the wheel, where hollow blades bear: y + CROWDING sin(pi y) / pi.
CROWDING = 0.3
N_FEATURES = 5


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
