"""Where the blade sits, how soft the cover is, and Preston's coefficient, from the pattern of measured depths.

A force log leaves open what does not change the force: a blade aside or turned along its own surface, the cover beside the
flange. Measured depths are a second measurement of the same state: depth = k_p h(theta) (ocp.update.pattern), with the fit of
the force log as the prior of theta and log k_p free.
"""

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from ocp.calibrate.force.fit import BIAS, ForceSolution
from ocp.calibrate.force.log import Flags, ForceLog
from ocp.calibrate.force.model import ForceModel, ForceRows
from ocp.calibrate.force.rows import measured_blade
from ocp.model.cell import Cell
from ocp.model.prepare import wheel_cover
from ocp.model.theta import NAMES, covariance_root
from ocp.update.pattern import GroundLog
from ocp.update.removal import DEPTH_MODEL, MeasuredDepths, Preston, preston_from
from robots.calibration.store import Calibration
from robots.errors import Infeasible
from robots.gauss_newton import Rule, minimise
from robots.pose import Array

# Solved contacts step from cell to cell: the search ends where a step is a fifth of what it can tell.
SEARCH = Rule(steps=5, rest=0.04, reweighted=2, halvings=2)
TAIL = 4.0  # degrees of freedom of the error of a depth: grit, burrs and gross readings count less
STRANGE = 3.0  # times their stated errors beyond which depths are not of this log


@dataclass(frozen=True)
class PatternFit:
    """What a pattern told: the state with it, Preston's coefficient; scatter of a depth over what was stated before and after."""

    calibration: Calibration
    preston: Preston
    scatter: tuple[float, float]


@dataclass(frozen=True)
class _Depths:
    """The problem: what ground, at parameters theta (k,) of the `found` state; root (m, r) of its covariance; l depths with their
    points and normals p, n (l, 3)."""

    ground: GroundLog
    found: Calibration
    theta: Array
    root: Array
    removal: MeasuredDepths
    p: Array
    n: Array

    def state(self, z: Array) -> Calibration:
        """The state at unknowns z (r + 1,)."""
        return replace(self.found, values=self.found.values + self.root @ z[:-1])

    @cached_property
    def place(self) -> tuple[list[int], list[int]]:
        """Which parameters of the model are in the state, and where there."""
        inside = [i for i, name in enumerate(NAMES) if name in self.found.names]
        return inside, [self.found.names.index(NAMES[i]) for i in inside]

    def pattern(self, z: Array) -> tuple[Array, Array]:
        """h (l,) at the points, and its derivatives (l, r) in z."""
        inside, at = self.place
        theta, sd = self.theta.copy(), np.zeros(len(self.theta))
        theta[inside] += (self.root @ z[:-1])[at]
        sd[inside] = self.found.standard_deviation[at]
        work, slopes = self.ground.pattern(theta, sd, self.p, self.n)
        return work, slopes[:, inside] @ self.root[at]


@dataclass(frozen=True)
class _Place:
    """A point of the search (`robots.gauss_newton.Iterate`): z (r + 1,), the last one log k_p; h (l,) and its derivatives (l, r)
    there; sigma (l,) m of the depths."""

    depths: _Depths
    z: Array
    seen: tuple[Array, Array]
    sigma: Array

    @property
    def _left(self) -> Array:
        """Measured less predicted (l,) m."""
        return self.depths.removal.depth - np.exp(self.z[-1]) * self.seen[0]

    def reweighted(self) -> "_Place":
        stated = np.hypot(self.depths.removal.sd, DEPTH_MODEL * np.exp(self.z[-1]) * self.seen[0])
        return replace(self, sigma=stated * np.sqrt((TAIL + (self._left / stated) ** 2) / (TAIL + 1.0)))

    def residual(self) -> Array:
        return self._left / self.sigma

    def linearised(self) -> tuple[Array, Array]:
        work, slopes = self.seen
        return self.residual(), np.exp(self.z[-1]) * np.column_stack([slopes, work]) / self.sigma[:, None]

    def moved(self, change: Array) -> "_Place":
        return replace(self, z=self.z + change, seen=self.depths.pattern(self.z + change))


def ground_log(cell: Cell, model: ForceModel, rows: ForceRows, log: ForceLog, kept: Flags, solution: ForceSolution) -> GroundLog:
    """What ground in a whole log, of which the rows `kept` (n,) were fitted: force as the fit has it there, else as measured."""
    force = log.fn - solution.x[BIAS]
    force[kept] = solution.reading - solution.x[BIAS]
    assert cell.workpiece.stl is not None
    cloud = measured_blade(cell.workpiece.stl, cell.workpiece)[2]
    return GroundLog(model, rows, log, np.maximum(force, 0.0), wheel_cover(model.cell), cloud)


def fit_pattern(ground: GroundLog, found: Calibration, theta: Array, removal: MeasuredDepths, p: Array, n: Array) -> PatternFit:
    """The state `found` by the force log that ground, with depths measured at p (l, 3) m on the blade, normals n; theta (k,): the
    model's parameters in that state.

    Raises Infeasible: no depth is of this log, or all are as far off as no error explains.
    """
    first = preston_from(removal, ground.work(theta, p, n))
    used = first.used
    depths = _Depths(ground, found, theta, covariance_root(found.covariance), removal.take(used), p[used], n[used])
    z = np.append(np.zeros(depths.root.shape[1]), np.log(first.value))
    precision = np.append(np.ones(len(z) - 1), 0.0)
    least = minimise(_Place(depths, z, depths.pattern(z), np.ones(len(used))), precision, SEARCH)
    preston = preston_from(depths.removal, least.at.seen[0])
    if preston.scatter > STRANGE:
        raise Infeasible(
            f"{removal.path}: depths scatter {preston.scatter:.1f} times as far as their errors about what this force log would "
            "have ground, wherever the blade sits; give the depths of the blade that the log is of"
        )
    # Where depths scatter farther than stated they tell less.
    told = (least.last.normal - np.diag(precision)) / max(preston.scatter, 1.0) ** 2
    spread = depths.root @ np.linalg.inv(told + np.diag(precision))[:-1, :-1] @ depths.root.T
    state = replace(depths.state(least.at.z), covariance=0.5 * (spread + spread.T))
    return PatternFit(state, replace(preston, left_out=first.left_out), (first.scatter, preston.scatter))
