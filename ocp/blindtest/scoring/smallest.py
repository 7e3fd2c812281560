"""Smallest detectable size, found: where nine of ten effects are seen, against what was predicted before."""

from collections.abc import Sequence
from typing import Any

import numpy as np
from scipy.optimize import minimize
from scipy.special import expit

from ocp.blindtest.oracle.oracle import upper_end
from ocp.blindtest.scoring.intervals import NOTHING, Estimate, bootstrap
from ocp.simulate.twin.truth.planting import Planted
from robots.pose import Array

# The size that is told (`ocp.diagnose.verdict.visible`) is named nine times of ten.
POWER = 0.9
LEAST = 30  # worlds without which a curve is not fitted


def found_over_predicted(rows: Sequence[dict[str, Any]]) -> Estimate:
    """Size at which nine of ten single effects are seen over the predicted one; seen: p_none below one half."""
    pairs = []
    for r in rows:
        if r["kind"] != "single" or not r.get("smallest") or not r["smallest"][0] or not r["exact_smallest"][0]:
            continue
        effect, joint, values = r["planted"][0]
        planted = Planted(effect, joint or None, values)
        size = float(np.linalg.norm(np.atleast_1d(next(iter(values.values()))))) / upper_end(planted)
        pairs.append([np.log(size / r["smallest"][0]), float(r["p_none"] < 0.5)])
    if len(pairs) < LEAST:
        return NOTHING
    return bootstrap(pairs, _at_power)


def _at_power(table: Array) -> float:
    """Ratio at which a logistic curve of log size reaches the power; a weak prior holds its slope where all are seen."""
    x, hit = table[:, 0], table[:, 1]

    def unlikely(p: Array) -> float:
        chance = np.clip(expit(np.exp(p[1]) * (x - p[0])), 1e-9, 1 - 1e-9)
        return float(-(hit * np.log(chance) + (1 - hit) * np.log(1 - chance)).sum() + 0.5 * p[0] ** 2 + 0.5 * (p[1] - 1.5) ** 2)

    middle, slope = minimize(unlikely, np.array([0.0, 1.5]), method="Nelder-Mead", options={"xatol": 1e-3, "fatol": 1e-3}).x
    return float(np.exp(middle + np.log(POWER / (1 - POWER)) / np.exp(slope)))
