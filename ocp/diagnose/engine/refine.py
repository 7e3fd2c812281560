"""Scanned values between those that were scanned: levers, rests and instants made sharper for the effects in a set.

A grid of 40 instants or a few levers leaves a residue of a strong effect that other names would explain. A pattern search
(Hooke and Jeeves 1961) on the evidence of the set, halving its steps, one effect and key at a time.
"""

from collections.abc import Sequence

import numpy as np

from ocp.diagnose.engine.beam import Weighed
from ocp.diagnose.engine.evidence import log_evidence
from ocp.diagnose.engine.families import stacked_columns
from ocp.diagnose.engine.pool import Given, Member, given
from ocp.diagnose.engine.problem import Linearisation
from ocp.diagnose.rules import SHARPER_GAIN
from ocp.effects.effect import Active, Effect, Scanned
from robots.pose import Array

HALVINGS = 4
FIXED = ("order", "source_joint")  # whole numbers


def refined(problem: Linearisation, weighed: Weighed, active: Sequence[Active]) -> tuple[Active, ...]:
    """The active effects of a set with scanned numbers moved to where the evidence is highest."""
    found = []
    for one in active:
        keys = [k for k in one.effect.symbolic if k not in FIXED and isinstance(one.scanned.get(k), float)]
        found.append(_sharper(problem, weighed, one, keys) if keys else one)
    return tuple(found)


def _sharper(problem: Linearisation, weighed: Weighed, one: Active, keys: Sequence[str]) -> Active:
    index = problem.index
    family = next(f for n, f in index.items() if (n.effect, n.joint) == one.key)
    others = given(problem.pool, [Member(m.family, m.variant, 1.0) for m in weighed.members if m.family != family])
    scans = problem.pool.families[family].scans
    steps = {k: _spacing([s[k] for s in scans if k in s]) for k in keys}
    best, here = dict(one.scanned), one
    level, _ = _evidence(problem, others, one.effect, one.joint, [best])
    for _ in range(HALVINGS):
        moves = [best | {k: best[k] + sign * steps[k]} for k in keys if steps[k] > 0 for sign in (-1.0, 1.0)]
        if not moves:
            break
        values, means = _evidence(problem, others, one.effect, one.joint, moves)
        k = int(np.argmax(values))
        if values[k] > level[0] + SHARPER_GAIN:
            best, level = moves[k], values[k : k + 1]
            here = Active(one.effect, one.joint, means[k], best, one.covariance)
        else:
            steps = {key: 0.5 * step for key, step in steps.items()}
    return here


def _spacing(values: Sequence[float]) -> float:
    """Half the median distance of the values scanned."""
    distinct = np.unique(np.asarray(values, float))
    return 0.5 * float(np.median(np.diff(distinct))) if len(distinct) > 1 else 0.0


def _evidence(problem: Linearisation, others: Given, effect: Effect, joint: int, scans: Sequence[Scanned]) -> tuple[Array, Array]:
    """Log evidence (V,) at the prior's upper end and coefficients (V, m) of variants over the rest of the set."""
    columns, _ = stacked_columns(problem.channels, effect, joint, scans)
    n, V, m = columns.shape
    scale = np.asarray(effect.prior_sd, float)
    X = problem.stack.apply((columns * scale).reshape(n, V * m)).reshape(n, V, m)
    y = problem.pool.y
    P = np.einsum("nr,nvi->rvi", others.U, X)
    held = others.take[:, None, None] * P
    G = np.einsum("nvi,nvj->vij", X, X) - np.einsum("rvi,rvj->vij", P, held)
    b = np.einsum("nvi,n->vi", X, y) - np.einsum("rvi,r->vi", held, others.U.T @ y)
    left = others.left
    log = log_evidence(G, b, np.ones((V, 1)), np.zeros((V, m), bool), left, problem.pool.freedom)[:, 0]
    means = np.linalg.solve(G + np.eye(m), b[..., None])[..., 0] * scale
    return log, means
