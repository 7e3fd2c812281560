"""How large an effect must be to be named: the size at which its evidence beats 'no gap' in nine data sets of ten.

At detectability lambda the quadratic form b^T G^-1 b that m coefficients gain is noncentral chi-square distributed; its tenth
percentile x(lambda) puts the log evidence (docs/diagnosis.md, eq. 4, noise scale known, g: mean square of a column) at

    log Z = log mean_t [(1 + t^2 g)^(-m/2) exp(x t^2 g / (1 + t^2 g) / 2)] - log V                                        (8)

and the effect is named where log Z and its prior odds outweigh none and what the background would make of the same gap.
"""

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from scipy.special import chndtrix

from ocp.diagnose.rules import MISSED
from robots.pose import Array

_LAMBDA = np.geomspace(3.0, 400.0, 500)
NONE: Array = np.zeros(0)


@dataclass(frozen=True)
class Rival:
    """A family of the background that can take an effect's gap: prior sizes (T,) as shares of the upper end, log prior odds,
    coefficients that it pays for beside the effect's own, variants."""

    sizes: Array
    log_odds: float
    beside: int
    variants: int


def visible_lambda(
    energy: float,
    coefficients: int,
    sizes: Array,
    log_odds: float,
    variants: int,
    positive: int = 0,
    rival: Rival | None = None,
    beside: Array | None = None,
) -> float:
    """Detectability lambda from which an effect is named nine times of ten; inf above 400.

    energy: mean square g of its columns at the upper end; sizes (T,) and log_odds of its prior; variants that were scanned;
    positive: coefficients that physics holds positive; beside (k,): mean squares of what else the rival has (default: as many
    as its `beside` says, each like the effect's own). What these readings hardly show costs a rival nothing.
    """
    gain = _percentile(coefficients)
    log = _evidence(gain, energy, coefficients, sizes) - np.log(variants) + log_odds + positive * np.log(2.0)
    against = np.zeros_like(gain)
    if rival is not None:
        others = np.full(rival.beside, energy) if beside is None else beside
        taken = _evidence(gain, energy, coefficients, rival.sizes, others) - np.log(rival.variants)
        against = np.logaddexp(0.0, taken + rival.log_odds)
    named = np.flatnonzero(log > against)
    return float(_LAMBDA[named[0]]) if len(named) else np.inf


@lru_cache
def _percentile(coefficients: int) -> Array:
    """Gain (k,) that an effect of each detectability reaches nine times of ten."""
    return np.asarray(chndtrix(MISSED, coefficients, _LAMBDA))


def _evidence(gain: Array, energy: float, coefficients: int, sizes: Array, beside: Array = NONE) -> Array:
    """Log evidence of gains (k,) averaged over prior sizes; beside: mean squares of coefficients whose spread is paid for too."""
    square = np.asarray(sizes)[:, None] ** 2
    spread = square * energy
    each = -0.5 * coefficients * np.log1p(spread) + 0.5 * gain * spread / (1.0 + spread)
    each = each - 0.5 * np.log1p(square * beside).sum(axis=1, keepdims=True)
    return np.asarray(np.logaddexp.reduce(each, axis=0) - np.log(len(sizes)))
