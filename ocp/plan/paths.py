"""The blade and its passes: laid on the shape found in the STL, or taken from a path or an old program.

Of an old program every pose tells where it lets the blade touch the wheel.
"""

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import trimesh
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline
from scipy.spatial import cKDTree

from ocp.contact.wheel.cover import Cover
from ocp.model.blade_gap import FACING, SurfaceCloud
from ocp.model.cell import Cell, wheel_frame
from ocp.model.prepare import wheel_cover
from ocp.plan.clearance import enclosed
from ocp.plan.passes.stretches import CannotGrind
from ocp.plan.removal.dwell import PROBE, askew, at_feeds, even_lines, probed_lines
from ocp.plan.removal.footprint import Pressing
from ocp.plan.removal.surface import SideCells, flank_cells
from ocp.plan.removal.wanted import Wanted, wanted_of
from ocp.plan.rules import FLANGE_SHARE, STROKE_RESERVE, WHEEL_ROOM
from ocp.shell.cache import code_hash, content_key, flattened, rebuilt, remember
from robots.errors import BadInput
from robots.gravity import GRAVITY
from robots.kinematics import forward
from robots.pose import Array, apply
from trajectories.blade import AerofoilShape, Blade, find_shape, read_blade
from trajectories.blade.shape import KEPT
from trajectories.blade.window import obstacles
from trajectories.dialects import dialect_named
from trajectories.passes import BladePath, PassOptions, ground_windows, passes
from trajectories.path_points import paths_from_points, read_path_file
from trajectories.program.old_program import OldPass, contact_frames_from_program

CLOUD_SPACING = 8e-4  # m between points of the surface cloud


@dataclass(frozen=True)
class PlanOptions:
    """Options of the command: a path made elsewhere or an old program, kind of output, name, waypoint distance m.

    stock: a map of the depth that is wanted. even: lines as near to each other as the patch's width asks for; without it
    `pass_spacing` apart at the feed given, for those who want a few lines to look at. whole: refuse a blade of which anything has
    to be left out.
    """

    path: Path | None = None
    program: Path | None = None
    kind: str = "axis"
    name: str | None = None
    step: float = 1e-3
    even: bool = True
    whole: bool = False
    stock: Path | None = None

    @property
    def laid(self) -> bool:
        """Whether lines are laid at distances chosen here."""
        return self.even and self.path is None and self.program is None

    @property
    def fitted(self) -> bool:
        """Whether feeds are chosen so that all lines together take off what is wanted."""
        return self.laid or (self.stock is not None and (self.path is not None or self.program is not None))


@dataclass(frozen=True)
class LaidPaths:
    """Blade, passes in the order of the lines, the ground surface as a cloud, points (k, 3) m on what is not aerofoil, the flanks
    in cells, what is wanted to be taken off them, where that is beyond reach, and notices in sentences."""

    blade: Blade
    paths: list[BladePath]
    cloud: SurfaceCloud
    beside: Array
    flanks: list[SideCells]
    wanted: Wanted
    beyond: list[CannotGrind]
    notices: tuple[str, ...]


def lay_paths(cell: Cell, stl: Path, options: PlanOptions) -> LaidPaths:
    """Read the blade, find its aerofoil and lay the passes the cell asks for.

    Raises BadInput: the STL, the clamp, the margins or the path handed in cannot be used.
    """
    blade = read_blade(stl, cell.workpiece.stl_unit)
    shape = find_shape(blade, cell.workpiece.aerofoil)
    cloud = surface_cloud(shape, blade)
    if options.path is None and options.program is None:
        return _laid_lines(cell, blade, shape, cloud, options)
    if options.path is not None:
        paths, notices = read_path_file(options.path, blade, shape, cell.process.feed, cell.process.force, options.step)
    else:
        assert options.program is not None
        paths, notices = paths_from_program(cell, blade, shape, cloud, options.program, options.step)
    flanks = flank_cells(shape, {}, paths, 0.5 * cell.process.pass_spacing)
    wanted = wanted_of(cell, blade, cloud, options.stock)
    beyond: list[CannotGrind] = []
    if options.stock is not None:
        r = even_lines(Pressing.of(cell), wheel_cover(cell), paths, flanks, wanted)
        paths, beyond = at_feeds(cell, paths, r, wanted)
    anything = np.zeros((0, 3))  # a path made elsewhere may lead over fillet and platform
    return LaidPaths(blade, paths, cloud, anything, flanks, wanted, beyond, (*blade.notices, *shape.notices, *notices))


def refuse_flange(cell: Cell, paths: list[BladePath]) -> None:
    """Raises BadInput where the flange's axis stands across the contact's normal on most of the paths, or where the force would
    press it to its stop all along them."""
    flange = cell.flange
    if flange is None:
        return
    shares = cell.flange_shares(np.concatenate([path.n for path in paths]))
    share = float(np.median(shares))
    weight = 0.0 if flange.gravity_compensated else GRAVITY * flange.carried_mass  # at most, where it hangs along the axis
    force, usable = np.concatenate([path.force for path in paths]), 0.5 * flange.stroke - STROKE_RESERVE
    least = float(((force * shares - flange.setpoint - weight) / flange.stiffness).min())
    if least > usable:
        raise BadInput(
            f"{cell.path}: the force flange, set to {flange.setpoint:g} N, would stand {1e3 * least:.1f} mm or more from its "
            f"middle under the {force.min():g} N asked for, and {1e3 * usable:g} mm are usable: set process.force_N nearer to "
            "force_flange.setpoint_N, or the other way round"
        )
    if share < FLANGE_SHARE:
        raise BadInput(
            f"{cell.path}: force_flange.axis stands {np.degrees(np.arccos(share)):.0f} deg to the normal of most of the blade: "
            "the flange gives along its axis alone and would hardly hold a force there; correct the axis (flange frame), or the "
            "blade in its holder"
        )


@dataclass(frozen=True)
class LaidLines:
    """Lines on a blade at a feed of 1 m/s, the r (n,) of `even_lines` by the numbers of those that have one, the flanks in cells,
    points (k, 3) m on what is not aerofoil, notices in sentences."""

    paths: list[BladePath]
    r: dict[str, Array]
    flanks: list[SideCells]
    beside: Array
    notices: list[str]


def _laid_lines(cell: Cell, blade: Blade, shape: AerofoilShape, cloud: SurfaceCloud, options: PlanOptions) -> LaidPaths:
    """Lines as near to each other as the patch's width asks for, each at the feed that makes their sum what is wanted.

    How they lie goes neither with the feed nor with where wheel and blade stand in the cell, and is kept.
    """
    wanted, chosen = wanted_of(cell, blade, cloud, options.stock), replace(_pass_options(cell, options.step), feed=1.0)
    asked = replace(wanted, programmed_um=None)  # goes with the feed, and is for words
    pressing, cover = Pressing.of(cell), wheel_cover(cell) if options.even else None
    given = pressing, cover, chosen, blade.content, cell.workpiece.aerofoil, replace(asked, source=None)
    key = content_key(code_hash(), *(part for pair in sorted(flattened(given).items()) for part in pair))
    laid = rebuilt(LaidLines, remember("lines", key, lambda: flattened(_lines_on(blade, shape, chosen, pressing, cover, asked))))
    paths = [replace(path, feed=cell.process.feed * path.feed) for path in laid.paths]
    beyond: list[CannotGrind] = []
    if options.even:
        r = [laid.r.get(str(k)) for k in range(len(paths))] if laid.flanks else []
        paths, beyond = at_feeds(cell, paths, r, wanted)
    told = (*blade.notices, *shape.notices, *laid.notices)
    return LaidPaths(blade, paths, cloud, laid.beside, laid.flanks, wanted, beyond, told)


def _lines_on(
    blade: Blade, shape: AerofoilShape, chosen: PassOptions, pressing: Pressing, cover: Cover | None, wanted: Wanted
) -> LaidLines:
    """Lines on a blade; no `cover`: as far apart as `chosen` has them."""
    looked: list[BladePath] = []
    if cover is not None:
        look = replace(chosen, spacing=min(chosen.spacing, PROBE), step=PROBE, wheel_radius=0.0)
        spread, looked = probed_lines(pressing, cover, passes(blade, shape, look)[0])
        chosen = replace(chosen, spread=spread)
    paths, notices = passes(blade, shape, chosen)
    paths = askew(paths, looked)
    flanks = flank_cells(shape, ground_windows(blade, shape, chosen), paths, 0.0)
    r = [] if cover is None else even_lines(pressing, cover, paths, flanks, wanted)
    known = {str(k): own for k, own in enumerate(r) if own is not None}
    return LaidLines(paths, known, flanks, obstacles(blade, shape), notices)


_latest: dict[str, tuple[AerofoilShape, SurfaceCloud]] = {}


def surface_cloud(shape: AerofoilShape, blade: Blade) -> SurfaceCloud:
    """The blade's whole outer surface: smooth on both flanks, the STL's own facets elsewhere (edges, tip, fillets, platform).

    Points stand about CLOUD_SPACING apart. Walls of cavities and bores, which no wheel can touch, are not in it. Those of the
    shapes asked for last are at hand.
    """
    key = blade.content
    known, cloud = _latest.get(key, (None, None))
    if known is not shape or cloud is None:
        cloud = _cloud_of(shape, blade)
        while len(_latest) >= KEPT:
            del _latest[next(iter(_latest))]
        _latest[key] = shape, cloud
    return cloud


def _cloud_of(shape: AerofoilShape, blade: Blade) -> SurfaceCloud:
    points, normals = [], []
    for side in shape.sides.values():
        n_u = int(np.ceil(side.width.max() / CLOUD_SPACING)) + 1
        n_v = int(np.ceil(shape.frame.length / CLOUD_SPACING)) + 1
        # Denser toward the edges, where the surface turns.
        u = 0.5 - 0.5 * np.cos(np.linspace(0.0, np.pi, n_u + n_u // 2))
        grid = np.meshgrid(u, np.linspace(float(shape.v[0]), float(shape.v[1]), n_v), indexing="ij")
        u_all, v_all = (g.ravel() for g in grid)
        points.append(side.surface(u_all, v_all))
        normals.append(side.normal(u_all, v_all))
    smooth = np.vstack(points)
    tree = cKDTree(smooth)
    off = np.flatnonzero((tree.query(blade.vertices)[0] > CLOUD_SPACING)[blade.faces].any(axis=1))
    inner = off[enclosed(blade.vertices, blade.faces, off)]
    other, other_normals = _facet_points(blade.vertices, np.delete(blade.faces, inner, axis=0))
    apart = tree.query(other)[0] > CLOUD_SPACING
    return SurfaceCloud(np.vstack([smooth, other[apart]]), np.vstack([*normals, other_normals[apart]])).laid()


def _facet_points(vertices: Array, faces: NDArray[np.int64]) -> tuple[Array, Array]:
    """Points on facets (nf, 3) about CLOUD_SPACING apart, (m, 3) m, and the facets' normals (m, 3)."""
    vertices, faces = trimesh.remesh.subdivide_to_size(vertices, faces, 1.5 * CLOUD_SPACING, max_iter=12)
    corner = vertices[faces]
    normal = np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0])
    length = np.linalg.norm(normal, axis=1)
    sound = length > 0
    used, first = np.unique(faces[sound].ravel(), return_index=True)
    return vertices[used], np.repeat(normal[sound] / length[sound, None], 3, axis=0)[first]


def _pass_options(cell: Cell, step: float) -> PassOptions:
    process, piece = cell.process, cell.workpiece
    same = ("side", "root_margin", "tip_margin", "edge_margin", "feed", "force")
    return PassOptions(
        **{name: getattr(process, name) for name in same},
        clamp_normal=(float(piece.clamp_normal[0]), float(piece.clamp_normal[1]), float(piece.clamp_normal[2])),
        clamp_offset=piece.clamp_offset,
        clamp_side="below",
        direction=process.passes,
        spacing=process.pass_spacing,
        step=step,
        wheel_radius=cell.wheel.radius + WHEEL_ROOM,
        wheel_width=cell.wheel.width + 2 * WHEEL_ROOM,
    )


APART = 3e-3  # m between nominal blade and wheel: poses farther off are approach, not contact
STRIP = 2.5e-3  # m about the wheel's middle plane and the deepest point that the local fit uses
SAME_FEED = 0.05  # by which the feed may change within a pass that has one
LEAST_POINTS = 3  # of contact on a pass: through two no curve on a twisted blade is known
LEAST_SPACING = 9e-4  # m between contact points that are kept: programs crowd points where they start and stop


def paths_from_program(
    cell: Cell, blade: Blade, shape: AerofoilShape, cloud: SurfaceCloud, source: Path, step: float
) -> tuple[list[BladePath], list[str]]:
    """Passes of an old program on the blade, through the nominal kinematics as its author meant it, and notices.

    The contact point of a pose is the blade's deepest point toward the wheel's axis in the wheel's middle plane.
    Raises BadInput: unreadable program, or none of its poses brings the blade to the wheel.
    """
    execution = dialect_named(cell.controller.dialect).read(source)
    old, notes = contact_frames_from_program(
        execution, lambda q: forward(cell.robot, q), cell.workpiece.T_flange_blade, wheel_frame(cell)
    )
    touching = {number: found for number, one in enumerate(old, 1) if len(found := _touching(cell, cloud, one)) >= LEAST_POINTS}
    if not touching:
        most = max(len(_touching(cell, cloud, one)) for one in old)
        if most:
            raise BadInput(
                f"{source}: its path motions touch the wheel at {most} points at most, {LEAST_POINTS} are needed to know a path "
                f"on the blade; put points between them, at least {1e3 * LEAST_SPACING:g} mm apart"
            )
        raise BadInput(
            f"{source}: none of its {len(old)} path motions brings the blade within {APART * 1e3:g} mm of the wheel; "
            "is it a program of this cell, blade and tool frame?"
        )
    points = sum(map(len, touching.values()))
    told = f"{source.name}: {len(touching)} of {len(old)} path motions touch the wheel, {points} contact points are taken."
    rows = [_resampled(found, step) for found in touching.values()]
    p, n, t = (np.vstack(part) for part in zip(*(r[:3] for r in rows), strict=True))
    line = np.repeat(list(touching), [len(r[0]) for r in rows])
    nearest = [found[k] for found, r in zip(touching.values(), rows, strict=True) for k in r[3]]
    # One feed a pass: where a program begins and ends to grind it is slower, with less force than is planned here.
    feeds = [np.median([cell.process.feed if np.isnan(one.feed) else one.feed for one in found]) for found in touching.values()]
    feed, force = np.repeat(feeds, [len(r[0]) for r in rows]), np.full(len(p), cell.process.force)
    places = [one.place for one in nearest]
    paths, more = paths_from_points(blade, shape, line, p, n, t, feed, force, source.name, places, step)
    return paths, [*notes, told, *_feed_notices(cell, source.name, touching), *more]


@dataclass(frozen=True)
class _OldContact:
    """Contact point and outward normal (3,) in the blade frame; where the program has it; its feed m/s, nan where untold; the
    time s in a block that has them, else nan."""

    p: Array
    n: Array
    place: str
    feed: float
    time: float


def _touching(cell: Cell, cloud: SurfaceCloud, one: OldPass) -> list[_OldContact]:
    """The contacts of one path motion, those that are crowded left out; in a block with times at the feed they make."""
    contacts: list[_OldContact] = []
    times = np.full(len(one.lines), np.nan) if one.times is None else one.times
    for T, line, feed, time in zip(one.flange @ cell.workpiece.T_flange_blade, one.lines, one.feed, times, strict=True):
        found = _contact(cell, cloud, T)
        if found is not None and not (contacts and np.linalg.norm(found[0] - contacts[-1].p) < LEAST_SPACING):
            contacts.append(_OldContact(*found, f"{one.file}, line {line}", float(feed), float(time)))
    if one.times is None or len(contacts) < LEAST_POINTS:
        return contacts
    s = np.cumsum(np.linalg.norm(np.diff([each.p for each in contacts], axis=0, prepend=[contacts[0].p]), axis=1))
    rates = np.gradient(s, [each.time for each in contacts])
    return [replace(each, feed=float(rate)) for each, rate in zip(contacts, rates, strict=True)]


def _feed_notices(cell: Cell, name: str, touching: dict[int, list[_OldContact]]) -> list[str]:
    """Where the feed of a pass is not the one that a program drives all along it."""
    told = {number: np.array([one.feed for one in found]) for number, found in touching.items()}
    without = [number for number, feeds in told.items() if np.isnan(feeds).any()]
    inner = {number: feeds[1:-1] for number, feeds in told.items() if not np.isnan(feeds).any()}
    varied = {number: feeds for number, feeds in inner.items() if np.ptp(feeds) > SAME_FEED * np.median(feeds)}
    notices = []
    if without:
        notices.append(
            f"{name}: neither times nor $VEL.CP are known in {len(without)} of its {len(told)} passes; the cell's feed, "
            f"{1e3 * cell.process.feed:g} mm/s, is taken there"
        )
    if varied:
        number, feeds = max(varied.items(), key=lambda one: float(np.ptp(one[1]) / np.median(one[1])))
        notices.append(
            f"{name}: the feed changes inside of {len(varied)} of its {len(told)} passes, most in path motion {number}, from "
            f"{1e3 * feeds.min():.3g} to {1e3 * feeds.max():.3g} mm/s; each gets one feed, the median of its points"
        )
    return notices


def _resampled(contacts: list[_OldContact], step: float) -> tuple[Array, Array, Array, NDArray[np.int64]]:
    """Points, normals and unit directions of travel of one pass every `step` m along the curve through its contacts, and which
    contact is next."""
    known = np.array([one.p for one in contacts])
    s = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(known, axis=0), axis=1))])
    even = np.linspace(0.0, s[-1], max(int(np.ceil(s[-1] / step)) + 1, 8))
    p, n = CubicSpline(s, known)(even), CubicSpline(s, np.array([one.n for one in contacts]))(even)
    n /= np.linalg.norm(n, axis=1, keepdims=True)
    t = np.gradient(p, axis=0)
    t -= n * np.sum(t * n, axis=1, keepdims=True)
    return p, n, t / np.linalg.norm(t, axis=1, keepdims=True), np.abs(even[:, None] - s).argmin(axis=1)


def _contact(cell: Cell, cloud: SurfaceCloud, T: Array) -> tuple[Array, Array] | None:
    """Contact point and outward normal (blade frame) of a blade pose (4, 4), or None off the wheel."""
    wheel = cell.wheel
    lateral, radial, rho = wheel.cylindrical(apply(T, cloud.points))
    facing = np.sum((cloud.normals @ T[:3, :3].T) * radial, axis=1) < -FACING * rho
    strip = np.flatnonzero(facing & (np.abs(lateral) < STRIP))
    if len(strip) < 8:
        return None
    deepest = strip[np.argmin(rho[strip])]
    if rho[deepest] > wheel.radius + APART:
        return None
    near = strip[np.linalg.norm(cloud.points[strip] - cloud.points[deepest], axis=1) < 1.5 * STRIP]
    e = radial[deepest] / rho[deepest]
    x = wheel.radius * np.arctan2(radial[near] @ np.cross(wheel.axis, e), radial[near] @ e)
    y = lateral[near]
    terms = np.column_stack([np.ones_like(x), x, y, x * x, x * y, y * y])
    fit = np.linalg.lstsq(terms, np.column_stack([rho[near], cloud.points[near], cloud.normals[near]]), rcond=None)[0]
    # Deepest along the belt in the middle plane y = 0: d rho / dx = 0.
    at = -0.5 * fit[1, 0] / fit[3, 0] if fit[3, 0] > 0 else 0.0
    at = float(np.clip(at, -STRIP, STRIP))
    value = np.array([1.0, at, 0.0, at * at, 0.0, 0.0]) @ fit
    return value[1:4], value[4:7] / np.linalg.norm(value[4:7])
