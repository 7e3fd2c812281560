"""One calibration with what another one knows besides: wheel and blade beside an arm that was measured anew, the measuring frame
beside a registration by force."""

from dataclasses import replace

import numpy as np
from scipy.special import chdtrc

from robots.calibration.parameters import BASE_NAMES
from robots.calibration.store import BENDING, Calibration

FORCE, UPDATE = "force", "update"
"""Of a provenance: by which logs wheel and blade were found, and when they hold."""
CHANGED = 1e-6  # chance of so unlike parameters, below which the arm itself is another
SEEN = 1e-9  # of the largest direction of correlations: below, rounding


def _shared(found: Calibration, known: Calibration) -> tuple[list[int], list[int]]:
    """Places in `found` and in `known` of what both have of the arm itself: where the measuring frame stands is no part of it."""
    names = [name for name in known.names if name in found.names and name not in BASE_NAMES]
    return [found.names.index(name) for name in names], [known.names.index(name) for name in names]


def chance_of_one_arm(found: Calibration, known: Calibration) -> float:
    """Chance that two calibrations of one arm, from readings of their own, differ in what both have by more than they do; 1 where
    they have not the same model of it (`method`, bending joints), whose parameters mean something else. With d what the estimates
    differ by and C1, C2 their covariances, d^T (C1 + C2)^-1 d is chi-square, with a degree a direction; a direction that neither
    saw, where both have the same prior, counts less than that."""
    if any(found.provenance.get(key) != known.provenance.get(key) for key in ("method", BENDING)):
        return 1.0
    new, old = (np.array(places, np.int64) for places in _shared(found, known))
    open_ = known.standard_deviation[old] + found.standard_deviation[new] > 0
    new, old = new[open_], old[open_]
    C = known.covariance[np.ix_(old, old)] + found.covariance[np.ix_(new, new)]
    sd = np.sqrt(np.diag(C))
    size, vector = np.linalg.eigh(C / np.outer(sd, sd))
    off, seen = vector.T @ ((found.values[new] - known.values[old]) / sd), size > SEEN * float(size.max(initial=0.0))
    return float(chdtrc(max(int(seen.sum()), 1), np.sum(off[seen] ** 2 / size[seen])))


def carried_over(found: Calibration, known: Calibration | None, one_arm: bool | None = None) -> Calibration:
    """`found` with the parameters of `known` that it lacks, carried along by their regression on those that both have: where an
    axis' zero came out otherwise, a wheel that was found by that arm moves with it. Covariances are joint ones. Where the arms
    are surely two (an axis mastered anew), nobody knows which of it was found otherwise and which is otherwise: the wheel stays,
    less sure by as much as it might have moved; `one_arm`: whether they are one, None: by `chance_of_one_arm`. What `known` tells
    of its force logs goes with the wheel, where `found` has none of its own."""
    rest = [] if known is None else [i for i, name in enumerate(known.names) if name not in found.names]
    if known is None or not rest:
        return found
    new, old = _shared(found, known)
    C, sd = known.covariance, np.maximum(known.standard_deviation[old], 1e-300)
    # Of correlations: a stiffness in N/m beside a metre would take every direction of the metres below the cut.
    slope = C[np.ix_(rest, old)] / sd @ np.linalg.pinv(C[np.ix_(old, old)] / np.outer(sd, sd), rcond=1e-12, hermitian=True) / sd
    move, cross = slope @ (found.values[new] - known.values[old]), slope @ found.covariance[new]
    own = C[np.ix_(rest, rest)] - slope @ (C[np.ix_(old, old)] - found.covariance[np.ix_(new, new)]) @ slope.T
    if one_arm is False or (one_arm is None and chance_of_one_arm(found, known) < CHANGED):
        move, cross, own = 0.0 * move, 0.0 * cross, C[np.ix_(rest, rest)] + np.outer(move, move)
    whole = np.block([[found.covariance, cross.T], [cross, 0.5 * (own + own.T)]])
    names = (*found.names, *(known.names[i] for i in rest))
    logs = {} if FORCE in found.provenance else {k: known.provenance[k] for k in (FORCE, UPDATE) if k in known.provenance}
    values, provenance = np.concatenate([found.values, known.values[rest] + move]), found.provenance | logs
    return replace(found, names=names, values=values, covariance=whole, provenance=provenance)
