"""Where lines lie and how fast each is ground, so that all of them together take off what is wanted.

Distances follow from the patch's width; feeds are the dwell times under which the sum over all lines comes nearest to what is
wanted: linear least squares in r at nodes of all lines at once (docs/process.md, eq. 6 and 7).
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import casadi as ca
import numpy as np
from scipy.sparse import block_diag, csc_matrix, csr_matrix, diags_array, eye_array, hstack, vstack
from scipy.spatial import cKDTree

from ocp.contact.wheel.cover import Cover
from ocp.model.cell import Cell
from ocp.plan.passes.course import LEAST_PEAK, Engagement, air_to_air, lengthened, path_at, peak_share, steady
from ocp.plan.passes.smoothness import node_times
from ocp.plan.passes.solve import TURN_KEPT
from ocp.plan.passes.stretches import CannotGrind
from ocp.plan.removal.footprint import LinePatches, Pressing, planned_patches_of
from ocp.plan.removal.surface import ContactRows, Mask, SideCells, core_cells, pressures
from ocp.plan.removal.wanted import Wanted, refuse_uncovered
from ocp.plan.rules import FEEDS, LEAST_RAMP
from ocp.shell.processes import side_by_side
from robots.errors import Infeasible
from robots.pose import Array
from trajectories.passes import BladePath

EVEN, LEAST_EVEN = 0.6, 0.3  # of the patch's half-width between lines, at most and at least
UNEVEN = 0.03  # of the mean depth, up or down, that lines may leave between them at the distance chosen and ...
NARROWER = 0.85  # ... at distances down to this share of it: lines come nearer where the blade is narrower
ASKEW = np.array([0.25, 0.475, 0.7, 0.95])  # of the turn tolerance, which a wheel is turned to even out its edges
NEARLY = 0.97  # of the largest distance of lines, for which a wheel is not turned any farther
STEPS = 0.06  # of the mean depth, up or down, at EVEN: more has other reasons than the roundness of a patch
PROBE = 6e-3  # m, at most, between the lines on which the patch is looked at before lines are laid
NODE = 4e-3  # m between places of a line where r is free; linear in between
ROW = 1e-3  # m between the contacts that are summed
ROUNDS = 3  # fits of the feeds, each with the ramps of the one before
KEPT = 0.05  # weight of keeping to the r of evenly shared lines, against the miss of a cell
SMOOTH = 1.0  # weight of the second difference of r along a line, against the same
SHALLOW = 0.2  # of the mean wanted depth, below which a miss counts as there: misses are counted over what is wanted
RANGE = (0.5, 2.0)  # of the r of evenly shared lines: no more is asked of an arm


def probed_lines(
    pressing: Pressing, cover: Cover, probes: Sequence[BladePath]
) -> tuple[dict[str, tuple[Array, Array]], list[BladePath]]:
    """`PassOptions.spread` from lines laid to look at, all of a side, and those lines with the turn at which each may lie
    farthest from the next.

    A wheel that stands askew presses the ends of its width on slanting lines: what sums up to steps beside each other under a
    straight wheel runs out over the patch's length. All lines of a side are turned alike: a patch's shape goes with its turn, and
    a line between others of another shape leaves a stripe. A line that is too hollow for the wheel asks for nothing.
    """
    spread, looked = {}, []
    for side in dict.fromkeys(path.side for path in probes):
        lines = [path for path in probes if path.side == side]
        straight = planned_patches_of(pressing, cover, lines)
        shares = np.linspace(0.0, 1.0, len(lines)) if len(lines) > 1 else np.array([0.5])
        known = [(*one, patches) for *one, patches in zip(shares, lines, straight, strict=True) if patches is not None]
        if known:
            turn, spacing = _turned(pressing, cover, [(path, patches) for _, path, patches in known])
            spread[side] = (np.array([share for share, _, _ in known]), spacing)
            looked += [replace(path, turn=turn) for _, path, _ in known]
    return spread, looked


def _turned(pressing: Pressing, cover: Cover, lines: Sequence[tuple[BladePath, LinePatches]]) -> tuple[float, Array]:
    """The turn for a side's lines, each with its footprints under a wheel that stands straight, and the even distance m beside
    each: none where sums of most have no steps without, else the least at which distances are nearly the largest, judged at the
    part of it that the optimiser keeps to."""
    ways = [(0.0, np.array([even_spacing(straight) for _, straight in lines]))]
    if np.median([own.unevenness(EVEN * float(own.half_axes[:, 1].min())).max() for _, own in lines]) <= STEPS:
        return ways[0]
    turns = np.outer(pressing.turn_tolerance * ASKEW, (1.0, -1.0)).ravel()
    tried = [replace(path, turn=TURN_KEPT * float(one)) for one in turns for path, _ in lines]
    turned = planned_patches_of(pressing, cover, tried)
    for k, turn in enumerate(turns):
        patches = turned[k * len(lines) : (k + 1) * len(lines)]
        spacing = [least if own is None else even_spacing(own) for own, least in zip(patches, ways[0][1], strict=True)]
        ways.append((float(turn), np.array(spacing)))
    largest = max(spacing.sum() for _, spacing in ways)
    return next(way for way in ways if way[1].sum() >= NEARLY * largest)


def askew(paths: Sequence[BladePath], looked: Sequence[BladePath]) -> list[BladePath]:
    """The paths with the turns of those lines looked at that they lie next to."""
    turned = []
    for path in paths:
        near = [one for one in looked if one.side == path.side]
        far = [np.linalg.norm(one.p - path.p[len(path.p) // 2], axis=1).min() for one in near]
        turned.append(replace(path, turn=near[int(np.argmin(far))].turn) if near else path)
    return turned


def even_spacing(patches: LinePatches) -> float:
    """The largest distance m of lines, from EVEN to LEAST_EVEN of the smallest half-width along the line, from which on their
    sum is even; LEAST_EVEN where none is.

    A parabolic profile is even at 0.6. A flat or hollow blade under a narrow wheel is pressed over the wheel's whole width: the
    sum of such boxes steps by a line more or less.
    """
    share = np.arange(EVEN, LEAST_EVEN - 1e-9, -0.025)
    spacing = share * patches.half_axes[:, 1].min()
    even = np.array([patches.unevenness(one).max() <= UNEVEN for one in spacing])
    for k in range(len(share)):
        if even[(share <= share[k]) & (share >= NARROWER * share[k])].all():
            return float(spacing[k])
    return float(spacing[-1])


@dataclass(frozen=True)
class _Line:
    """What a line adds: matrix (cells, nodes) of depth over the programmed one under r = 1; nodes (k,) m."""

    depth: csr_matrix
    nodes: Array


@dataclass(frozen=True)
class DrivenLine:
    """A line as it will be driven, in its direction of travel: its path, footprints at its postures, by how much farther (k,) m
    the wheel is pressed in at them than its table has it, how contact begins and ends on it, and how far (m) before and behind
    the line."""

    path: BladePath
    patches: LinePatches
    missed: Array
    entry: Engagement
    room: tuple[float, float]

    def rows(self) -> ContactRows:
        """Contact from touch to lift; `slide` (n,) is the way m that each row stands for."""
        path = lengthened(self.path, *self.room)
        try:
            course = air_to_air(path, self.entry, ROW / float(path.feed.mean()))
        except Infeasible:  # a line too short for its ramps is left out later, by name
            course = steady(self.path)
        on = course.share > 0
        at, way = path_at(path, course.s[on]), (node_times(course) * course.speed)[on]
        return ContactRows(np.zeros(len(at.s), int), at.p, at.n, at.t, at.s, at.force * course.share[on], way)


@dataclass(frozen=True)
class _Asked:
    """The asked cells of the flanks: as a tree, normals (m, 3), the wanted depth (m,), the weight (m,) of a miss before it is
    known where lines lie."""

    tree: cKDTree
    normals: Array
    depth: Array
    weight: Array

    @staticmethod
    def of(flanks: Sequence[SideCells], wanted: Wanted) -> "_Asked":
        points, normals, area = (
            np.concatenate([getattr(one, name)[one.asked] for one in flanks]) for name in ("points", "normals", "area")
        )
        depth = wanted.at(points, normals)
        refuse_uncovered(wanted, points, normals)
        weight = np.sqrt(area / area.mean()) / np.maximum(depth, SHALLOW * depth.mean())
        return _Asked(cKDTree(points), normals, depth, weight)


def even_lines(
    pressing: Pressing, cover: Cover, paths: Sequence[BladePath], flanks: Sequence[SideCells], wanted: Wanted
) -> list[Array | None]:
    """r (n,) at the waypoints of the paths, by which all of them together take off what is wanted on the asked cells of the
    flanks: the programmed feed over r. None for a path on which the wheel bears nowhere, or off the flanks; nothing without any.

    Raises BadInput: a map of the wanted depth leaves asked surface out.
    """
    if not flanks:
        return []
    found: list[Array | None] = [None] * len(paths)
    asked, lines = _Asked.of(flanks, wanted), {}
    for k, (path, patches) in enumerate(zip(paths, planned_patches_of(pressing, cover, paths), strict=True)):
        if patches is not None:
            lines[k] = _line(pressing, path, straight_on(path, patches), patches, asked)
    if lines:
        r = _solved(list(lines.values()), asked.weight * _passed(flanks, [paths[k] for k in lines]), asked.depth)
        for (k, line), own in zip(lines.items(), r, strict=True):
            found[k] = np.interp(paths[k].s, line.nodes, own)
    return found


def at_feeds(
    cell: Cell, paths: Sequence[BladePath], r: Sequence[Array | None], wanted: Wanted
) -> tuple[list[BladePath], list[CannotGrind]]:
    """The paths at the feeds of `even_lines`, and what of them is beyond what the programmed force and the feeds of
    `ocp.plan.rules.FEEDS` reach. A path without r keeps its feed."""
    if not r:
        return list(paths), []
    feed = cell.process.feed
    timed = [path if own is None else replace(path, feed=feed / own) for path, own in zip(paths, r, strict=True)]
    beyond = [error for path in timed if (error := beyond_reach(cell, path, wanted)) is not None]
    return [replace(path, feed=np.clip(path.feed, *programmable(path))) for path in timed], beyond


def even_feeds(cell: Cell, flanks: Sequence[SideCells], wanted: Wanted, lines: Sequence[DrivenLine | None]) -> list[Array | None]:
    """Feeds (n,) m/s at the waypoints of the lines that together take off what is wanted, with the footprints at their postures
    and the force that rises and falls at their ends; None keeps a line as it is, without a part in the sum.

    What leads in and out lasts the same time at any feed, so it covers another way: the fit is made ROUNDS times.
    """
    known = {k: line for k, line in enumerate(lines) if line is not None}
    if not known or not flanks:
        return [None] * len(lines)
    asked = _Asked.of(flanks, wanted)
    weight, pressing = asked.weight * _passed(flanks, [line.path for line in known.values()]), Pressing.of(cell)
    for _ in range(ROUNDS):
        with side_by_side(_driven, [(line,) for line in known.values()], pressing, asked) as found:
            added = dict(zip(known, found, strict=True))
        r = _solved(list(added.values()), weight, asked.depth)
        for (k, line), own in zip(known.items(), r, strict=True):
            timed = replace(line.path, feed=cell.process.feed / np.interp(line.path.s, added[k].nodes, own))
            known[k] = replace(line, path=replace(timed, feed=np.clip(timed.feed, *programmable(timed))))
    return [known[k].path.feed if k in known else None for k in range(len(lines))]


def _passed(flanks: Sequence[SideCells], paths: Sequence[BladePath]) -> Mask:
    """Which asked cells of the flanks lie beside a line and between two: what lies beyond the ends or the outermost line is not
    made good by grinding deeper before it. Beside a line alone all count."""
    ends = np.concatenate([np.r_[True, np.zeros(len(path.s) - 2, bool), True] for path in paths])
    tree, found = cKDTree(np.vstack([path.p for path in paths])), []
    for one in flanks:
        beside = ~ends[tree.query(one.points[one.asked])[1]]
        alone = sum(path.side == one.side for path in paths) < 2
        found.append(beside & (alone | core_cells(one, paths, np.zeros(len(paths)))[one.asked]))
    return np.concatenate(found)


def straight_on(path: BladePath, patches: LinePatches) -> ContactRows:
    """Contact on a line of which the ends are not known yet: what leads in to it and out of it goes on straight for a patch's
    half-length, under the full force. As `DrivenLine.rows`."""
    length, beyond = float(path.s[-1]), float(patches.half_axes[:, 0].max())
    s = np.linspace(-beyond, length + beyond, int(np.ceil((length + 2 * beyond) / ROW)) + 1)
    inside = np.clip(s, 0.0, length)
    p, n, t = (np.column_stack([np.interp(inside, path.s, of[:, i]) for i in range(3)]) for of in (path.p, path.n, path.t))
    n, t = (v / np.linalg.norm(v, axis=1, keepdims=True) for v in (n, t))
    force = np.interp(inside, path.s, path.force)
    return ContactRows(np.zeros(len(s), int), p + (s - inside)[:, None] * t, n, t, inside, force, np.full(len(s), s[1] - s[0]))


def _driven(pressing: Pressing, asked: _Asked, line: DrivenLine) -> _Line:
    """What a line adds as it will be driven."""
    return _line(pressing, line.path, line.rows(), line.patches, asked)


def _line(pressing: Pressing, path: BladePath, rows: ContactRows, patches: LinePatches, asked: _Asked) -> _Line:
    """A line with what leads in to it and out of it, there at the r of its ends; under r = 1 force goes with feed, so that every
    row takes what the path's force takes on the way that it stands for."""
    length = float(path.s[-1])
    row, index, pressure = pressures(asked.tree, asked.normals, rows, patches)
    inside = np.clip(rows.s, 0.0, length)
    share = np.interp(inside, path.s, path.force) / pressing.force * rows.slide * pressing.spacing
    depth = csr_matrix((pressure * share[row], (index, row)), shape=(len(asked.normals), len(rows.s)))
    nodes = np.linspace(0.0, length, max(int(np.ceil(length / NODE)), 2) + 1)
    place = inside / nodes[1]
    below, k = np.minimum(place.astype(int), len(nodes) - 2), np.arange(len(rows.s))
    weight = place - below
    hats = csr_matrix((np.r_[1.0 - weight, weight], (np.r_[k, k], np.r_[below, below + 1])), shape=(len(k), len(nodes)))
    return _Line(csr_matrix(depth @ hats), nodes)


def _solved(lines: Sequence[_Line], weight: Array, wanted: Array) -> list[Array]:
    """r at the nodes of every line that brings the cells (weighed, m) nearest to `wanted` (m,), near that of evenly shared
    lines: the wanted depth over the depth under r = 1, both averaged over what a node reaches."""
    depth = hstack([line.depth for line in lines]).tocsr()
    reached = depth.T @ diags_array(weight**2)
    usual = (reached @ wanted) / np.maximum(reached @ (depth @ np.ones(depth.shape[1])), 1e-12)
    usual = np.where(usual > 0.0, usual, 1.0)
    bends = [diags_array([1.0, -2.0, 1.0], offsets=[0, 1, 2], shape=(len(one.nodes) - 2, len(one.nodes))) for one in lines]
    kept, smooth, count = np.sqrt(KEPT), np.sqrt(SMOOTH), len(usual)
    rows = vstack([diags_array(weight) @ depth @ diags_array(usual), kept * eye_array(count), smooth * block_diag(bends)]).tocsr()
    goal = np.concatenate([weight * wanted, np.full(count, kept), np.zeros(sum(one.shape[0] for one in bends))])
    normal = ca.DM(csc_matrix(rows.T @ rows).sorted_indices())
    program = ca.conic("feeds", "piqp", {"h": normal.sparsity(), "a": ca.Sparsity(0, count)})  # raises where it does not converge
    found = program(h=normal, g=-(rows.T @ goal), lbx=RANGE[0], ubx=RANGE[1])
    r = usual * np.asarray(found["x"]).ravel()
    return np.split(r, np.cumsum([len(one.nodes) for one in lines])[:-1])


def programmable(path: BladePath) -> tuple[float, float]:
    """The least and the largest feed m/s that a line may be programmed with: those of FEEDS; on a short line force and feed rise
    together to a share of the programmed ones only."""
    seconds = float(np.sum(np.diff(path.s) / (0.5 * (path.feed[1:] + path.feed[:-1]))))
    return FEEDS[0], FEEDS[1] / max(peak_share(seconds, 0.5 * LEAST_RAMP), LEAST_PEAK)


def beyond_reach(cell: Cell, path: BladePath, wanted: Wanted) -> CannotGrind | None:
    """Where a line's feed is more or less than `programmable`, why, and what would do; None where it is not."""
    least, most = programmable(path)
    beyond = (path.feed < least) | (path.feed > most)
    if not beyond.any():
        return None
    k = int(np.argmax(np.where(beyond, np.abs(np.log(path.feed / cell.process.feed)), -1.0)))
    depth, slow = wanted.at(path.p[k : k + 1], path.n[k : k + 1])[0], path.feed[k] < least
    unit = "times the programmed depth" if wanted.programmed_um is None else "um"
    reason = (
        f"{depth * (wanted.programmed_um or 1.0):.3g} {unit} are wanted, which takes a feed of {1e3 * path.feed[k]:.3g} mm/s at "
        f"{path.force[k]:g} N, and {1e3 * least:.3g} to {1e3 * most:.3g} can be driven"
    )
    share = float(0.99 * path.feed[beyond].min() / least if slow else 1.01 * path.feed[beyond].max() / most)  # told to 3 digits
    more = "grind it more than once, or with a larger process.force_N" if slow else "leave that place unground"
    if wanted.programmed_um is None:  # the depth is what the process makes at its feed
        remedy = f"set process.feed_mm_s to {1e3 * cell.process.feed / share:.3g}, or {more}"
    else:
        remedy = more if slow else "ask for more depth there, lower process.force_N, or leave that place unground"
    return CannotGrind.of(path, beyond, reason, remedy, k)


def feeds_told(cell: Cell, paths: Sequence[BladePath], wanted: Wanted, laid: bool) -> str:
    """A sentence on how many lines there are, how fast they are ground, and which of them at the end of what can be driven;
    `laid`: at distances chosen here."""
    feed = np.concatenate([path.feed for path in paths])
    number, ends = len({path.line for path in paths}), [(path, *programmable(path)) for path in paths]
    held = sorted({path.line for path, least, most in ends if path.feed.min() <= least or path.feed.max() >= most})
    what = f"lie at most {EVEN:g} of the contact's half-width apart, so that their sum is smooth; their" if laid else "have"
    told = (
        f"{number} lines {what} feeds {'are ' if laid else 'of '}{1e3 * feed.min():.0f} to {1e3 * feed.max():.0f} mm/s, which "
        f"together make {wanted.told()} process.feed_mm_s = {1e3 * cell.process.feed:g} at process.pass_spacing_mm = "
        f"{1e3 * cell.process.pass_spacing:g}."
    )
    if held:
        told += (
            f" The feeds of lines {', '.join(map(str, held))} are at an end of what can be driven: the map shows what it costs."
        )
    return told
