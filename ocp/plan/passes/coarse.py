"""A pass on a coarse grid: the optimiser finds its way on a few nodes, and begins on all of them from there.

Of the 12 to 26 iterations from a seed nearly all go into where along its arc the wheel bears, turned and tilted how, which varies
over centimetres; 3 to 9 are left on the whole grid. Multipliers go over as densities: the objective is a mean over time, of
which a node has `node_times`.
"""

from contextlib import suppress
from dataclasses import replace

import numpy as np
from scipy.interpolate import CubicSpline

from ocp.plan.passes.course import PassCourse
from ocp.plan.passes.problem import PassProblem
from ocp.plan.passes.smoothness import node_times
from ocp.plan.passes.solve import PassSolution, PassSolver
from robots.errors import Infeasible
from robots.pose import Array, Index

SPACING = 8e-3  # m between nodes of the pass proper: half as far apart takes longer and leaves as much to do
EVERY = 4  # of the nodes of ramps and of ways in the air one is taken


def start_on_coarse_grid(solver: PassSolver, problem: PassProblem) -> PassSolution | None:
    """A start for the whole grid; None, for the seed's, where a coarse one has not half as few nodes, no solution or one axis
    limits hold, of which it knows little, or where the force's variance counts, which is taken at every eighth node."""
    kept = coarse_grid(problem.way)
    if 2 * len(kept) > len(problem.way.at) or solver.weights.force_sd > 0:
        return None
    few, seed = restricted(problem, kept), solver.seed_joints(problem)
    with suppress(Infeasible):
        found = solver.solve(few)
        if found.multipliers is None:
            return None
        # From the seed's to the solution's joints is a smooth way; joints bend where the blade closes on the wheel.
        off = CubicSpline(few.way.at, found.q - seed[kept])
        return replace(prolonged(found, few.way, problem.way), q=seed + off(problem.way.at))
    return None


def coarse_grid(way: PassCourse) -> Index:
    """Indices (k,) of the nodes that a pass is solved on first: ends, touch, lift, begin and end of the full force, and some
    between."""
    n, on = len(way.at), way.touching
    full = np.flatnonzero(way.grinding > 0)
    stride = max(int(SPACING / np.median(np.diff(way.s[full])) + 1e-6), 1) if len(full) > 1 else 1
    ends = np.clip([0, full[0], full[-1], on.start - 1, on.start, on.stop - 1, on.stop, n - 1], 0, n - 1)
    parts = np.arange(0, full[0], EVERY), np.arange(full[0], full[-1], stride), np.arange(full[-1], n, EVERY)
    return np.unique(np.concatenate([ends, *parts]))


def restricted(problem: PassProblem, kept: Index) -> PassProblem:
    """The problem at the nodes that are kept; what r takes off between them follows from r linear between."""
    few = problem.at_nodes(kept)
    if problem.depth is None:
        return few
    on, inside = problem.way.touching, few.way.touching
    s, nodes = problem.way.s[on], few.way.s[inside]
    between = np.stack([np.interp(s, nodes, one) for one in np.eye(len(nodes))], axis=1)
    return replace(few, depth=problem.depth[kept[inside] - on.start] @ between)


def prolonged(found: PassSolution, few: PassCourse, way: PassCourse) -> PassSolution:
    """A solution on a coarse grid as a start on the whole one, all but its joints: linear between nodes."""

    def linear(values: Array) -> Array:
        return np.stack([np.interp(way.at, few.at, column) for column in values.T], axis=1)

    rate, ratio, force = linear(np.column_stack([found.rate, found.ratio, found.force])).T
    own, share = node_times(few)[:, None], node_times(way)[:, None]
    assert found.multipliers is not None
    bounds, rows = (share * linear(values / own) for values in found.multipliers)
    return replace(found, rate=rate, ratio=ratio, force=force, multipliers=(bounds, rows))
