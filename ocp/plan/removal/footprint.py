"""The footprint of a contact: its pressure per newton over the blade's surface, and what passing contacts take off a line.

Preston (1927, J. Soc. Glass Technol. 11, 214): depth grows as k_p x pressure x relative speed. With the pressure F phi(x - c) of
a contact at c and ds = v dt along the line,

    depth(x) = k_p V integral F/v phi(x - c(s)) ds,      r = (F/F0) / (v/v0)

so that depth is linear in r (docs/process.md, eq. 1 to 3). phi comes from the contact solution (ocp.contact.wheel.signorini).
"""

from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import RegularGridInterpolator
from scipy.ndimage import map_coordinates
from scipy.sparse import csr_matrix

from ocp.contact.wheel.cover import Cover
from ocp.contact.wheel.signorini import MOMENT_TO_AXIS, Contact, LocalShape, solve_force
from ocp.model.blade_gap import SurfaceCloud, SurfaceShape, contact_stations, surface_shape
from ocp.model.cell import Cell
from ocp.plan.passes.posture import turned_curvature
from ocp.shell.processes import side_by_side
from robots.errors import Infeasible
from robots.pose import Array
from trajectories.passes import BladePath

if TYPE_CHECKING:
    from ocp.plan.passes.solve import Evaluation

CELL = 4e-4  # m of the footprint's grid: a tenth of a usual half axis
STATION_SPACING = 3e-3  # m between contacts solved; the patch varies smoothly in between
PRESSED = 1e-2  # of the largest pressure of a profile; less is what interpolation leaves beside the patch
ACROSS = 48  # places between two lines where their sum is looked at
PROFILE_STEPS = 4  # points in each cell of a footprint where its profile is summed up


@dataclass(frozen=True)
class Pressing:
    """What of a cell says how its wheel presses on a blade and what that takes off, wherever both stand and whatever the feed:
    the wheel's radius m, signs of the belt's travel and of the feed against it, rad that the wheel may be turned, the force N,
    the distance m of neighbouring lines."""

    radius: float
    travel: float
    sigma: int
    turn_tolerance: float
    force: float
    spacing: float

    @staticmethod
    def of(cell: Cell) -> "Pressing":
        """That of a cell."""
        wheel, process = cell.wheel, cell.process
        return Pressing(wheel.radius, wheel.travel, process.sigma, process.turn_tolerance, process.force, process.pass_spacing)


@dataclass(frozen=True)
class LinePatches:
    """Footprints at stations along a line, linear in between.

    at (k,) m arc length, rising; x (m,) m, even, symmetric about 0: middles of the cells along t and along b alike; share
    (k, m, m) 1/m^2, indexed [station, along t, along b]: pressure per newton, its integral over the cells is 1; force (k,) N at
    which it was solved; indentation (k,) m there.
    """

    at: Array
    x: Array
    share: Array
    force: Array
    indentation: Array

    @property
    def half_axes(self) -> Array:
        """Half lengths (k, 2) m along t and b of the ellipsoid of pressure with the same second moments, at most half of what is
        pressed.

        Under it the depth across a line is a parabola of half-width b (docs/process.md, eq. 4).
        """
        area = (self.x[1] - self.x[0]) ** 2
        marginal = np.stack([self.share.sum(axis=2), self.share.sum(axis=1)], axis=1) * area
        mean = marginal @ self.x
        cells = 1 + np.count_nonzero(marginal > PRESSED * marginal.max(axis=2, keepdims=True), axis=2)
        pressed = cells * (self.x[1] - self.x[0])
        return np.asarray(np.minimum(np.sqrt(MOMENT_TO_AXIS * (marginal @ self.x**2 - mean**2)), 0.5 * pressed))

    @property
    def hollow(self) -> NDArray[np.bool_]:
        """At which stations (k,) nothing presses on the line itself: over a hollow the wheel bears to both sides of it."""
        middle = self.share[:, :, len(self.x) // 2].sum(axis=1)
        return np.asarray(middle <= PRESSED * self.share.sum(axis=1).max(axis=1))

    def unevenness(self, spacing: float) -> Array:
        """Half the range of the depth (k,) over its mean, across lines `spacing` m apart that are ground alike."""
        lines = np.arange(-int(2 * self.x[-1] / spacing) - 1, int(2 * self.x[-1] / spacing) + 2)
        between = np.linspace(0.0, spacing, ACROSS, endpoint=False)
        place = (between[:, None] - spacing * lines)[None]
        depth = np.array([np.interp(place[0], self.x, one, left=0.0, right=0.0).sum(axis=1) for one in self.share.sum(axis=1)])
        return np.asarray(0.5 * np.ptp(depth, axis=1) / depth.mean(axis=1))

    def pressure(self, s: Array, along: Array, across: Array, force: Array) -> Array:
        """Pressure per newton (n,) 1/m^2 at places (n,) m along t and across along b of the contact at arc lengths s (n,) m.

        The patch grows as the cube root of the force (n,) N about its planned point (Hertz; force > 0).
        """
        size, index = self.size(s, force), np.interp(s, self.at, np.arange(len(self.at)))
        place = [(v / size - self.x[0]) / (self.x[1] - self.x[0]) for v in (along, across)]
        return np.asarray(map_coordinates(self.share, [index, *place], order=1, mode="constant") / size**2)

    def size(self, s: Array, force: Array) -> Array:
        """How much larger (n,) the patch is at arc lengths s (n,) m under the force (n,) N than that under the programmed one."""
        return np.cbrt(force / np.interp(s, self.at, self.force))

    @cached_property
    def reach(self) -> float:
        """Distance m from the planned point beyond which no patch presses under the programmed force."""
        pressed = np.hypot(*np.meshgrid(self.x, self.x))[(self.share > 0).any(axis=0)]
        return float(pressed.max() + np.sqrt(2.0) * (self.x[1] - self.x[0]))


def shape_under(cell: Cell, cloud: SurfaceCloud, path: BladePath, seen: "Evaluation", k: int) -> SurfaceShape:
    """The blade's real surface under the wheel at waypoint k of a pass, at the posture of `seen`."""
    along = -cell.wheel.travel * cell.process.sigma  # zero turn: the blade moves with the belt or against it
    kxx, kyy, kxy = (float(c) for c in seen.curvature[k])
    tilt_x, tilt_y = (float(c) for c in seen.tilt[k])
    heading = (along * float(np.cos(seen.turn[k])), along * float(np.sin(seen.turn[k])))
    base = LocalShape(kxx, kyy, kxy, float(seen.lateral[k]), tilt_x, tilt_y, heading=heading)
    return surface_shape(cell.wheel, cloud, base, seen.T_base_blade[k], path.p[k])


def contacts_along(
    cell: Cell,
    cover: Cover,
    cloud: SurfaceCloud,
    path: BladePath,
    seen: "Evaluation",
    index: NDArray[np.int64],
    passed_over: bool = False,
) -> LinePatches | None:
    """Footprints at the waypoints `index` of a pass, on the blade's real surface, at the postures of `seen` and under the
    programmed force.

    Raises Infeasible of the contact solver, with the waypoint; `passed_over`: such waypoints are, None where all of them are.
    """
    at, headings = [], []
    contacts: list[Contact] = []
    for k in index:
        shape = shape_under(cell, cloud, path, seen, k)
        try:
            contacts.append(solve_force(cover, float(path.force[k]), shape, contacts[-1] if contacts else None))
        except Infeasible as error:
            if passed_over:
                continue
            raise Infeasible(f"line {path.line} ({path.side}), waypoint {k + 1}: {error}") from None
        headings.append(shape.heading)
        at.append(path.s[k])
    return line_patches(np.array(at), contacts, headings) if at else None


def planned_patches(pressing: Pressing, cover: Cover, path: BladePath) -> LinePatches | None:
    """Footprints along a pass before its postures are known: the middle of the wheel, the path's turn, no tilt, the local
    quadratic.

    Stations that are too hollow for the wheel are passed over (the optimiser tells of them), and those on the outline of the
    wall, where a fillet goes on that the local quadratic does not have; None where all of them are.
    """
    along = -pressing.travel * pressing.sigma
    heading = (along * float(np.cos(path.turn)), along * float(np.sin(path.turn)))
    curvature = np.transpose(turned_curvature(path.curvature, np.array(path.turn), pressing.radius))
    at = []
    contacts: list[Contact] = []
    for k in contact_stations(path.s, 2.0 * STATION_SPACING):
        if path.extent[k].max() < CELL:
            continue
        kxx, kyy, kxy = (float(c) for c in curvature[k])
        shape = LocalShape(kxx, kyy, kxy, extent=path.extent[k], heading=heading)
        with suppress(Infeasible):
            contacts.append(solve_force(cover, float(path.force[k]), shape, contacts[-1] if contacts else None))
            at.append(path.s[k])
    return line_patches(np.array(at), contacts, [heading] * len(at)) if at else None


def planned_patches_of(pressing: Pressing, cover: Cover, paths: Sequence[BladePath]) -> list[LinePatches | None]:
    """`planned_patches` of every path."""
    with side_by_side(planned_patches, [(path,) for path in paths], pressing, cover) as found:
        return list(found)


def line_patches(at: Array, contacts: Sequence[Contact], headings: Sequence[tuple[float, float]]) -> LinePatches:
    """Footprints from contacts solved at arc lengths `at` (k,) m; headings: t in the wheel's contact frame (x, y)."""
    reach = max(_reach(contact) for contact in contacts) + CELL
    cells = int(np.ceil(reach / CELL))
    x = CELL * np.arange(-cells, cells + 1)
    t, b = np.meshgrid(x, x, indexing="ij")
    shares = []
    for contact, (hx, hy) in zip(contacts, headings, strict=True):
        place = np.stack([hy * t - hx * b, hx * t + hy * b], axis=-1)  # (y, x): b = n x t with n = -z
        grid = (contact.y, contact.x)
        share = RegularGridInterpolator(grid, contact.pressure, bounds_error=False, fill_value=0.0)(place)
        shares.append(share / (share.sum() * CELL**2))
    force = np.array([contact.force for contact in contacts], float)
    indentation = np.array([contact.indentation for contact in contacts], float)
    return LinePatches(np.asarray(at, float), np.asarray(x, float), np.array(shares, float), force, indentation)


def _reach(contact: Contact) -> float:
    """Distance m of the farthest loaded cell from the planned point."""
    loaded = contact.pressure > 0
    return float(np.hypot(*np.meshgrid(contact.x, contact.y))[loaded].max())


def line_footprint(s: Array, patches: LinePatches, spacing: float = np.inf) -> csr_matrix:
    """Matrix (n, n) that maps r at the nodes of a line to the depth at the line's own centre, relative to r = 1 throughout.

    s (n,) m rising arc lengths of the nodes, however graded: each stands for the stretch halfway to its neighbours. `spacing`
    m: distance of neighbouring lines that are ground alike and add to this one; infinite: the line alone. Rows sum to 1 where
    all footprints that reach the node's place lie inside s[0] .. s[-1] and are alike.
    """
    edges = np.concatenate([s[:1], 0.5 * (s[1:] + s[:-1]), s[-1:]])
    fine, total = _summed_profiles(patches, spacing)
    index = np.interp(s, patches.at, np.arange(len(patches.at)))
    below = np.minimum(index.astype(int), max(len(patches.at) - 2, 0))
    above, weight = np.minimum(below + 1, len(patches.at) - 1), index - below
    reach = fine[-1]
    first, last = np.searchsorted(edges[1:], s - reach), np.searchsorted(edges[:-1], s + reach)
    rows = np.repeat(np.arange(len(s)), last - first)
    columns = np.concatenate([np.arange(a, b) for a, b in zip(first, last, strict=True)])
    step = fine[1] - fine[0]

    def under(edge: Array) -> Array:
        """Share of the footprint of node `columns` that has passed the place of node `rows` when the contact is at `edge`."""
        place = (s[rows] - edge - fine[0]) / step
        low, high = (map_coordinates(total, [k[columns], place], order=1, mode="nearest") for k in (below, above))
        return np.asarray((1.0 - weight[columns]) * low + weight[columns] * high)

    values = under(edges[columns]) - under(edges[columns + 1])
    return csr_matrix((values, (rows, columns)), shape=(len(s), len(s)))


def _summed_profiles(patches: LinePatches, spacing: float) -> tuple[Array, Array]:
    """Places (f,) m along t, and the integral up to there (k, f) of the profile along t on the line and its neighbours' sum.

    Ends at 1.
    """
    lines = np.arange(-int(patches.x[-1] / spacing), int(patches.x[-1] / spacing) + 1)
    m = len(patches.x)
    at = (lines * spacing if np.isfinite(spacing) else np.zeros(1)) / CELL + (m - 1) / 2
    profile = np.array(
        [map_coordinates(one, [np.repeat(np.arange(m), len(at)), np.tile(at, m)], order=1) for one in patches.share]
    )
    profile = profile.reshape(len(patches.share), m, len(at)).sum(axis=2)
    fine = np.linspace(patches.x[0], patches.x[-1], PROFILE_STEPS * (m - 1) + 1)
    dense = np.array([np.interp(fine, patches.x, one) for one in profile])
    total = np.cumsum(0.5 * (dense[:, 1:] + dense[:, :-1]), axis=1)
    total = np.hstack([np.zeros((len(total), 1)), total])
    return fine, total / total[:, -1:]
