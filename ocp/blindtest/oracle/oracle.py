"""The oracle: it knows every signature and the true covariance of the readings, none of which is gross; the ceiling.

The detectability index of a planted effect is how far its true signature stands out of noise and of all that is refitted:

    lambda = d^T (Sigma + A P A^T)^-1 d                                                       (DIAGNOSIS, "How it is judged")

d is the readings with the effect less those without it on the same virtual cell, Sigma the covariance of the readings' noise, A
the derivatives in everything a machine is drawn with, P the variances it is drawn with: the right covariance, not one that was
fitted. Scanned families pay 2 ln(variants), the price of looking at all of them. What readings are is a signal's own matter
(`ocp.blindtest.oracle.tracker`, `ocp.blindtest.oracle.force`).

Evidence of a family with columns C (white), coefficients of prior width t times the upper end u, averaged over variants and t:

    log Z(t) = -1/2 log det(1 + t^2 G) + 1/2 b^T (G + 1 / t^2)^-1 b,     G = u C^T C u,  b = u C^T y

What it is asked about is linear: y = W (d + A x + noise), x drawn anew from P; a tracker's noise too, from
Sigma: ripple scatters there, and tails leave a normal law that says as much. A log's is the world's own. Size and
class are those of the likeliest member of the planted family, estimated from the readings with the widest usual prior
(independent of what was planted); so neither is perfect, and a diagnosis that knows less cannot be asked for more.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import compress

import numpy as np
from scipy.special import log_ndtr, logsumexp

from ocp.blindtest.oracle.force import ForceView, force_view
from ocp.blindtest.oracle.signatures import ExactFamily, force_families, tracker_families
from ocp.blindtest.oracle.tracker import ExactWhitener, TrackerView, tracker_view
from ocp.blindtest.worlds.machines import BlindMachine, TrackerMachine
from ocp.blindtest.worlds.recipes import OUTSIDE, coefficient_count, is_wave, kind_of, share_of_range, upper_end
from ocp.simulate.twin.planting import Planted
from robots.pose import Array

SIZES = np.geomspace(0.01, 1.0, 6)  # of the usual upper end
THRESHOLD = (10.5, 12.7, 14.2)  # lambda that tells a signature of 1, 2, 3 parameters from zero (DIAGNOSIS, method 5)
MORE = 1.3  # for each further parameter
MOST = 4
UNSIZED = ("gravity_compensator", "belt_splice", "stock_profile")  # families whose coefficients are not the effect's first key
# Effects with two sizes, or one that means nothing without its other keys: no smallest size is reported.
MANY_SIZED = ("friction_windup", "tracker_drift", "wheel_temperature", "wheel_relaxation", "tangential_force", *UNSIZED)
SPARED = 1e-12  # squared share of a signature that counts as nothing
Name = tuple[str, int]
ExactView = TrackerView | ForceView
"""A machine of one signal, or of both, as somebody sees it who knows its numbers."""


def name_of(planted: Planted) -> Name:
    """Effect and joint, 0 for none."""
    return planted.effect, planted.joint or 0


def exact_view(machine: BlindMachine) -> ExactView:
    """The exact view of a machine."""
    return tracker_view(machine) if isinstance(machine, TrackerMachine) else force_view(machine)


def detectabilities(view: ExactView, effects: Sequence[Planted]) -> Array:
    """Lambda (k,) of every effect given the others, less the price of its family."""
    found = given_others([view.signature(effects, [p for p in effects if p is not one]) for one in effects])
    return np.asarray(found - [view.price(p.effect, p.joint) for p in effects])


def given_others(white: Sequence[Array]) -> Array:
    """Lambda (k,) of each of k white signatures (N,), the directions of the others being free."""
    S = np.stack(white, axis=1)
    found = np.empty(S.shape[1])
    for i in range(len(found)):
        rest = np.delete(S, i, axis=1)
        left = S[:, i]
        if rest.shape[1]:
            Q, _ = np.linalg.qr(rest)
            left = left - Q @ (Q.T @ left)
        found[i] = left @ left
    return found


@dataclass(frozen=True, eq=False)
class White:
    """Families with white columns (N, V, m) per upper end, and their Gram matrices (V, m, m)."""

    names: tuple[Name, ...]
    columns: tuple[Array, ...]
    grams: tuple[Array, ...]
    positive: tuple[bool, ...]

    def without(self, effects: Sequence[str]) -> "White":
        """Less the families of these effects."""
        kept = [effect not in effects for effect, _ in self.names]
        names, positive = tuple(compress(self.names, kept)), tuple(compress(self.positive, kept))
        return White(names, tuple(compress(self.columns, kept)), tuple(compress(self.grams, kept)), positive)

    def given(self, columns: tuple[Array, ...]) -> "White":
        """The same families with other columns."""
        return White(self.names, columns, _grams(columns), self.positive)

    def best(self, k: int, y: Array) -> tuple[Array, Array]:
        """Coefficients (V, m) of family k's members for readings y (N,), priors at the upper ends, and what they take (V,)."""
        b = np.einsum("nvi,n->vi", self.columns[k], y)
        a = np.linalg.solve(self.grams[k] + np.eye(b.shape[1]), b[..., None])[..., 0]
        return a, np.einsum("vi,vi->v", b, a)


Observed = tuple[White, Array, tuple[Array, ...], tuple[float | None, ...]]
"""A world as the oracle sees it: library, white readings y (N,), white signature (N,) of each planted effect given the others,
and the smallest size of each that would be seen, as a share of its usual upper end."""


def observed(machine: BlindMachine, effects: Sequence[Planted], withheld: Sequence[str], rng: np.random.Generator) -> Observed:
    """A world of the machine with these effects, without the families withheld; rng: draws the oracle's readings."""
    view = exact_view(machine)
    library = library_of(view).without(withheld)
    alone = tuple(view.signature(effects, [p for p in effects if p is not one]) for one in effects)
    sizes = tuple(smallest_size(view, p, s) for p, s in zip(effects, alone, strict=True))
    return library, view.readings(effects, rng), alone, sizes


def library_of(view: ExactView) -> White:
    """All families, white and per upper end, of both signals where both were measured."""
    if isinstance(view, TrackerView):
        return whitened(tracker_families(view.machine, view.scene), view.white)
    found = force_families(view.machine, view.slopes, view.scene is not None)
    if view.scene is None or view.machine.arm is None:
        return whitened(found, view.white)
    # The same coefficients where both signals see an effect.
    seen = {f.name: f for f in tracker_families(view.machine.arm, view.scene)}
    pairs = []
    for f in found:
        points, shape = seen.pop(f.name, None), f.columns.shape[2:]
        there = points is not None and points.columns.shape[2:] == shape
        pairs.append((f, points.columns if points is not None and there else np.zeros((len(view.scene), 3, *shape))))
    for f in seen.values():
        pairs.append((replace(f, columns=np.zeros((2, len(view.machine.rows.s), *f.columns.shape[2:]))), f.columns))
    return _white([f for f, _ in pairs], [view.white.apply(f.columns * f.upper, points * f.upper) for f, points in pairs])


def whitened(found: Sequence[ExactFamily], white: ExactWhitener) -> White:
    """Families as white noise sees them."""
    return _white(found, [white.apply(f.columns * f.upper) for f in found])


def _white(found: Sequence[ExactFamily], columns: Sequence[Array]) -> White:
    return White(tuple(f.name for f in found), tuple(columns), _grams(columns), tuple(f.positive for f in found))


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
        now = library.given(columns)
        gain = evidence(now, y) + prior(library)
        gain[[library.names.index(n) for n in names]] = -np.inf
        best = int(np.argmax(gain))
        if gain[best] <= 0:
            break
        names.append(library.names[best])
        U, s, _ = np.linalg.svd(columns[best][:, int(np.argmax(now.best(best, y)[1]))], full_matrices=False)
        shrink = (1.0 - 1.0 / np.sqrt(1.0 + s**2))[:, None]
        y = y - U @ (shrink[:, 0] * (U.T @ y))
        flat = [C.reshape(len(y), -1) for C in columns]
        columns = tuple((F - U @ (shrink * (U.T @ F))).reshape(C.shape) for F, C in zip(flat, columns, strict=True))
    return names


def left_by(library: White, signature: Array) -> Array:
    """Lambda (families,) that the best member of each family leaves of a white signature (N,), priors at the upper ends."""
    whole = float(signature @ signature)
    return np.array([whole - float(library.best(k, signature)[1].max()) for k in range(len(library.names))])


def exact_threshold(parameters: int) -> float:
    """Lambda below which a signature is not told from zero."""
    return THRESHOLD[min(parameters, 3) - 1] + MORE * max(parameters - 3, 0)


def not_told_apart(library: White, signature: Array, own: Name, factor: float = 1.0) -> set[Name]:
    """Names that imitate a white signature so well that these data cannot tell them from it; `factor` on the threshold."""
    left = left_by(library, signature)
    sizes = [C.shape[2] for C in library.columns]
    return {n for n, l, m in zip(library.names, left, sizes, strict=True) if n != own and l < factor * exact_threshold(m)}


def cannot_be_imitated(library: White, signature: Array) -> float:
    """Lambda that the best two families leave of a signature, chosen one after the other."""
    left = signature
    for _ in range(2):
        best = int(np.argmin(left_by(library, left)))
        a, taken = library.best(best, left)
        v = int(np.argmax(taken))
        left = left - library.columns[best][:, v] @ a[v]
    return float(left @ left)


def smallest_size(view: ExactView, planted: Planted, white: Array) -> float | None:
    """Share of the usual upper end at which the effect of this white signature would just be told from noise, its family's price
    paid; None where it has no one size, or none that anybody predicted."""
    if planted.effect in OUTSIDE or planted.effect in MANY_SIZED:
        return None
    lam = float(white @ white)
    least = exact_threshold(coefficient_count(planted.effect)) + view.price(planted.effect, planted.joint)
    return share_of_range(planted) * float(np.sqrt(least / lam)) if lam > 0 else None


def estimated(library: White, y: Array, own: Name) -> tuple[Array, Array] | None:
    """Coefficients (m,) per upper end and white signature (N,) of the member of a family that the white readings y (N,) speak for
    most; None where the library lacks the family."""
    if own not in library.names:
        return None
    k = library.names.index(own)
    C, (a, taken) = library.columns[k], library.best(k, y)
    best = int(np.argmax(taken - np.linalg.slogdet(library.grams[k] + np.eye(C.shape[2]))[1]))
    return a[best], C[:, best] @ a[best]


def size_error(found: Array, planted: Planted) -> float | None:
    """Error of the first key as a share of its value, of coefficients (m,) `found`; None where they are not that key."""
    key = kind_of(planted.effect).keys[0]
    true = np.atleast_1d(planted.vector(key.name)) / upper_end(key, planted.joint)
    if planted.effect in UNSIZED:
        return None
    if is_wave(planted.effect):
        return float(abs(np.linalg.norm(found) - abs(true[0])) / abs(true[0])) if len(found) == 2 else None
    return float(np.linalg.norm(found[: key.length] - true) / np.linalg.norm(true)) if len(found) >= key.length else None


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
        twins = not_told_apart(library.given(columns), left, name_of(one)) - {name_of(p) for p in planted}
        if twins:
            groups.append(twins | {name_of(one)})
    return groups
