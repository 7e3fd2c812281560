"""Kernel tests: does the gap vary with a condition, whatever the cause? Exact F tests under the engine's projection.

With unit noise of unknown scale, Q an orthonormal basis of a kernel's projected features (m of them),

    F = (|Q^T y|^2 / m) / ((|y|^2 - |Q^T y|^2) / (nu - m))      is F(m, nu - m) distributed when nothing varies.   (docs, eq. 7)
"""

import numpy as np
from scipy.special import fdtrc

from ocp.diagnose.engine.findings import BudgetLine, KernelTest
from ocp.diagnose.engine.pool import Given
from ocp.diagnose.engine.problem import Problem
from ocp.diagnose.rules import BUDGET_SD, SEEN_DIRECTION
from robots.pose import Array


def after_given(there: Given, rows: Array) -> Array:
    """Rows (N,) or (N, m) with what is given projected out too."""
    inner = there.U.T @ rows
    shrink = 1.0 - np.sqrt(1.0 - there.take)
    return rows - there.U @ (shrink * inner if rows.ndim == 1 else shrink[:, None] * inner)


def kernel_tests(problem: Problem, there: Given) -> list[KernelTest]:
    """All kernels but ripples (the spectrum's) and waves that were picked for what they tell, after what is given, most telling
    first."""
    y = after_given(there, problem.pool.y)
    total, freedom = float(y @ y), problem.pool.freedom
    found = []
    for family in problem.pool.families:
        if not family.where or "ripple" in family.where or "wave" in family.where:
            continue
        basis = orthonormal(after_given(there, family.columns.reshape(len(y), -1)))
        m = basis.shape[1]
        gained = float(np.sum((basis.T @ y) ** 2))
        ratio = (gained / max(m, 1)) / max((total - gained) / (freedom - m), 1e-12)
        channel, where, source = family.name.effect[1:].split("/")
        p = float(fdtrc(m, freedom - m, ratio)) if m else 1.0
        found.append(KernelTest(channel, where, source, family.name.joint, gained - m * (total - gained) / (freedom - m), p))
    return sorted(found, key=lambda t: t.p_value)


def orthonormal(columns: Array) -> Array:
    """Basis (N, r) of columns, directions that noise could not show left out."""
    U, s, _ = np.linalg.svd(columns, full_matrices=False)
    return np.asarray(U[:, s > SEEN_DIRECTION])


def budget(problem: Problem, tests: list[KernelTest], explained: Given) -> list[BudgetLine]:
    """Shares of the gap beyond noise. The noise's scale is what the best explanation leaves."""
    scale2 = explained.left / problem.pool.freedom
    excess = float(problem.pool.y @ problem.pool.y) - problem.pool.freedom * scale2
    least = BUDGET_SD * np.sqrt(2.0 * problem.pool.freedom) * scale2  # no gap to share out below what noise itself scatters
    lines = []
    for t in tests:
        share = float(np.clip(t.gained / max(excess, least), 0.0, 1.0))
        elsewhere = t.joint and t.source in ("joint", "axis") and str(t.joint) not in t.where
        where = f"{t.where} at joint {t.joint}" if elsewhere else t.where
        lines.append(BudgetLine(t.channel, where, share, t.p_value))
    return sorted(lines, key=lambda b: -b.share)
