"""What the oracle reaches beyond names: the size of the planted effect, and what it would call alike having only readings.

Size and class are those of the likeliest member of the planted family, estimated from the readings with the widest usual prior
(independent of what was planted); so neither is perfect, and a diagnosis that knows less cannot be asked for more.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ocp.blindtest.oracle.oracle import SIZES, White, not_told_apart
from ocp.blindtest.scoring.judging import Name, name_of
from ocp.simulate.twin.truth.planting import Key, Planted, kinds
from robots.pose import Array

UNSIZED = ("gravity_compensator", "belt_splice", "stock_profile")  # families whose coefficients are not the effect's first key
SPARED = 1e-12  # squared share of a signature that counts as nothing


@dataclass(frozen=True, eq=False)
class Estimated:
    """The likeliest member of a family: coefficients (m,) per upper end, white signature (N,)."""

    coefficients: Array
    signature: Array


def estimated(library: White, y: Array, own: Name) -> Estimated | None:
    """The member of a family that the white readings y (N,) speak for most; None where the library lacks the family."""
    if own not in library.names:
        return None
    k = library.names.index(own)
    C, G = library.columns[k], library.grams[k]
    b = np.einsum("nvi,n->vi", C, y)
    inner = G + np.eye(C.shape[2]) / SIZES[-1] ** 2
    a = np.linalg.solve(inner, b[..., None])[..., 0]
    best = int(np.argmax(np.einsum("vi,vi->v", a, b) - np.linalg.slogdet(inner)[1]))
    return Estimated(a[best], C[:, best] @ a[best])


def size_error(found: Estimated, planted: Planted) -> float | None:
    """Error of the first key as a share of its value; None where coefficients are not that key."""
    keys = kinds()[planted.effect].keys
    upper = _upper(keys[0], planted.joint)
    true = np.atleast_1d(planted.vector(keys[0].name)) / upper
    if planted.effect in UNSIZED:
        return None
    if any(k.name == "phase_rad" for k in keys):
        if len(found.coefficients) != 2:
            return None
        return float(abs(np.linalg.norm(found.coefficients) - abs(true[0])) / abs(true[0]))
    if len(found.coefficients) < keys[0].length:
        return None
    return float(np.linalg.norm(found.coefficients[: keys[0].length] - true) / np.linalg.norm(true))


def _upper(key: Key, joint: int | None) -> float:
    return max(abs(key.low), abs(key.high)) * (key.scale[(joint or 1) - 1] if key.scale else 1.0)


def declared(library: White, found: Estimated, own: Name) -> set[Name]:
    """What one who knows the signatures calls alike, having estimated the size from these readings."""
    return not_told_apart(library, found.signature, own)


def classes_among(library: White, planted: Sequence[Planted], alone: Sequence[Array]) -> list[set[Name]]:
    """For each of several effects: its name and those that these data cannot tell from it, the others' signatures (N,) being
    free to take any size."""
    groups = []
    for k, (one, signature) in enumerate(zip(planted, alone, strict=True)):
        others = np.array([s for i, s in enumerate(alone) if i != k]).reshape(-1, len(signature)).T
        Q = np.linalg.svd(others, full_matrices=False)[0]
        left = signature - Q @ (Q.T @ signature)
        if left @ left < SPARED * (signature @ signature):
            continue
        columns = tuple(C - np.einsum("nk,kvi->nvi", Q, np.einsum("nk,nvi->kvi", Q, C)) for C in library.columns)
        grams = tuple(np.einsum("nvi,nvj->vij", C, C) for C in columns)
        given = White(library.names, columns, grams, library.positive)
        own = name_of(one)
        taken = {name_of(p) for p in planted}
        twins = not_told_apart(given, left, own) - taken
        if twins:
            groups.append(twins | {own})
    return groups
