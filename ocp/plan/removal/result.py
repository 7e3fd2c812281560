"""What a timed motion takes off the blade: the map over its surface, all lines summed, and the shares by which it is judged."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, fields, replace
from functools import cached_property
from typing import Any

import numpy as np
from scipy.spatial import cKDTree

from ocp.contact.wheel.cover import Cover
from ocp.model.blade_gap import SurfaceCloud, contact_stations
from ocp.model.cell import Cell
from ocp.plan.motion import PlannedMotion
from ocp.plan.passes.optimise import SolvedPass
from ocp.plan.programming import Column, Timeline, build_timeline
from ocp.plan.removal.footprint import STATION_SPACING, contacts_along
from ocp.plan.removal.surface import ContactRows, Mask, SideCells, core_cells, row_times, shares_of_time, work_of
from ocp.plan.removal.wanted import Wanted, programmed_work
from ocp.shell.processes import side_by_side
from robots.kinematics import forward
from robots.pose import Array, apply

SAME_SPEED = 1e-6  # s; half the step of the differences that give the blade's speed
COARSER = 2.0  # times as far apart as the optimiser's contacts: the patch varies less than the indentation
LEAST_WANTED = 0.01  # of the programmed depth; a map that asks for less asks for nothing
DEEP = 1.25  # times what is wanted, from which on the surface beside what was asked for is told of
HALF = 0.5  # of the wanted depth, from which on a cell counts as ground


@dataclass(frozen=True)
class SideRemoval:
    """One flank: its cells, those of the core, and the depth over what is wanted (i, j); nan where nothing is wanted."""

    cells: SideCells
    core: Mask
    relative: Array


@dataclass(frozen=True)
class Figures:
    """`process` of plan.json (FORMATS.md): shares of the asked area (of the core's), least and most depth over what is wanted on
    the asked area, most beside it; None without such an area."""

    ground_share: float | None
    core_within_5: float | None
    core_within_10: float | None
    all_within_10: float | None
    least: float | None
    most: float | None
    most_beside: float | None

    def document(self) -> dict[str, float | None]:
        """Rounded to what they are worth."""
        found = {field.name: getattr(self, field.name) for field in fields(self)}
        return {name: None if value is None else round(float(value), 4) for name, value in found.items()}


@dataclass(frozen=True)
class Removal:
    """The map of a plan, and every place it was computed at, waypoints among them: points (m, 3) m, depth (m,) over that of the
    programmed force and feed, relative (m,) over what is wanted, nan where that is nothing."""

    sides: tuple[SideRemoval, ...]
    figures: Figures
    wanted: Wanted
    points: Array
    depth: Array
    relative: Array

    @cached_property
    def tree(self) -> cKDTree:
        """Search tree of the points."""
        return cKDTree(self.points)

    def at(self, points: Array) -> Array:
        """Depth over what is wanted at contact points (n, 3), nan where a point is nan."""
        return self._nearest(self.relative, points)

    def _nearest(self, values: Array, points: Array) -> Array:
        known = np.isfinite(points).all(axis=1)
        found = np.full(len(points), np.nan)
        found[known] = values[self.tree.query(points[known])[1]]
        return found

    def beside_told(self) -> list[str]:
        """A sentence where much more is taken off the margins than was asked for beside them."""
        most = self.figures.most_beside
        if most is None or most < DEEP:
            return []
        told = f"beside the asked surface, on its margins, up to {most:.2f} times the wanted depth is taken off, where the"
        return [
            f"{told} wheel's width hangs over an edge of the blade: a larger process.edge_margin_mm keeps it away from there."
        ]

    def columns(self, line: Timeline) -> list[Column]:
        """What plan.csv says of it at every row of contact."""
        points = np.where(line.contact[:, None], line.p, np.nan)
        found: list[Column] = [("removal_rel", self.at(points), 4)]
        if self.wanted.programmed_um is not None:
            found.append(("removal_um", self.wanted.programmed_um * self._nearest(self.depth, points), 3))
        return found


def find_removal(
    cell: Cell,
    motion: PlannedMotion,
    cover: Cover,
    cloud: SurfaceCloud,
    flanks: Sequence[SideCells],
    wanted: Wanted,
    meanwhile: Callable[[], Any] = lambda: None,
) -> Removal:
    """The depth that the timed motion takes off the `flanks`, every row of contact of every pass summed, over what is `wanted`;
    `meanwhile` is done while others sum it up.

    Raises Infeasible of the contact solver.
    """
    rows = contact_rows(cell, motion)
    paths = [one.touching().problem.path for one in motion.passes]
    points = np.vstack([*(one.points.reshape(-1, 3) for one in flanks), *(path.p for path in paths)])
    normals = np.vstack([*(one.normals.reshape(-1, 3) for one in flanks), *(path.n for path in paths)])
    tasks = [(one, rows.of(place)) for place, one in enumerate(motion.passes)]
    with side_by_side(line_work, tasks, cell, cover, cloud, cKDTree(points), normals) as found:
        meanwhile()
        half, works = zip(*found, strict=True)
    depth, asked = sum(works) / programmed_work(cell), wanted.at(points, normals)
    relative = np.where(asked > LEAST_WANTED, depth / np.maximum(asked, LEAST_WANTED), np.nan)
    sides, first = [], 0
    for one in flanks:
        count = one.area.size
        sides.append(SideRemoval(one, core_cells(one, paths, half), relative[first : first + count].reshape(one.area.shape)))
        first += count
    return Removal(tuple(sides), figures_of(sides), wanted, points, depth, relative)


def line_work(
    cell: Cell, cover: Cover, cloud: SurfaceCloud, tree: cKDTree, normals: Array, whole: SolvedPass, rows: ContactRows
) -> tuple[float, Array]:
    """Half-length m of a pass' footprints at its solved postures, and the work of its `rows` at the points of the tree."""
    one = whole.touching()
    index = contact_stations(one.problem.path.s, COARSER * STATION_SPACING).astype(np.int64)
    patches = contacts_along(cell, cover, cloud, one.problem.path, one.evaluation, index)
    assert patches is not None
    return float(patches.half_axes[:, 0].max()), work_of(tree, normals, rows, patches)


def contact_rows(cell: Cell, motion: PlannedMotion) -> ContactRows:
    """The rows of the motion in which wheel and blade touch: of every pass from touch to lift."""
    ways = [segment for segment in motion.segments if segment.kind == "pass"]
    times = [row_times(one.trajectory.duration, float(motion.passes[one.place].problem.path.feed.max())) for one in ways]
    line = build_timeline(replace(motion, segments=ways), times)
    bears = np.nan_to_num(line.force) > 0.0
    values = {name: getattr(line, name)[bears] for name in ("p", "n", "t", "s", "force")}
    slide = np.concatenate([shares_of_time(t) for t in times])[bears] * sliding_speed(cell, line, bears)
    return ContactRows(place=np.array([one.place for one in ways])[line.segment][bears], slide=slide, **values)


def sliding_speed(cell: Cell, line: Timeline, rows: Mask) -> Array:
    """Speed m/s of the belt against the moving blade at the contact points of `rows`, (n,)."""
    wheel, ahead = cell.wheel, SAME_SPEED * line.qd[rows]
    p = apply(np.broadcast_to(cell.workpiece.T_flange_blade, (int(rows.sum()), 4, 4)), line.p[rows])
    before, after = (apply(forward(cell.robot, line.q[rows] + sign * ahead), p) for sign in (-1.0, 1.0))
    blade = (after - before) / (2.0 * SAME_SPEED)
    _, radial, rho = wheel.cylindrical(0.5 * (before + after))
    belt = wheel.belt_speed * np.cross(wheel.axis, radial / rho[:, None])
    return np.asarray(np.linalg.norm(belt - blade, axis=1))


def figures_of(sides: Sequence[SideRemoval]) -> Figures:
    """The shares, every cell weighed by its area."""
    asked = [one.cells.asked & np.isfinite(one.relative) for one in sides]
    if not any(mask.any() for mask in asked):
        return Figures(None, None, None, None, None, None, None)
    depth, area, core = (
        np.concatenate([values[mask] for values, mask in zip(of, asked, strict=True)])
        for of in ([one.relative for one in sides], [one.cells.area for one in sides], [one.core for one in sides])
    )

    def within(part: float, mask: Mask) -> float | None:
        total = area[mask].sum()
        return float(area[mask & (np.abs(depth - 1.0) <= part)].sum() / total) if total > 0 else None

    whole = np.ones(len(depth), bool)
    beside = np.concatenate([one.relative[~mask & np.isfinite(one.relative)] for one, mask in zip(sides, asked, strict=True)])
    return Figures(
        ground_share=float(area[depth >= HALF].sum() / area.sum()),
        core_within_5=within(0.05, core),
        core_within_10=within(0.10, core),
        all_within_10=within(0.10, whole),
        least=float(depth.min()),
        most=float(depth.max()),
        most_beside=float(beside.max()) if beside.size else None,
    )
