"""What lines leave on a blade, point by point, and how it goes with everything that the force model knows.

    depth(x) = k_p h(x; theta),   h(x; theta) = sum over rows in contact of  F V phi(x - p; theta) dt                     (1)

with phi the pressure per newton of the contact solution at a row (ocp.plan.removal.footprint), F the force that pressed, V the
belt's speed against the moving blade and dt the row's time (Preston 1927). A blade that sits aside or turned in its holder is
pressed as hard, but elsewhere, and through a softer cover over more of it. At a row theta acts on phi by the place along the
wheel's axis, the two tilts and the cover's modulus E, so that

    dh/dtheta = sum over rows of  F V dt  sum over c  dphi/dc  dc/dtheta,    c = lateral, tilt along, tilt across, log E. (2)

A contact under F through a cover of modulus a E is that under F / a through one of modulus E, all pressures times a: phi is the
same.

A force log leaves open what does not change the force: a blade aside or turned along its own surface, the cover beside the
flange. Measured depths are a second measurement of the same state: depth = k_p h(theta), with the fit of the force log as the
prior of theta and log k_p free.
"""

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from scipy.sparse import csr_matrix
from scipy.spatial import cKDTree

from ocp.calibrate.force.blade import feed_heading
from ocp.calibrate.force.fit import BIAS, ForceSolution, covariance_left
from ocp.calibrate.force.log import Flags, ForceLog, Index
from ocp.calibrate.force.model import STATE, ForceModel, ForceRows, PlacedRows
from ocp.calibrate.force.rows import measured_blade
from ocp.contact.wheel.cover import Cover
from ocp.contact.wheel.signorini import Contact, LocalShape, solve_force
from ocp.model.blade_gap import SurfaceCloud, contact_stations, surface_shape
from ocp.model.cell import Cell
from ocp.model.prepare import wheel_cover
from ocp.model.theta import NAMES, covariance_root, wheel_at
from ocp.plan.removal.footprint import LinePatches, line_patches
from ocp.plan.removal.surface import ContactRows, pressures, shares_of_time
from ocp.update.removal import DEPTH_MODEL, MeasuredDepths, Preston, preston_from
from robots.calibration.store import Calibration
from robots.errors import Infeasible
from robots.gauss_newton import Rule, minimise
from robots.pose import Array

STATION = 12e-3  # m between contacts that are solved along a run
STEP = 5e-4  # m between the instants that rows are parted into; at 25 rows a second they lie as far apart as a patch is long
ROW = np.r_[STATE["lateral"], STATE["tilt"]]  # columns of the state that a footprint goes with
SHAPE = ("lateral", "tilt_x", "tilt_y")  # the same in a contact's shape
# What derivatives of a contact are taken over: lateral m, tilts, log of the modulus. About a cell of its patch.
MOVES = (2e-4, 1e-3, 1e-3, 0.1)
COVER = NAMES.index("cover_stiffness_scale")
DIFFERENCE = 0.1  # of a parameter's sigma, over which the state's derivatives are taken


@dataclass(frozen=True)
class RunFootprints:
    """One run in contact: its moments; footprints as they are, and with one thing after the other moved by MOVES; the logged rows
    (j,) at which its contacts are solved, their place `way` (j,) m along it."""

    moments: ContactRows
    patches: LinePatches
    moved: tuple[LinePatches, ...]
    stations: Index
    way: Array


@dataclass(frozen=True)
class GroundLog:
    """What ground a blade: model and rows of a log, force (n,) N that pressed, the wheel's cover as the model's cell has it, the
    blade's surface."""

    model: ForceModel
    rows: ForceRows
    log: ForceLog
    force: Array
    cover: Cover
    cloud: SurfaceCloud

    def work(self, theta: Array, p: Array, n: Array) -> Array:
        """h (m,) Pa m of eq. 1 at points p (m, 3) m with normals n (m, 3). Raises Infeasible of the contact solver."""
        tree, total = cKDTree(p), np.zeros(len(p))
        for run in self._runs(theta, derivatives=False):
            total += self._by_moment(run.moments, run.patches, tree, n) @ np.ones(len(run.moments.s))
        return total

    def pattern(self, theta: Array, sd: Array, p: Array, n: Array) -> tuple[Array, Array]:
        """h (m,) of `work` and its derivatives (m, k) in theta (k,), zero where sd (k,) is. Raises as `work`."""
        tree, work, slopes = cKDTree(p), np.zeros(len(p)), np.zeros((len(p), len(theta)))
        for run in self._runs(theta, derivatives=True):
            still, *moved = (self._by_moment(run.moments, patches, tree, n) for patches in (run.patches, *run.moved))
            work += still @ np.ones(still.shape[1])
            by = self._state_by(run, theta, sd)
            for c, (one, step) in enumerate(zip(moved, MOVES, strict=True)):
                at = np.array([np.interp(run.moments.s, run.way, column) for column in by[:, c].T])
                slopes += (one - still) @ (at.T / step)
        return work, slopes

    @staticmethod
    def _by_moment(moments: ContactRows, patches: LinePatches, tree: cKDTree, n: Array) -> csr_matrix:
        """What every moment (r,) adds to h at the points (m,) of a tree with normals (m, 3): (m, r)."""
        row, point, pressure = pressures(tree, n, moments, patches)
        return csr_matrix((pressure * (moments.force * moments.slide)[row], (point, row)), shape=(len(n), len(moments.s)))

    def _runs(self, theta: Array, derivatives: bool) -> list[RunFootprints]:
        found = []
        for number in np.unique(self.log.run[self.log.contact]):
            at = np.flatnonzero((self.log.run == number) & self.log.contact & (self.force > 0))
            if len(at) > 1:
                found.append(self._run(at, theta, derivatives))
        return found

    def _run(self, at: Index, theta: Array, derivatives: bool) -> RunFootprints:
        way = _way(self.log, at)
        chosen = np.asarray(contact_stations(way, STATION))
        part, F = self.rows.take(at[chosen]), np.maximum(self.force[at[chosen]], self.model.least_force)
        state = self.model.evaluate("state", PlacedRows.of(self.model.cell, part, theta), F)
        solved: list[list[Contact]] = [[] for _ in range(1 + len(MOVES) * derivatives)]
        headings, wheel, contact = [], wheel_at(self.model.cell.wheel, theta), None
        for k in range(len(chosen)):
            T = state[k, STATE["T"]].reshape(4, 4)
            headings.append(feed_heading(wheel, T, part.waypoint[k]))
            (kxx, kyy, kxy), (lateral, *tilt) = state[k, STATE["curvature"]].tolist(), state[k, ROW].tolist()
            base = LocalShape(kxx, kyy, kxy, lateral, tilt[0], tilt[1], heading=headings[-1])
            shape = surface_shape(wheel, self.cloud, base, T, part.waypoint[k, :3])
            moved = [replace(shape, **{name: getattr(shape, name) + step}) for name, step in zip(SHAPE, MOVES, strict=False)]
            force = F[k] / (1.0 + theta[COVER])
            shapes, forces = (shape, *moved, shape), (*[force] * (1 + len(moved)), force / np.exp(MOVES[-1]))
            for contacts, one, under in zip(solved, shapes, forces, strict=False):
                contact = solve_force(self.cover, float(under), one, contact)
                contacts.append(contact)
        # Together, so that all lie on one grid.
        every = line_patches(np.tile(way[chosen], len(solved)), [c for one in solved for c in one], headings * len(solved))
        patches = [
            LinePatches(way[chosen], every.x, every.share[i : i + len(chosen)], F, every.indentation[i : i + len(chosen)])
            for i in range(0, len(every.at), len(chosen))
        ]
        return RunFootprints(self._moments(at).of(0), patches[0], tuple(patches[1:]), at[chosen], way[chosen])

    def _moments(self, at: Index) -> ContactRows:
        """The rows `at` of a run, parted into instants STEP apart."""
        log, cell, count = self.log, self.model.cell, len(at)
        way = _way(log, at)
        feed = np.gradient(way, log.time[at]) if np.all(np.diff(log.time[at]) > 0) else np.zeros(count)
        parts = np.maximum(np.ceil(np.diff(way) / STEP).astype(int), 1)
        fine = np.concatenate([*(k + np.arange(c) / c for k, c in enumerate(parts)), [count - 1.0]])

        def between(values: Array) -> Array:
            columns = values.reshape(count, -1).T
            found = np.array([np.interp(fine, np.arange(count), one) for one in columns]).T
            return found.reshape(len(fine), *values.shape[1:])

        belt = np.full(count, cell.wheel.belt_speed) if log.belt is None else log.belt[at]
        # At zero turn the blade runs with the belt, or against it.
        speed = np.abs(np.abs(between(belt)) - cell.process.sigma * between(feed))
        slide = speed * shares_of_time(between(log.time[at]))
        frame = (between(log.p[at]), between(log.n[at]), between(log.t[at]))
        return ContactRows(np.zeros(len(fine), np.int64), *frame, between(way), between(self.force[at]), slide)

    def _state_by(self, run: RunFootprints, theta: Array, sd: Array) -> Array:
        """Derivatives (j, 4, k) of what MOVES moves at a run's stations, under the force there."""
        part, F = self.rows.take(run.stations), np.maximum(self.force[run.stations], self.model.least_force)
        out = np.zeros((len(part), len(MOVES), len(theta)))
        out[:, -1, COVER] = 1.0 / (1.0 + theta[COVER])
        here = self.model.evaluate("state", PlacedRows.of(self.model.cell, part, theta), F)[:, ROW]
        for k in np.flatnonzero(sd > 0):
            there = theta.copy()
            there[k] += DIFFERENCE * sd[k]
            moved = self.model.evaluate("state", PlacedRows.of(self.model.cell, part, there), F)[:, ROW]
            out[:, : len(ROW), k] = (moved - here) / (DIFFERENCE * sd[k])
        return out


def _way(log: ForceLog, at: Index) -> Array:
    """Way (k,) m along the points of a run's rows."""
    return np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(log.p[at], axis=0), axis=1))])


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


def ground_log(
    cell: Cell, model: ForceModel, rows: ForceRows, log: ForceLog, kept: Flags, solution: ForceSolution, over: Flags
) -> GroundLog:
    """What ground in a whole log, of which the rows `kept` (n,) were fitted: force as the fit has it there, else as measured;
    of the rows `over` (n,) alone, those before the depths were measured."""
    force = log.fn - solution.x[BIAS]
    force[kept] = solution.reading - solution.x[BIAS]
    force[~over] = 0.0
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
    state = replace(depths.state(least.at.z), covariance=covariance_left(depths.root, told + np.diag(precision)))
    return PatternFit(state, replace(preston, left_out=first.left_out), (first.scatter, preston.scatter))
