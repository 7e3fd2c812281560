"""How a run of the virtual machine is judged: what force a program would be seen to make, in figures, with the worst places and
which part of the cell brings them there; and what it takes off the blade.

The depth is force over time and patch, summed over all passes with what leads in and out, beside what the plan would take:
Preston's law with the belt's speed the same everywhere (a blade at 0.2 m/s changes 20 m/s by 1 %), depth goes with the time
integral of the pressure. The pressure is the table's, solved near the process force; about its centre the patch grows with the
cube root of the force as a Hertz contact does.
"""

from dataclasses import dataclass, replace

import numpy as np
import trimesh
from numpy.typing import NDArray
from scipy.ndimage import map_coordinates
from scipy.spatial import cKDTree

from ocp.model.cell import Cell, Process
from ocp.simulate.twin.collide import WheelBody, true_wheel
from ocp.simulate.twin.contact import ContactMoments
from ocp.simulate.twin.contact.grinder import ContactPatches
from ocp.simulate.twin.controller import Index
from ocp.simulate.twin.plan_knowledge import Matched
from ocp.simulate.twin.run import GroundPasses, VirtualMachine, true_blade
from ocp.simulate.twin.touching import Touching
from robots.pose import Array, apply
from trajectories.blade import Blade

WITHIN = 1.0  # N
WORST, APART, ALIKE = 8, 0.02, 2  # places that are told; m between two of one line; most of one line
NUDGE = 2e-5  # m, for the stiffness of the whole chain
SOFTEST = 100.0  # N/m; below it there is no contact to speak of
PARTS = ("arm", "wheel", "blade", "contact")


@dataclass(frozen=True)
class Place:
    """A bad place: line of the blade, s m, blade coordinates (3,) m, force N, what each of PARTS brings N."""

    line: int
    s: float
    p: Array
    force: float
    parts: dict[str, float]

    @property
    def cause(self) -> str:
        """The part that brings most of the error, in its direction."""
        total = sum(self.parts.values())
        return max(self.parts, key=lambda name: total * self.parts[name])


@dataclass(frozen=True)
class Rehearsal:
    """A run in figures. n samples: run, line, s m, p, n (n, 3), force N, goal N as planned, parts (n, 4) N of the error by
    PARTS; `lost` share of samples without contact."""

    run: Index
    line: Index
    s: Array
    p: Array
    n: Array
    force: Array
    goal: Array
    parts: Array
    worst: tuple[Place, ...]

    @property
    def figures(self) -> dict[str, float]:
        """mean, sd, min, max N, shares within 1 N and without contact, rms of the error and of each part of it, N."""
        error = self.force - self.goal
        within, lost = np.mean(np.abs(error) <= WITHIN), np.mean(self.force <= 0)
        found = statistics(self.force) | {"within_1_N": within, "lost": lost}
        found |= {"goal_N": self.goal.mean(), "rms_error_N": np.sqrt(np.mean(error**2))}
        found |= {f"rms_{name}_N": np.sqrt(np.mean(self.parts[:, k] ** 2)) for k, name in enumerate(PARTS)}
        return {name: float(value) for name, value in found.items()}


def statistics(force: Array) -> dict[str, float]:
    """Mean, standard deviation, least and most of forces N."""
    figures = {"mean_N": force.mean(), "sd_N": force.std(), "min_N": force.min(), "max_N": force.max()}
    return {name: float(value) for name, value in figures.items()}


def rehearse(machine: VirtualMachine, plan: Matched, grinding: GroundPasses, tool: Array, base: Array) -> Rehearsal:
    """Judge the run of a program. tool (4, 4) T_flange_blade and base (4, 4) T_base_wheel: the frames in the program, which
    the plan believed in.

    The error of the overlap is followed through the chain: the flange stands elsewhere (arm), then the wheel, then the blade;
    newtons by the stiffness of the whole chain at the place. What is left of the error of the force is the contact's: cover,
    blade, flange and their stiffnesses, friction, effects.
    """
    grinding = grinding.take(np.flatnonzero(plan.planned[grinding.index]))  # of the passes, without what leads in and out
    m, force = grinding.moments, grinding.result.force
    cell, truth, i = machine.cell, machine.truth, grinding.index
    believed = programmed_wheel(cell, base)
    really = true_wheel(cell, truth)
    T, held = m.T_base_flange @ tool, m.T_base_flange @ true_blade(cell, truth)
    steps = [plan.interference[i], overlap(believed, T, m.p), overlap(really, T, m.p), overlap(really, held, m.p)]
    stiffness = chain_stiffness(machine, grinding, really)
    parts = np.diff(np.array(steps), axis=0).T * stiffness[:, None]
    goal = plan.force[i]
    parts = np.column_stack([parts, force - goal - parts.sum(axis=1)])
    return Rehearsal(m.run, m.line, m.s, m.p, m.n, force, goal, parts, _worst(m, force, goal, parts))


def programmed_wheel(cell: Cell, base: Array) -> WheelBody:
    """The wheel that the plan believed in: base (4, 4) touches it at arc zero, its radius is as the cell was updated."""
    known = cell.calibration
    worn = {} if known is None else dict(zip(known.names, known.values.tolist(), strict=True))
    radius = cell.wheel.radius + worn.get("wheel_radius", 0.0)
    return WheelBody(base[:3, 3] - radius * base[:3, 2], base[:3, 1], radius, cell.wheel.width)


def overlap(wheel: WheelBody, T_base_blade: Array, p: Array) -> Array:
    """Interference (n,) m of the undeformed contact points p (n, 3) of a blade at T_base_blade (n, 4, 4)."""
    v = apply(T_base_blade, p) - wheel.centre
    radial = v - (v @ wheel.axis)[:, None] * wheel.axis
    return np.asarray(wheel.radius - np.linalg.norm(radial, axis=1))


def chain_stiffness(machine: VirtualMachine, grinding: GroundPasses, wheel: WheelBody) -> Array:
    """Newtons per metre (n,) of the chain of arm, flange, blade and wheel in balance, by moving the flange a little toward the
    wheel."""
    m = grinding.moments
    v = apply(m.T_base_flange @ true_blade(machine.cell, machine.truth), m.p) - wheel.centre
    radial = v - (v @ wheel.axis)[:, None] * wheel.axis
    inward = -radial / np.linalg.norm(radial, axis=1, keepdims=True)
    T = m.T_base_flange.copy()
    T[:, :3, 3] += NUDGE * inward
    pushed = machine.grinder.force(replace(m, T_base_flange=T)).force
    before = grinding.result.force if grinding.touched is None else machine.grinder.force(m).force
    return np.asarray(np.maximum((pushed - before) / NUDGE, SOFTEST))


def _worst(m: ContactMoments, force: Array, goal: Array, parts: Array) -> tuple[Place, ...]:
    """The largest errors, not all on one line and not twice in one place."""
    found: list[Place] = []
    for k in np.argsort(-np.abs(force - goal), kind="stable"):
        same = [p for p in found if p.line == int(m.line[k])]
        if len(same) < ALIKE and all(abs(p.s - m.s[k]) >= APART for p in same):
            named = {name: float(value) for name, value in zip(PARTS, parts[k], strict=True)}
            found.append(Place(int(m.line[k]), float(m.s[k]), m.p[k], float(force[k]), named))
        if len(found) == WORST:
            break
    return tuple(found)


SPACING = 2.5e-3  # m, longest edge of the surface's pieces
STRIDE = 5e-4  # m of way whose instants are laid down as one
FACING = 0.3  # least cosine between a piece's normal and the contact's to be ground with it
CHUNK = 2000  # instants laid down at once
GROUND = 0.5  # share of what is wanted from which on a place counts as ground
POINTS, INSTRUMENT = 600, 1e-6  # places where depth is measured, and one sigma m: a coordinate machine before and after


@dataclass(frozen=True)
class GroundDepth:
    """Depth on pieces of the blade's surface over `unit` N s/m^2: what even lines at the cell's spacing, feed and force take, or
    what the removal that the cell asks for takes by the coefficient that it believes. p, n (m, 3), area
    (m,) m^2; planned (m,): by the plan's forces, made (m,): by this machine's; asked, core (m,): within half a line's spacing of
    a pass; of these between lines and a patch inside the ends."""

    p: Array
    n: Array
    area: Array
    planned: Array
    made: Array
    asked: NDArray[np.bool_]
    core: NDArray[np.bool_]
    unit: float

    def at(self, p: Array, n: Array) -> Array:
        """Depth that the machine takes at places p (k, 3) whose outward normals are n (k, 3): that of the nearest piece."""
        near = cKDTree(self.p).query(p, k=min(12, len(self.p)))[1].reshape(len(p), -1)
        same = np.einsum("kij,kj->ki", self.n[near], n) > FACING
        return np.asarray(self.made[near[np.arange(len(p)), np.argmax(same, axis=1)]])

    def figures(self, depth: Array) -> dict[str, float | None]:
        """Shares of area and extremes of a depth (m,), by the names of plan.json; None where there is no core, or
        nothing beside what is asked."""

        def share(where: NDArray[np.bool_], good: NDArray[np.bool_]) -> float | None:
            return float(self.area[where & good].sum() / self.area[where].sum()) if where.any() else None

        off = np.abs(depth - 1.0)
        return {
            "ground_share": share(self.asked, depth >= GROUND),
            "core_within_5": share(self.core, off <= 0.05),
            "core_within_10": share(self.core, off <= 0.10),
            "all_within_10": share(self.asked, off <= 0.10),
            "core_median": float(np.median(depth[self.core])) if self.core.any() else None,
            "least": float(depth[self.asked].min()),
            "most": float(depth[self.asked].max()),
            "most_beside": float(depth[~self.asked].max()) if not self.asked.all() else None,
        }


def measured_depth(depth: GroundDepth, metres: float, rng: np.random.Generator) -> tuple[Array, Array]:
    """Places (k, 3) m all over the surface that is asked for, at most POINTS, and the depth (k,) m that an instrument reads
    there; metres: what a depth of 1 is."""
    asked = np.flatnonzero(depth.asked)
    share = depth.area[asked] / depth.area[asked].sum()
    at = np.sort(rng.choice(asked, min(POINTS, len(asked)), replace=False, p=share))
    return depth.p[at], metres * depth.made[at] + INSTRUMENT * rng.normal(size=len(at))


def ground_depth(blade: Blade, patches: ContactPatches, t: Touching, process: Process, belt_speed: float) -> GroundDepth:
    """Lay down what plan and machine press; patches: of the samples of `t`."""
    p, n, area = _pieces(blade)
    lies = t.windows.plan.run == t.windows.run
    plan = np.where(lies, t.windows.plan.force, 0.0)
    planned, made = (_laid(p, n, patches, force, t.dt, process.force) for force in (plan, t.mean))
    asked, core = _asked(p, n, patches, t)
    unit = process.force / (process.feed * process.pass_spacing)
    if process.removal is not None and process.preston is not None and belt_speed:
        unit = process.removal / (process.preston * abs(belt_speed))
    return GroundDepth(p, n, area, planned / unit, made / unit, asked, core, unit)


def _pieces(blade: Blade) -> tuple[Array, Array, Array]:
    """Middles, outward normals (m, 3) and areas (m,) of triangles no longer than SPACING."""
    vertices, faces = trimesh.remesh.subdivide_to_size(blade.vertices, blade.faces, SPACING, max_iter=20)
    corners = vertices[faces]
    cross = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    size = np.linalg.norm(cross, axis=1)
    kept = size > 0
    return corners[kept].mean(axis=1), cross[kept] / size[kept, None], 0.5 * size[kept]


def _laid(p: Array, n: Array, patches: ContactPatches, force: Array, dt: float, process_force: float) -> Array:
    """Time integral (m,) N s/m^2 of the pressure on pieces p, n."""
    depth, tree = np.zeros(len(p)), cKDTree(p)
    step = np.linalg.norm(np.diff(patches.origin, axis=0), axis=1)
    together = int(np.clip(STRIDE / max(float(np.nanmedian(step)), 1e-9), 1, 8))
    # The middle instant of each few carries what they all press; between windows nothing does.
    starts = np.arange(0, len(force), together)
    middle, count = np.minimum(starts + together // 2, len(force) - 1), np.diff(starts, append=len(force))
    carried, dt = np.zeros(len(force)), dt * together
    carried[middle] = np.add.reduceat(force, starts) / count
    rows = np.flatnonzero((carried > 0) & (patches.which >= 0))
    cell = np.array([patches.x[1] - patches.x[0], patches.y[1] - patches.y[0]])
    first = np.array([patches.x[0], patches.y[0]])
    for part in np.array_split(rows, len(rows) // CHUNK + 1):
        if not len(part):
            continue
        which, size = patches.which[part], np.cbrt(carried[part] / process_force)
        frame = np.stack([patches.along[part], patches.across[part]], axis=1)
        centre = patches.centre[which]
        found = tree.query_ball_point(patches.origin[part] + np.einsum("ki,kij->kj", centre, frame), patches.reach * size)
        count = np.array([len(k) for k in found])
        piece, k = np.concatenate([np.array(f, np.int64) for f in found]), np.repeat(np.arange(len(part)), count)
        kept = np.sum(n[piece] * patches.normal[part][k], axis=1) > FACING
        piece, k = piece[kept], k[kept]
        way = np.einsum("kij,kj->ki", frame[k], p[piece] - patches.origin[part][k])
        place = (centre[k] + (way - centre[k]) / size[k, None] - first) / cell
        share = map_coordinates(patches.share, [which[k], *place.T], order=1, mode="grid-constant")
        depth += np.bincount(piece, carried[part][k] * share / (cell.prod() * size[k] ** 2) * dt, len(p))
    return depth


def _asked(p: Array, n: Array, patches: ContactPatches, t: Touching) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
    """`asked` and `core` of GroundDepth for pieces p, n (m, 3)."""
    of, planned = t.windows.plan, np.flatnonzero(t.windows.planned)
    lines = [planned[t.windows.run[planned] == k] for k in np.unique(t.windows.run[planned])]
    trees, sides = [cKDTree(of.p[mine]) for mine in lines], [of.n[mine].mean(axis=0) for mine in lines]
    half, away, end = np.empty(len(lines)), np.empty((len(lines), len(p))), np.empty((len(lines), len(p)))
    toward = np.empty((len(lines), len(p), 3))
    for k, mine in enumerate(lines):
        distance, nearest = trees[k].query(p)
        away[k] = np.where(np.sum(n * of.n[mine][nearest], axis=1) > FACING, distance, np.inf)
        toward[k] = of.p[mine][nearest] - p
        end[k] = np.minimum(of.s[mine] - of.s[mine].min(), of.s[mine].max() - of.s[mine])[nearest]
        beside = [
            np.median(tree.query(of.p[mine])[0])
            for tree, side in zip(trees, sides, strict=True)
            if tree is not trees[k] and side @ sides[k] > FACING
        ]
        half[k] = 0.5 * min(beside, default=2 * np.median(patches.axes[mine, 1]))
    own, piece = np.argmin(away, axis=0), np.arange(len(p))
    inside = end[own, piece]
    asked = (away[own, piece] < half[own]) & (inside > 0)
    # Between lines: another one of the same side lies to the other side of the piece.
    across = np.einsum("kmi,mi->km", toward, toward[own, piece]) < 0
    between = (across & np.isfinite(away)).any(axis=0)
    return asked, asked & between & (inside > float(np.nanmax(patches.axes[planned], initial=0.0)))
