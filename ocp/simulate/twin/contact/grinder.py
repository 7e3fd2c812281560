"""The grinding of a virtual cell: from the arm's pose, free of contact, to the force between blade and wheel.

Wheel, blade, arm and mount together give way by the overlap: one monotone equation at every instant.

    depth = stroke(F) (n.a) + indentation(F) + F compliance                                        (4)

The unknown is v = (load / process load)^(2/3), in which the cover's curve is nearly straight; halving the interval finds it
for all instants at once and cannot fail. The mount between arm and blade is a rigid one, or the force-setting flange with what
happens to it.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from ocp.model.cell import Cell, ForceFlange
from ocp.simulate.twin.contact import ContactMoments, ContactResult, Index
from ocp.simulate.twin.contact import wheel_and_blade as bodies
from ocp.simulate.twin.contact.flange_motion import GRAVITY, NODES, ClosingPath, MovingDevice
from ocp.simulate.twin.contact.sensor import lagging, memory
from ocp.simulate.twin.contact.surface import Postures, postures
from ocp.simulate.twin.contact.table import (
    ABSENT,
    LEVELS,
    PlannedLines,
    SolvedStations,
    Tables,
    contact_patches,
    depth_curves,
    make_tables,
    place_stations,
)
from ocp.simulate.twin.truth import Truth
from robots.errors import Infeasible
from robots.pose import Array
from trajectories.blade import Blade


@dataclass(frozen=True)
class Mount:
    """What carries the blade. along (n,): n.a; preload (n,) N at stroke 0; stiffness N/m; half m: stroke to each side; friction
    (n,) N against the stroke's motion; held (n,) m or None: the stroke where it sticks. stiffness 0: no flange."""

    along: Array
    preload: Array
    stiffness: float
    half: float
    friction: Array
    held: Array | None = None

    def stroke(self, force: Array) -> Array:
        """Stroke (n,) m under contact forces (n,) N; positive gives way to the wheel."""
        if self.held is not None:
            return self.held
        if self.stiffness == 0.0:
            return np.zeros_like(force)
        free = (force * self.along - self.preload - self.friction) / self.stiffness
        return np.asarray(np.clip(free, -self.half, self.half))


def flange_direction(flange: ForceFlange, T_base_flange: Array, normal: Array) -> Array:
    """Unit direction (n, 3), base axes, in which the flange pushes toward the wheel at flange poses (n, 4, 4)."""
    if flange.axis is None:
        return normal
    direction = T_base_flange[:, :3, :3] @ flange.axis
    return np.asarray(direction * np.where(np.sum(direction * normal, axis=1) < 0, -1.0, 1.0)[:, None])


def told(truth: Truth, flange: ForceFlange, c: ContactMoments) -> Array:
    """Force (n,) N that the flange was told to set, as it takes it."""
    return np.where(np.isfinite(c.setpoint), c.setpoint, flange.setpoint) + truth.flange_offset


def moving_device(truth: Truth, flange: ForceFlange, lanes: int) -> MovingDevice:
    """The flange of a virtual cell on `lanes` lanes side by side."""
    return MovingDevice(
        mass=np.full(lanes, flange.carried_mass),
        friction=np.full(lanes, flange.friction + truth.total("flange_friction", "N")),
        stiffness=flange_spring(truth, flange),
        half=0.5 * flange.stroke,
        bandwidth=flange.bandwidth,
        delay=flange.delay,
        compensated=flange.gravity_compensated,
        hanging=truth.total("flange_gravity", "kg"),
    )


def flange_spring(truth: Truth, flange: ForceFlange) -> float:
    """Stiffness N/m of the flange as it is."""
    return flange.stiffness * truth.flange_scale * (1 + truth.total("flange_stiffness", "scale"))


def make_mount(truth: Truth, cell: Cell, c: ContactMoments, rows: Index, normal: Array) -> Mount:
    """The mount at the instants `rows`; `normal` (rows, 3): outward normals of the blade there, base axes."""
    flange = cell.flange
    zero = np.zeros(len(rows))
    if flange is None:
        return Mount(zero, zero, 0.0, 0.0, zero)
    direction = flange_direction(flange, c.T_base_flange[rows], normal)
    mass = 0.0 if flange.gravity_compensated else flange.carried_mass
    mass += truth.total("flange_gravity", "kg")
    return Mount(
        along=np.sum(direction * normal, axis=1),
        preload=told(truth, flange, c)[rows] + mass * GRAVITY * (direction @ cell.robot.gravity_direction),
        stiffness=flange_spring(truth, flange),
        half=0.5 * flange.stroke,
        friction=np.full(len(rows), truth.total("flange_friction", "N")),
    )


V = LEVELS ** (2 / 3)
HIGHEST = 14.0  # v of the highest force looked for, 52 process forces; the curve goes on straight beyond the last level
HALVINGS = 46  # the interval is then rounding


@dataclass(frozen=True)
class CoverForce:
    """Force of the cover at a load: unit (n,) N at the process load; F = centre (unit v^1.5 / centre)^power, centre in N;
    `push` (n,) N acts beside it wherever there is contact; `slack` (n,) N has relaxed."""

    unit: Array
    centre: float
    power: float
    push: Array
    slack: Array

    def elastic(self, v: Array) -> Array:
        """Force (n,) N without push and relaxation."""
        return np.asarray(self.centre * (self.unit * v**1.5 / self.centre) ** self.power)

    def __call__(self, v: Array) -> Array:
        """Force (n,) N."""
        return np.asarray(np.maximum(self.elastic(v) - self.slack, 0.0) + self.push)


@dataclass(frozen=True)
class Chain:
    """At n instants: depth m of the undeformed bodies, indentation (n, levels) m, compliance (n,) m/N; cover, mount."""

    depth: Array
    indentation: Array
    compliance: Array
    cover: CoverForce
    mount: Mount


@dataclass(frozen=True)
class Equilibrium:
    """Force N, elastic force of the cover N, stroke m, indentation m at n instants."""

    force: Array
    elastic: Array
    stroke: Array
    indentation: Array


def solve_chain(chain: Chain) -> Equilibrium:
    """Force at every instant; 0 where the bodies do not meet."""
    slopes = _slopes(chain.indentation)

    def excess(v: Array, force: Array) -> Array:
        closed = chain.mount.stroke(force) * chain.mount.along + _curve(chain.indentation, slopes, v) + force * chain.compliance
        return np.asarray(chain.depth - closed)

    def root(low: Array, high: Array, more: Callable[[Array], Array]) -> Array:
        """Where `more` is no longer above zero."""
        for _ in range(HALVINGS):
            middle = 0.5 * (low + high)
            still = more(middle) > 0
            low, high = np.where(still, middle, low), np.where(still, high, middle)
        return 0.5 * (low + high)

    zero = np.zeros_like(chain.depth)
    at_touch = chain.cover(zero)
    meets = excess(zero, zero) > 0
    loaded = excess(zero, at_touch) > 0
    v = np.where(loaded, root(zero, np.full_like(zero, HIGHEST), lambda v: excess(v, chain.cover(v))), 0.0)
    force = chain.cover(v)
    only_push = meets & ~loaded & (at_touch > 0)
    if only_push.any():
        force = np.where(only_push, root(zero, at_touch, lambda force: excess(zero, force)), force)
    force = np.where(meets, force, 0.0)
    indentation = np.where(meets, _curve(chain.indentation, slopes, v), np.nan)
    return Equilibrium(force, np.where(meets, chain.cover.elastic(v), 0.0), chain.mount.stroke(force), indentation)


def solve_sticking(chain: Chain, restart: Array) -> Equilibrium:
    """Force with Coulomb friction in the mount: the stroke stays where it is as long as friction can hold it there.

    restart (n,): True where the memory begins, with the stroke having last given way to the wheel.
    """
    mount = chain.mount
    if mount.stiffness == 0.0 or not np.any(mount.friction):
        return solve_chain(chain)
    least = solve_chain(chain).stroke
    most = solve_chain(replace(chain, mount=replace(mount, friction=-mount.friction))).stroke
    least, most = np.minimum(least, most), np.maximum(least, most)
    held = np.empty_like(least)
    last = 0.0
    for k in range(len(held)):
        last = least[k] if restart[k] else min(max(last, least[k]), most[k])
        held[k] = last
    return solve_chain(replace(chain, mount=replace(mount, held=held)))


ITERATIONS, SETTLED = 40, 1e-6  # of the relaxation, N


def solve_relaxing(truth: Truth, chain: Chain, time_s: Array, restart: Array) -> Equilibrium:
    """Forces of a cover that relaxes as a standard linear solid on top of its elastic law, with memory along each run.

    F = F_elastic - g q,  dq/dt = (F_elastic - q) / tau,  q = 0 where `restart` is True. The memory is causal and weak (g < 1), so
    solving all instants for a given q and renewing q from the forces settles at once.
    """
    solids = [(effect.number("g"), effect.number("tau")) for effect in truth.planted("wheel_relaxation")]
    result = solve_sticking(chain, restart)
    if not solids:
        return result
    before = result.elastic
    for _ in range(ITERATIONS):
        slack = np.zeros_like(before)
        for g, tau in solids:
            slack += g * memory(before, time_s, restart, tau)
        result = solve_sticking(replace(chain, cover=replace(chain.cover, slack=slack)), restart)
        if np.abs(result.elastic - before).max(initial=0.0) < SETTLED:
            break
        before = result.elastic
    return result


def _slopes(depth: Array) -> Array:
    """Slopes (n, levels) of monotone cubics through the levels (Fritsch and Butland 1984, as in PCHIP), one-sided at the ends."""
    h = np.diff(V)
    rise = np.diff(depth, axis=1) / h
    left, right = rise[:, :-1], rise[:, 1:]
    w1, w2 = 2 * h[1:] + h[:-1], h[1:] + 2 * h[:-1]
    same = left * right > 0
    inner = np.where(same, (w1 + w2) / (w1 / np.where(same, left, 1.0) + w2 / np.where(same, right, 1.0)), 0.0)
    return np.concatenate([rise[:, :1], inner, rise[:, -1:]], axis=1)


def _curve(depth: Array, slopes: Array, v: Array) -> Array:
    """Depth (n,) at v (n,): cubics between the levels, straight beyond the last."""
    i = np.clip(np.searchsorted(V, v, side="right") - 1, 0, len(V) - 2)
    row = np.arange(len(v))
    h = V[i + 1] - V[i]
    u = (np.minimum(v, V[-1]) - V[i]) / h
    a, b = depth[row, i], depth[row, i + 1]
    da, db = slopes[row, i] * h, slopes[row, i + 1] * h
    value = a + u * (da + u * (3 * (b - a) - 2 * da - db + u * (2 * (a - b) + da + db)))
    return np.asarray(value + np.maximum(v - V[-1], 0.0) * slopes[:, -1])


FAR_APART = 1.0  # m
BESIDE_TOUCH = 1e-3  # m before touch from which on the contact's curve is worked out
ROUNDS = 60  # of the contact and what of the arm goes with it, until no force changes by BALANCED, N
BALANCED = 2e-3
PAUSE = 0.5  # s without a row in contact after which the cover and the flange have forgotten


@dataclass(frozen=True)
class ContactPatches:
    """Pressure on the blade near the process force at n instants, blade frame: origin (n, 3) m of the wheel's grid there, outward
    normal, unit vectors along the belt and across; share (k, nx, ny): of the force on the grid's cells x (nx,), y (ny,) m;
    planned (n, 2) m: where the planned point lies on it; which (n,) of the shares, -1 where nothing is near."""

    origin: Array
    normal: Array
    along: Array
    across: Array
    planned: Array
    share: NDArray[np.float32]
    which: Index
    x: Array
    y: Array

    @cached_property
    def centre(self) -> Array:
        """Centres of the pressure (k, 2) m on the grid."""
        return np.column_stack([self.share.sum(axis=2) @ self.x, self.share.sum(axis=1) @ self.y])

    @cached_property
    def axes(self) -> Array:
        """Semi-axes (n, 2) m, along the belt and across, of half-ellipsoids with the second moments of the pressure."""
        off = [v[None] - self.centre[:, i : i + 1] for i, v in enumerate((self.x, self.y))]
        second = [np.sum(self.share.sum(axis=2 - i) * off[i] ** 2, axis=1) for i in range(2)]
        size = np.array([self.x[1] - self.x[0], self.y[1] - self.y[0]])
        axes = np.sqrt(5 * (np.column_stack(second) + size**2 / 12))
        return np.where(self.which[:, None] >= 0, axes[self.which], np.nan)

    @property
    def reach(self) -> float:
        """The largest distance m from its centre at which there is pressure."""
        loaded = self.share > 0
        far = np.hypot(self.x[None, :, None] - self.centre[:, :1, None], self.y - self.centre[:, 1:, None])
        return float(np.where(loaded, far, 0.0).max(initial=0.0) + np.hypot(self.x[1] - self.x[0], self.y[1] - self.y[0]))


@dataclass(frozen=True)
class Grinder:
    """Wheel, blade and mount of one virtual cell; `tables` may be shared with other cells of the same blade and wheel; `lines`:
    those that every instant lies on, where they are known better than the instants tell."""

    cell: Cell
    truth: Truth
    blade: Blade
    tables: Tables
    lines: PlannedLines | None = None

    def force(self, c: ContactMoments) -> ContactResult:
        """Force at n instants. Raises BadInput: the blade cannot be meshed or clamped."""
        rows = np.flatnonzero(c.contact)
        count = len(c.s)
        force, stroke = np.zeros(count), np.zeros(count)
        overlap, indentation = np.full(count, np.nan), np.full(count, np.nan)
        mu = bodies.friction(self.truth, self.cell, c)
        if len(rows):
            moved = lagging(self.truth, c)
            stations = place_stations(c, rows, moved.s[rows], self.lines)
            chain, overlap[rows] = self._chain(moved, rows, stations, mu[rows])
            result = solve_relaxing(self.truth, chain, c.time_s[rows], _restarts(c, rows))
            force[rows], stroke[rows], indentation[rows] = result.force, result.stroke, result.indentation
        force = bodies.knocked(self.truth, c, force)
        return ContactResult(force, mu * force, overlap, stroke, indentation)

    def wrenches(self, c: ContactMoments, force: Array) -> Array:
        """What normal forces (n,) N do to the flange at its origin, friction with them: (n, 6) N, N m, base axes."""
        rows, found, moved = np.flatnonzero(c.contact), np.zeros((len(c.s), 6)), lagging(self.truth, c)
        T, _, _, at = self._met(moved, rows)
        own, _ = bodies.contact_wrench(moved, rows, T, at, bodies.friction(self.truth, self.cell, c)[rows])
        found[rows] = force[rows, None] * own
        return found

    def borne(self, c: ContactMoments, compliance: Callable[[Array], Array]) -> ContactMoments:
        """`c` with the arm's `compliance` under the wrenches (n, 6) that the contact itself puts on the flange.

        More force leaves more give or less: a step that turns back is halved from then on. Raises Infeasible: no balance.
        """
        near = self.in_reach(c)
        force, share, last = self.force(near).force, np.ones(len(c.s)), np.zeros(len(c.s))
        for _ in range(ROUNDS):
            near = replace(near, arm_compliance=compliance(self.wrenches(near, force)))
            step = self.force(near).force - force
            if np.abs(step).max(initial=0.0) < BALANCED:
                return replace(c, arm_compliance=near.arm_compliance)
            share = np.where(step * last < 0, 0.5 * share, share)
            force, last = force + share * step, step
        raise Infeasible(f"contact and arm find no balance in {ROUNDS} rounds; plant a smaller play or a larger torque_Nm")

    def depth(self, c: ContactMoments) -> Array:
        """Overlap (n,) m of the undeformed bodies along the wheel's direction into the blade, stroke 0; below zero: apart, by
        FAR_APART where the place does not lie before the wheel."""
        moved = lagging(self.truth, c)
        radius, at = self._met(moved, slice(None))[2:]
        along, across = np.abs(at.shape[:, :2]).T
        before = (at.depth < radius) & (along < 0.5 * radius) & (across < self.cell.wheel.width)
        return np.where(before, at.depth + bodies.surface_change(self.truth, moved), -FAR_APART)

    def in_reach(self, c: ContactMoments) -> ContactMoments:
        """`c` with contact where the flange, wherever in its stroke it stands, may bring blade and wheel together."""
        half = 0.0 if self.cell.flange is None else 0.5 * self.cell.flange.stroke
        return replace(c, contact=c.contact & (self.depth(c) > -half - BESIDE_TOUCH))

    def patches(self, c: ContactMoments) -> "ContactPatches":
        """Where and how wide the pressure lies at n instants, as `in_reach` gives them."""
        rows, moved = np.flatnonzero(c.contact), lagging(self.truth, c)
        T, axis, _, at = self._met(moved, rows)
        share, index, place = contact_patches(self.tables, place_stations(c, rows, moved.s[rows], self.lines), at.shape)
        x, y = (np.einsum("kji,kj->ki", T[:, :3, :3], v) for v in (at.x, axis))
        origin, normal, along, across = (np.full((len(c.s), 3), np.nan) for _ in range(4))
        normal[rows], along[rows], across[rows] = moved.n[rows], x, y
        origin[rows] = moved.p[rows] - place[:, :1] * x - place[:, 1:] * y
        planned = np.full((len(c.s), 2), np.nan)
        planned[rows] = place
        which, there, grid = np.full(len(c.s), -1), np.sum(share, axis=(1, 2)) > 0, self.tables.rubber.grid
        which[rows] = np.where(there[index], index, -1)
        return ContactPatches(origin, normal, along, across, planned, share, which, grid.x, grid.y)

    def closing(self, c: ContactMoments, driven: Array, still: ContactResult) -> list[ClosingPath]:
        """The motion of every run of `c`, as `in_reach` gives it. driven (n, 3): acceleration m/s^2, base axes, of what
        the flange carries were its stroke held; still: the same instants in balance. Raises ValueError: no force flange."""
        flange, rows = self.cell.flange, np.flatnonzero(c.contact)
        if flange is None:
            raise ValueError("a rigid mount does not move")
        moved, count = lagging(self.truth, c), len(c.s)
        T = bodies.blade_poses(self.truth, self.cell, moved)
        normal = np.einsum("kij,kj->ki", T[:, :3, :3], moved.n)
        toward = flange_direction(flange, moved.T_base_flange, normal)
        closed = np.tile(ABSENT + 1e-3 * NODES, (count, 1))
        load, compliance, push = np.tile(NODES, (count, 1)), np.zeros(count), np.zeros(count)
        if len(rows):
            mu = bodies.friction(self.truth, self.cell, c)[rows]
            chain, _ = self._chain(moved, rows, place_stations(c, rows, moved.s[rows], self.lines), mu)
            slopes = _slopes(chain.indentation)
            levels = [np.full(len(rows), v) for v in NODES]
            closed[rows] = np.stack([_curve(chain.indentation, slopes, v) for v in levels], axis=1)
            load[rows] = np.stack([chain.cover.elastic(v) for v in levels], axis=1)
            compliance[rows], push[rows] = chain.compliance, chain.cover.push
        columns = {
            "time": c.time_s,
            "depth": self.depth(c),
            "along": np.sum(toward * normal, axis=1),
            "driven": np.sum(toward * driven, axis=1),
            "told": told(self.truth, flange, c),
            "down": toward @ self.cell.robot.gravity_direction,
            **{"closed": closed, "load": load, "compliance": compliance, "push": push},
        }
        solids = tuple((effect.number("g"), effect.number("tau")) for effect in self.truth.planted("wheel_relaxation"))
        return [self._path(columns, run, solids, still) for run in c.runs()]

    def _met(self, c: ContactMoments, rows: Index | slice) -> tuple[Array, Array, Array, Postures]:
        """T_base_blade (k, 4, 4), the wheel's axis (k, 3) and radius (k,) m, and the postures at rows of instants."""
        T, radius = bodies.blade_poses(self.truth, self.cell, c)[rows], bodies.radius_change(self.truth, self.cell, c)[rows]
        centre, axis = (v[rows] for v in bodies.wheel_frames(self.truth, self.cell, c))
        radius = self.cell.wheel.radius + radius
        return T, axis, radius, postures(T, c.p[rows], c.n[rows], c.t[rows], centre, axis, radius)

    def _path(
        self, columns: dict[str, Array], run: slice, solids: tuple[tuple[float, float], ...], still: ContactResult
    ) -> ClosingPath:
        start = float(still.stroke[run][0]) if still.force[run][0] > 0 else None
        return ClosingPath(**{name: values[run] for name, values in columns.items()}, solids=solids, start=start)

    def _chain(self, c: ContactMoments, rows: Index, stations: SolvedStations, mu: Array) -> tuple[Chain, Array]:
        """The equation of every instant in contact, and the overlap of the undeformed bodies."""
        truth, cell = self.truth, self.cell
        T, _, _, at = self._met(c, rows)
        p, n, t = c.p[rows], c.n[rows], c.t[rows]
        indentation, crowding = depth_curves(self.tables, stations, at.shape)
        solid = self.tables.compliance(
            stations, lambda patch: bodies.solid_compliance(cell.workpiece, self.blade, stations, patch)
        )
        compliance = bodies.blade_compliance_along(solid, stations, T[:, :3, :3], n, t, at, mu) / bodies.blade_stiffness(truth)
        compliance += bodies.clamp_compliance(truth, cell, p) + bodies.arm_compliance_along(c, rows, T, at, mu)
        cover = CoverForce(
            unit=cell.process.force * bodies.modulus_factor(truth, cell, c)[rows],
            centre=bodies.LAW_CENTRE,
            power=1 + truth.total("wheel_law", "exponent"),
            push=bodies.push(truth, crowding),
            slack=np.zeros(len(rows)),
        )
        mount = make_mount(truth, cell, c, rows, np.einsum("kij,kj->ki", T[:, :3, :3], n))
        return Chain(at.depth + bodies.surface_change(truth, c)[rows], indentation, compliance, cover, mount), at.overlap


def make_grinder(
    cell: Cell, truth: Truth, blade: Blade, tables: Tables | None = None, lines: PlannedLines | None = None
) -> Grinder:
    """The grinding of a virtual cell. `tables` of an earlier grinder of the same blade and wheel save the solutions they hold;
    None begins with those kept in this process."""
    return Grinder(cell, truth, blade, tables if tables is not None else make_tables(cell, blade), lines)


def _restarts(c: ContactMoments, rows: Index) -> Array:
    """Rows (k,) at which a contact begins: another run, or a pause."""
    new = np.diff(c.run[rows], prepend=c.run[rows][0] - 1) != 0
    return np.asarray(new | (np.diff(c.time_s[rows], prepend=-np.inf) > PAUSE))
