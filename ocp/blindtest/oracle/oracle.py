"""The oracle: it knows every signature, the true covariance of the readings and which readings are gross; the ceiling.

Evidence of a family with columns C (white), coefficients of prior width t times the upper end u, averaged over variants and t:

    log Z(t) = -1/2 log det(1 + t^2 G) + 1/2 b^T (G + 1 / t^2)^-1 b,     G = u C^T C u,  b = u C^T y

What it is asked about is linear: y = W (d + A x + noise), noise that of the world's own readings, x drawn anew from P.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.special import log_ndtr, logsumexp

from ocp.blindtest.oracle.detectability import Whitener
from ocp.blindtest.oracle.signatures import Family
from ocp.simulate.twin.truth.planting import Planted, kinds
from robots.pose import Array

SIZES = np.geomspace(0.01, 1.0, 6)  # of the usual upper end
THRESHOLD = (10.5, 12.7, 14.2)  # lambda that tells a signature of 1, 2, 3 parameters from zero (DIAGNOSIS, method 5)
MORE = 1.3  # for each further parameter
MOST = 4
Name = tuple[str, int]


@dataclass(frozen=True, eq=False)
class White:
    """Families with white columns (N, V, m) per upper end, and their Gram matrices (V, m, m)."""

    names: tuple[Name, ...]
    columns: tuple[Array, ...]
    grams: tuple[Array, ...]
    positive: tuple[bool, ...]

    def without(self, effects: Sequence[str]) -> "White":
        """Less the families of these effects."""
        keep = [k for k, (effect, _) in enumerate(self.names) if effect not in effects]
        columns, grams = (tuple(part[k] for k in keep) for part in (self.columns, self.grams))
        return White(tuple(self.names[k] for k in keep), columns, grams, tuple(self.positive[k] for k in keep))


@dataclass(frozen=True, eq=False)
class Seen:
    """A world as the oracle sees it: library, white readings y (N,), white signature (N,) of each planted effect given the
    others, the smallest size of each that would be seen, as a share of its usual upper end."""

    library: White
    y: Array
    alone: tuple[Array, ...]
    smallest: tuple[float | None, ...]


def whitened(found: Sequence[Family], white: Whitener) -> White:
    """Families as white noise sees them."""
    columns = tuple(white.apply(f.columns * f.upper) for f in found)
    return White(tuple(f.name for f in found), columns, _grams(columns), tuple(f.positive for f in found))


def _grams(columns: Sequence[Array]) -> tuple[Array, ...]:
    return tuple(np.einsum("nvi,nvj->vij", C, C) for C in columns)


def evidence(library: White, y: Array) -> Array:
    """Log evidence (families,) over no effect."""
    found = []
    for C, G, positive in zip(library.columns, library.grams, library.positive, strict=True):
        b = np.einsum("nvi,n->vi", C, y)
        values, vectors = np.linalg.eigh(G)
        turned = np.einsum("vik,vi->vk", vectors, b)[:, None]
        t2 = SIZES[None, :, None] ** 2
        spread = t2 / (1 + t2 * np.maximum(values, 0.0)[:, None])
        log = 0.5 * (turned**2 * spread - np.log1p(t2 * np.maximum(values, 0.0)[:, None])).sum(axis=2)
        if positive and C.shape[2] == 1:
            log = log + np.log(2.0) + log_ndtr((b[:, None] * spread / np.sqrt(spread))[..., 0])
        found.append(logsumexp(log) - np.log(log.size))
    return np.array(found)


def prior(library: White) -> Array:
    """Log prior odds (families,): every effect alike, then every joint of it, one effect expected."""
    effects = [effect for effect, _ in library.names]
    return np.array([-np.log(len(set(effects))) - np.log(effects.count(e)) for e in effects])


def ranked(library: White, y: Array) -> list[Name]:
    """Names by posterior weight as the only effect."""
    order = np.argsort(-(evidence(library, y) + prior(library)))
    return [library.names[k] for k in order]


def chosen(library: White, y: Array, most: int = MOST) -> list[Name]:
    """Names of the set that grows while its posterior weight does."""
    names: list[Name] = []
    columns = library.columns
    for _ in range(most):
        now = White(library.names, columns, _grams(columns), library.positive)
        gain = evidence(now, y) + prior(library)
        gain[[library.names.index(n) for n in names]] = -np.inf
        best = int(np.argmax(gain))
        if gain[best] <= 0:
            break
        names.append(library.names[best])
        b = np.einsum("nvi,n->vi", columns[best], y)
        taken = np.einsum("vi,vi->v", b, np.linalg.solve(now.grams[best] + np.eye(b.shape[1]), b[..., None])[..., 0])
        U, s, _ = np.linalg.svd(columns[best][:, int(np.argmax(taken))], full_matrices=False)
        shrink = (1.0 - 1.0 / np.sqrt(1.0 + s**2))[:, None]
        y = y - U @ (shrink[:, 0] * (U.T @ y))
        flat = [C.reshape(len(y), -1) for C in columns]
        columns = tuple((F - U @ (shrink * (U.T @ F))).reshape(C.shape) for F, C in zip(flat, columns, strict=True))
    return names


def left_by(library: White, signature: Array) -> Array:
    """Lambda (families,) that the best member of each family leaves of a white signature (N,), priors at the upper ends."""
    whole = float(signature @ signature)
    found = []
    for C, G in zip(library.columns, library.grams, strict=True):
        b = np.einsum("nvi,n->vi", C, signature)
        taken = np.einsum("vi,vi->v", b, np.linalg.solve(G + np.eye(C.shape[2]), b[..., None])[..., 0])
        found.append(whole - float(taken.max()))
    return np.array(found)


def needed(parameters: int) -> float:
    """Lambda below which a signature is not told from zero."""
    return THRESHOLD[min(parameters, 3) - 1] + MORE * max(parameters - 3, 0)


def not_told_apart(library: White, signature: Array, own: Name, factor: float = 1.0) -> set[Name]:
    """Names that imitate a white signature so well that these data cannot tell them from it; `factor` on the threshold."""
    left = left_by(library, signature)
    sizes = [C.shape[2] for C in library.columns]
    return {n for n, l, m in zip(library.names, left, sizes, strict=True) if n != own and l < factor * needed(m)}


def cannot_be_imitated(library: White, signature: Array) -> float:
    """Lambda that the best two families leave of a signature, chosen one after the other."""
    left = signature
    for _ in range(2):
        best = int(np.argmin(left_by(library, left)))
        C, G = library.columns[best], library.grams[best]
        b = np.einsum("nvi,n->vi", C, left)
        a = np.linalg.solve(G + np.eye(C.shape[2]), b[..., None])[..., 0]
        v = int(np.argmax(np.einsum("vi,vi->v", a, b)))
        left = left - C[:, v] @ a[v]
    return float(left @ left)


def upper_end(planted: Planted) -> float:
    """Upper end of the usual range of an effect's first key at its joint."""
    key = kinds()[planted.effect].keys[0]
    return key.high * (key.scale[(planted.joint or 1) - 1] if key.scale else 1.0)


def parameters_of(effect: str) -> int:
    """How many coefficients an effect's size has: two of a wave, three of a vector."""
    keys = kinds()[effect].keys
    return 2 if any(k.name == "phase_rad" for k in keys) else keys[0].length
