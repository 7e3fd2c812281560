"""One calibration with what another one knows besides: wheel and blade beside an arm that was measured anew, the measuring frame
beside a registration by force."""

from dataclasses import replace

import numpy as np

from robots.calibration.store import Calibration

FORCE, UPDATE = "force", "update"
"""Of a provenance: by which logs wheel and blade were found, and when they hold."""


def carried_over(found: Calibration, known: Calibration | None) -> Calibration:
    """`found` with the parameters of `known` that it lacks, carried along by their regression on those that both have: where an
    axis' zero came out otherwise, a wheel that was found by that arm moves with it. Covariances are joint ones. What `known`
    tells of its force logs goes with the wheel, where `found` has none of its own."""
    rest = [] if known is None else [i for i, name in enumerate(known.names) if name not in found.names]
    if known is None or not rest:
        return found
    shared = [name for name in known.names if name in found.names]
    old = [known.names.index(name) for name in shared]
    new = [found.names.index(name) for name in shared]
    C, sd = known.covariance, np.maximum(known.standard_deviation[old], 1e-300)
    # Of correlations: a stiffness in N/m beside a metre would take every direction of the metres below the cut.
    slope = C[np.ix_(rest, old)] / sd @ np.linalg.pinv(C[np.ix_(old, old)] / np.outer(sd, sd), rcond=1e-12, hermitian=True) / sd
    moved = known.values[rest] + slope @ (found.values[new] - known.values[old])
    cross = slope @ found.covariance[new]
    own = C[np.ix_(rest, rest)] - slope @ (C[np.ix_(old, old)] - found.covariance[np.ix_(new, new)]) @ slope.T
    whole = np.block([[found.covariance, cross.T], [cross, 0.5 * (own + own.T)]])
    names = (*found.names, *(known.names[i] for i in rest))
    logs = {} if FORCE in found.provenance else {k: known.provenance[k] for k in (FORCE, UPDATE) if k in known.provenance}
    values, provenance = np.concatenate([found.values, moved]), found.provenance | logs
    return replace(found, names=names, values=values, covariance=whole, provenance=provenance)
