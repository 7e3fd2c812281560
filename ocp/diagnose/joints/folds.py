"""Parts of a log of link-side encoders to leave out: blocks of time, and conditions that the rest does not have."""

import numpy as np

from ocp.diagnose.engine.system import Fold
from ocp.diagnose.joints.problem import Problem
from robots.pose import Array

BLOCKS = 5


def joint_folds(problem: Problem) -> list[Fold]:
    """Blocks of time in each run (kind "block"); runs; half of a joint's range, one direction, the fast half of a joint."""
    signals, log = problem.signals, problem.signals.log
    block = np.empty(len(log), int)
    for k in np.unique(log.run):
        rows = np.flatnonzero(log.run == k)
        time = log.time[rows] - log.time[rows[0]]
        block[rows] = np.minimum((BLOCKS * time / max(time[-1], 1e-9)).astype(int), BLOCKS - 1)
    found = [Fold(f"time block {k + 1} of {BLOCKS}", "block", block[problem.row] == k) for k in range(BLOCKS)]
    if len(log.runs) > 1:
        found += [Fold(f"run={name}", "run", log.run[problem.row] == k) for k, name in enumerate(log.runs)]
    for j in problem.noise:
        found += _of_joint(problem, j, log.q[:, j - 1], signals.qd[:, j - 1], signals.direction[:, j - 1])
    return found


def _of_joint(problem: Problem, j: int, q: Array, qd: Array, direction: Array) -> list[Fold]:
    mine = problem.joint == j
    row = problem.row
    middle, fast = float(np.median(q[row[mine]])), float(np.median(np.abs(qd[row[mine]])))
    found = [Fold(f"q{j}>{np.degrees(middle):.0f}deg", "joint range", mine & (q > middle)[row])]
    if (direction < 0).any() and (direction > 0).any():
        found.append(Fold(f"direction{j}=-", "approach", mine & (direction < 0)[row]))
    found.append(Fold(f"speed{j}>{np.degrees(fast):.0f}deg/s", "speed", mine & (np.abs(qd) > fast)[row]))
    return found
