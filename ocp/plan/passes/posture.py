"""Where the optimiser starts: branch, direction of travel, place on the wheel and turn, found over the whole grid.

For every pass all inverse-kinematic branches and axis turns are tried on a grid of wheel arc, turn about the normal and
direction of travel, the arc held or rolled along (the shortest path through stations x arcs); the best per family (direction,
branch, turns) compete in a shortest path over the passes, so that neither a pass nor the travel between passes depends on luck.
"""

from collections.abc import Callable
from dataclasses import dataclass, fields
from itertools import product
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline, PchipInterpolator

from ocp.contact.wheel.law import WheelLaw
from ocp.model.cell import Cell
from ocp.plan.clearance import Clearance, CollisionScene, flange_pose
from ocp.plan.passes.stretches import CannotGrind, LeftOut, LineStretch, cut_out
from ocp.plan.rules import AXIS_MARGIN, ELBOW_MARGIN, SEED_INDENTATION, SEED_SPEED_SHARE, SHOULDER_MARGIN, WRIST_MARGIN
from ocp.shell.processes import side_by_side
from robots.inverse import inverse_branches, reach_excess
from robots.pose import Array, make_transform
from trajectories.passes import BladePath

Index = NDArray[np.int64]
Mask = NDArray[np.bool_]

STATIONS = 7  # along a pass; between them a pass turns little
TRAVEL_WEIGHT = 0.5  # cost of a second of travel between passes
ROLLED_ARCS = 9  # places on the arc between which a seed may roll
ARC_WEIGHT, WRIST_WEIGHT, SPEED_WEIGHT = 0.3, 0.1, 3.0  # of a seed's cost
UNTURNED_WEIGHT = 8.0  # of what is missing in it of the turn that a path asks for


@dataclass(frozen=True)
class Seed:
    """Start of a pass: travel direction +1 or -1, place on the arc (STATIONS,) rad and joints (STATIONS, 6) at stations
    (fractions of the pass), turn rad, cost."""

    direction: int
    branch: int
    arc: Array
    turn: float
    q: Array
    at: Array
    cost: float


def contact_poses(cell: Cell, path: BladePath, index: Index, arc: Array, turn: Array, direction: int, sigma: int) -> Array:
    """Blade poses T_base_blade (..., len(index), 4, 4) that lay waypoints on the wheel.

    `arc`, `turn` (...) rad; touching, without overlap, in the middle of the wheel's width. docs/architecture.md.
    """
    return _laid_on(cell, path, index, arc[..., None], turn[..., None], direction, sigma)


def _laid_on(cell: Cell, path: BladePath, index: Index, arc: Array, turn: Array, direction: int, sigma: int) -> Array:
    """The same with places on the arc and turns (..., len(index) or 1) of every waypoint."""
    wheel = cell.wheel
    e = wheel.outward(arc)
    belt = np.cross(np.broadcast_to(wheel.axis, e.shape), e)
    heading = np.cos(turn)[..., None] * belt + np.sin(turn)[..., None] * wheel.axis
    t = -sigma * wheel.travel * heading
    base = np.stack([t, np.cross(-e, t), -e], axis=-1)
    n, feed = path.n[index], direction * path.t[index]
    local = np.stack([feed, np.cross(n, feed), n], axis=-1)
    R = base @ np.swapaxes(local, -1, -2)
    contact = wheel.centre + wheel.radius * e
    return make_transform(R, contact - (R @ path.p[index][..., None])[..., 0])


def poses_along(cell: Cell, path: BladePath, seed: Seed, overlap: Array, sigma: int) -> Array:
    """Blade poses (n, 4, 4) that lay every waypoint of `path` (in its direction of travel) on the wheel as the seed does.

    `overlap` (n,) m of the undeformed bodies.
    """
    n = len(path.s)
    arc = PchipInterpolator(seed.at, seed.arc)(_fraction(path))
    T = _laid_on(cell, path, np.arange(n), arc, np.array([seed.turn]), 1, sigma)
    T[:, :3, 3] += overlap[:, None] * np.einsum("kij,kj->ki", T[:, :3, :3], path.n)
    return T


def _fraction(path: BladePath) -> Array:
    """Where on a seed the nodes (n,) stand, 0 to 1: what leads in and out beyond the line takes part."""
    return np.asarray((path.s - path.s[0]) / (path.s[-1] - path.s[0]))


def joints_near(cell: Cell, path: BladePath, seed: Seed, T_base_blade: Array) -> Array:
    """Joints (n, 6) of the nominal arm for blade poses (n, 4, 4), on the seed's branch and turns.

    Raises CannotGrind where a waypoint between the seed's stations is out of reach.
    """
    q, reachable = inverse_branches(cell.robot, flange_pose(cell, T_base_blade))
    if not reachable[:, seed.branch].all():
        out = ~reachable[:, seed.branch]
        k = int(np.argmax(out))
        message = f"line {path.line} ({path.side}): waypoint {k + 1} is beyond the robot's reach"
        raise CannotGrind.of(path, out, "it is beyond the robot's reach", NEARER, k, message)
    near = CubicSpline(seed.at, seed.q)(_fraction(path))
    return np.asarray(near + (q[:, seed.branch] - near + np.pi) % (2 * np.pi) - np.pi)


def find_seeds(cell: Cell, scene: CollisionScene, law: WheelLaw, paths: list[BladePath]) -> list[list[Seed]]:
    """For each pass its collision-free seeds, one a family, the one of the cheapest chain over all passes first.

    The chain takes the passes in the order given; the others follow by cost, for the optimiser to fall back on.
    Raises CannotGrind: a pass has no reachable, collision-free posture; the message says what stands in the way.
    """
    return chained(cell, [seeds_of(cell, scene, law, path) for path in paths])


def seeds_of_stretches(
    cell: Cell,
    scene: CollisionScene,
    law: WheelLaw,
    stretches: list[LineStretch],
    whole: bool,
    meanwhile: Callable[[], Any] = lambda: None,
) -> tuple[list[LineStretch], list[list[Seed]], list[LeftOut]]:
    """The stretches, cut where there is no posture, with their seeds as `find_seeds` ranks them, and what is left out;
    `meanwhile` is done while others look for them.

    Raises CannotGrind as `find_seeds` does if the `whole` of them is asked for.
    """
    tried: list[tuple[LineStretch, list[Seed]]] = []
    lost = []
    with side_by_side(_seeds_or_why, [(one.path,) for one in stretches], cell, scene, law) as found:
        meanwhile()
        left: list[tuple[LineStretch, list[Seed] | CannotGrind | None]] = list(zip(stretches, found, strict=True))
    while left:
        one, seeds = left.pop(0)
        seeds = _seeds_or_why(cell, scene, law, one.path) if seeds is None else seeds
        if not isinstance(seeds, CannotGrind):
            tried.append((one, seeds))
        elif whole:
            raise seeds
        else:
            pieces, gone = cut_out(one, seeds)
            lost += gone
            left = [*((piece, None) for piece in pieces), *left]
    kept, options = [], []
    for one, seeds in tried:
        same = [other for other in tried if other[0].path.line == one.path.line]
        longest = max(same, key=lambda other: other[0].path.s[-1])
        direction = min(longest[1], key=lambda seed: seed.cost).direction
        try:
            options.append(seeds if len(same) == 1 else driven(one.path, seeds, direction))
            kept.append(one)
        except CannotGrind as error:
            lost += cut_out(one, error)[1]
    return kept, chained(cell, options) if options else [], lost


def driven(path: BladePath, seeds: list[Seed], direction: int) -> list[Seed]:
    """The seeds that drive a piece of a line in the `direction` of its other pieces: arc lengths along the line are one scale.

    Raises CannotGrind where there is none.
    """
    found = [seed for seed in seeds if seed.direction == direction]
    if not found:
        reason = "it could be ground in the direction only that the rest of its line does not allow"
        raise CannotGrind.of(path, np.ones(len(path.s), bool), reason, "move the wheel or the blade in its holder")
    return found


def chained(cell: Cell, options: list[list[Seed]]) -> list[list[Seed]]:
    """The seeds of every pass, the one of the cheapest chain over all passes first, then by cost."""
    cost = [np.array([seed.cost for seed in seeds]) for seeds in options]
    total, back = cost[0], []
    for k in range(1, len(options)):
        step = TRAVEL_WEIGHT * _travel(cell, options[k - 1], options[k])
        through = total[:, None] + step
        back.append(np.argmin(through, axis=0))
        total = through.min(axis=0) + cost[k]
    choice = [int(np.argmin(total))]
    for pointers in reversed(back):
        choice.append(int(pointers[choice[-1]]))
    ranked = []
    for seeds, best in zip(options, reversed(choice), strict=True):
        others = sorted((s for i, s in enumerate(seeds) if i != best), key=lambda s: s.cost)
        ranked.append([seeds[best], *others])
    return ranked


def _travel(cell: Cell, before: list[Seed], after: list[Seed]) -> Array:
    """Seconds from the end of each seed to the start of each of the next, (len(before), len(after))."""
    end = np.array([s.q[-1] for s in before])[:, None]
    start = np.array([s.q[0] for s in after])[None]
    return np.asarray((np.abs(end - start) / cell.robot.qd_max).max(axis=-1))


def _seeds_or_why(cell: Cell, scene: CollisionScene, law: WheelLaw, path: BladePath) -> "list[Seed] | CannotGrind":
    """`seeds_of`, or why there are none."""
    try:
        return seeds_of(cell, scene, law, path)
    except CannotGrind as error:
        return error


def seeds_of(cell: Cell, scene: CollisionScene, law: WheelLaw, path: BladePath) -> list[Seed]:
    """The best collision-free seed of every family of a pass. Raises CannotGrind where it has none."""
    index = np.unique(np.linspace(0, len(path.s) - 1, STATIONS).round().astype(int))
    low, high = cell.wheel.arc
    found: list[Seed] = []
    reasons: list[tuple[float, str]] = []
    turns = posture_grid(cell)[1]
    bears = _bears(cell, law, path, index, turns, reasons)
    for direction in (1, -1) if bears.any() else ():
        order = index[::direction]
        held = _held(cell, path, order, direction, turns[bears], reasons)
        rolled = _rolled(cell, path, order, direction, turns[bears][::2])
        found += _families(cell, path, order, direction, held.with_(rolled), reasons)
    free: dict[tuple[int, ...], Seed] = {}
    blocked = ""
    for seed in sorted(found, key=lambda s: s.cost):
        family = _family(seed)
        if family in free:
            continue
        clearance = scene.clearance(seed.q, in_contact=True)
        if clearance.value >= 0:
            free[family] = seed
        elif not blocked:
            blocked = clearance.sentence()
    if not free:
        reason = f"every reachable posture collides: {blocked}" if blocked else max(reasons, key=lambda r: r[0])[1]
        remedy = "move the wheel or the blade in its holder, or widen the arc or the turn"
        message = (
            f"line {path.line} ({path.side}): no posture on the wheel's arc "
            f"{np.degrees(low):.0f}..{np.degrees(high):.0f} deg with turn within "
            f"{np.degrees(cell.process.turn_tolerance):.0f} deg: {reason}; {remedy}"
        )
        where, why, would_do = impossible(cell, scene, law, path)
        raise CannotGrind.of(path, where, why or reason, would_do or remedy, message=message)
    return list(free.values())


PROBE = 3e-3  # m between the waypoints that are looked at one by one
PROBED = 24  # postures of such a waypoint that are looked at for collisions
NEARER = "move the wheel nearer, or use a shorter holder"


def impossible(cell: Cell, scene: CollisionScene, law: WheelLaw, path: BladePath) -> tuple[Mask, str, str]:
    """Waypoints (n,) at which no posture on the wheel is sound whatever its neighbours do, looked at every PROBE m; why, and what
    would do. Of several reasons the most frequent one, with its waypoints alone; none of them: ("", "")."""
    index = np.unique(np.linspace(0, len(path.s) - 1, max(int(path.s[-1] / PROBE), 2)).round().astype(int))
    arcs, turns = posture_grid(cell)
    bears = _bearing(cell, law, path, index, turns)
    arc, turn = (grid.ravel() for grid in np.meshgrid(arcs, turns, indexing="ij"))
    on = np.tile(bears, (len(arcs), 1))  # (grid, stations)
    kind = np.where(bears.any(axis=0), "reach", "hollow").astype("<U8")
    excess, blocked = np.full(len(index), np.inf), ""
    for direction in (1, -1):
        T = flange_pose(cell, contact_poses(cell, path, index, arc, turn, direction, cell.process.sigma))
        q, reachable = inverse_branches(cell.robot, T.reshape(-1, 4, 4))
        q, reachable = q.reshape(*on.shape, 8, 6), reachable.reshape(*on.shape, 8)
        over = reach_excess(cell.robot, T.reshape(-1, 4, 4)).reshape(on.shape)
        excess = np.minimum(excess, np.where(on, over, np.inf).min(axis=0))
        reached = reachable & on[..., None]
        sound = reached & keeps_ranges(cell, np.where(reached[..., None], q, 0.0))
        for k in map(int, np.flatnonzero(kind != "hollow")):
            if kind[k] == "free" or not reached[:, k].any():
                continue
            if not sound[:, k].any():
                kind[k] = "axes" if kind[k] == "reach" else kind[k]
                continue
            postures = q[:, k][sound[:, k]]
            found = scene.clearances(postures[:: max(len(postures) // PROBED, 1)], in_contact=True)
            kind[k] = "free" if found[0].max() >= 0 else "collides"
            if kind[k] == "collides":
                best = int(np.argmax(found[0]))
                blocked = Clearance(float(found[0][best]), k, found[1][best]).sentence()
    reasons, counts = np.unique(kind[kind != "free"], return_counts=True)
    if not len(reasons):
        return np.zeros(len(path.s), bool), "", ""
    worst = str(reasons[np.argmax(counts)])
    nearest = np.abs(path.s[:, None] - path.s[index]).argmin(axis=1)
    far = f"the blade would have to be held {1e3 * excess[kind == worst].max():.0f} mm beyond the robot's reach"
    texts = {
        "hollow": lambda: _hollow(cell, law, path, index[kind == "hollow"]),
        "reach": lambda: (far, NEARER),
        "axes": lambda: (
            "every posture is beyond an axis' range or near a singularity",
            "turn the blade in its holder, or widen the arc or the turn",
        ),
        "collides": lambda: (
            f"every reachable posture collides: {blocked}",
            "use a longer holder, a smaller wheel or another place for it",
        ),
    }
    return kind[nearest] == worst, *texts[worst]()


def posture_grid(cell: Cell) -> tuple[Array, Array]:
    """Places on the wheel's arc and turns, rad, from which seeds are taken."""
    return np.linspace(*cell.wheel.arc, 7)[1:-1], cell.process.turn_tolerance * np.linspace(-0.95, 0.95, 9)


def keeps_ranges(cell: Cell, q: Array) -> Mask:
    """Which of joints q (..., 6), each axis at any whole turn, keep range and singularities off by the margins."""
    robot = cell.robot
    low, high = robot.q_min + AXIS_MARGIN, robot.q_max - AXIS_MARGIN
    inside = (low + (q - low) % (2 * np.pi) <= high).all(axis=-1)
    elbow = np.abs(q[..., 2] - np.arctan2(robot.mdh[2, 2], robot.mdh[3, 1]))
    wrist = np.abs(np.sin(q[..., 4])) > np.sin(WRIST_MARGIN)
    return np.asarray(inside & wrist & (np.abs(wrist_radius(cell, q)) > SHOULDER_MARGIN) & (elbow > ELBOW_MARGIN))


def _hollow(cell: Cell, law: WheelLaw, path: BladePath, index: Index) -> tuple[str, str]:
    """In words: waypoints `index` are too hollow for the wheel; the width, radius or turn with which it would bear there. Or,
    where the blade is not hollow, that the cover hardly gives way.

    Shapes scale: a wheel s times as wide bears on a hollow 1/s^2 times as curved, as its edges then lie as deep.
    """
    wheel, turns = cell.wheel, posture_grid(cell)[1]
    reason = f"the blade is too hollow for a wheel {wheel.width * 1e3:.0f} mm wide with {wheel.radius * 1e3:.0f} mm radius"
    kxx, kyy, kxy = turned_curvature(path.curvature[index], turns[:, None], wheel.radius)
    steel = (kxx >= law.limits["kxx"][0]) & (kxx * kyy >= kxy**2)  # so hard a wheel would touch at the planned points
    if steel.any(axis=0).all():
        given = f"the wheel's cover gives way by less than {1e3 * SEED_INDENTATION:g} mm under {path.force[index].min():g} N"
        return f"{given}, from which no plan can start", "use a softer cover, or more force"
    remedies = []
    if (kxx.max(axis=0) < law.limits["kxx"][0]).any():
        least = float((kxx.max(axis=0) - 1 / wheel.radius).min())
        remedies.append(f"a wheel of at most {np.floor(500.0 / -least):.0f} mm radius")
    low, high = float(kyy.max(axis=0).min()), 0.0
    if low < 0.0:
        force, one = path.force[index[:1]], np.ones(1)
        for _ in range(40):
            middle = 0.5 * (low + high)
            d = law.evaluate(force, np.median(kxx) * one, middle * one, 0 * one, 0 * one, 0 * one, 0 * one)
            low, high = (low, middle) if d[0] > SEED_INDENTATION else (middle, high)
        share = np.sqrt(high / float(kyy.max(axis=0).min()))
        if 0.05 < share < 1.0:
            remedies.append(f"a wheel at most {np.floor(1e3 * wheel.width * share):.0f} mm wide")
    wider = np.radians(np.arange(-90.0, 91.0, 5.0))
    bears = _bearing(cell, law, path, index, wider).all(axis=1)
    if bears.any():
        remedies.append(f"turn_tolerance_deg = {np.degrees(np.abs(wider[bears]).min()) + 5.0:.0f}")
    return f"{reason}, which would bear beside the planned point", "use " + (" or ".join(remedies) or "another wheel")


def turned_curvature(curvature: Array, turn: Array, radius: float) -> tuple[Array, Array, Array]:
    """Relative kxx, kyy, kxy (1/m) of blade curvatures (n, 3) at turns (..., 1) rad on a wheel of `radius`, untilted.

    The blade's frame is seen from its far side (n = -z), so its k_tb changes sign; docs/model.md, eq. 4.
    """
    k_tt, k_bb, k_tb = curvature.T
    c, s = np.cos(turn), np.sin(turn)
    kxx = c**2 * k_tt + 2 * s * c * k_tb + s**2 * k_bb + 1 / radius
    kyy = s**2 * k_tt - 2 * s * c * k_tb + c**2 * k_bb
    return kxx, kyy, s * c * (k_tt - k_bb) - (c**2 - s**2) * k_tb


def _bears(cell: Cell, law: WheelLaw, path: BladePath, index: Index, turns: Array, reasons: list[tuple[float, str]]) -> Array:
    """Which turns (m,) let the wheel bear at the planned points `index`; notes why none does."""
    good = _bearing(cell, law, path, index, turns)
    if not good.all(axis=1).any():
        worst = int(np.argmax((~good).sum(axis=0)))
        where = f"at waypoint {index[worst] + 1} the blade is too hollow for this wheel"
        reasons.append((4.0, f"{where}, which would bear beside the planned point"))
    return np.asarray(good.all(axis=1))


def _bearing(cell: Cell, law: WheelLaw, path: BladePath, index: Index, turns: Array) -> Mask:
    """At which turns (m,) the wheel bears at which planned points, (m, len(index)): overlap there under the programmed force, kxx
    in range."""
    kxx, kyy, kxy = turned_curvature(path.curvature[index], turns[:, None], cell.wheel.radius)
    hollow = kxx < law.limits["kxx"][0]
    kxx = np.maximum(kxx, law.limits["kxx"][0])
    force = np.broadcast_to(path.force[index], kxx.shape).ravel()
    zero = np.zeros(kxx.size)
    d = law.evaluate(force, kxx.ravel(), kyy.ravel(), kxy.ravel(), zero, zero, zero).reshape(kxx.shape)
    return np.asarray(~hollow & (d > SEED_INDENTATION))


def _family(seed: Seed) -> tuple[int, ...]:
    return (seed.direction, seed.branch, *np.floor(seed.q[0][[0, 3, 5]] / np.pi + 0.5).astype(int).tolist())


@dataclass(frozen=True)
class _Ways:
    """Ways of the wheel over a pass: places on the arc (m, 8, stations) rad, turn (m,) rad, joints (m, 8, stations, 6) without
    jumps on each of the 8 branches, ok (m, 8) where they are reached at all."""

    arc: Array
    turn: Array
    q: Array
    ok: Mask

    def with_(self, other: "_Ways") -> "_Ways":
        """Both, one after the other."""
        return _Ways(*(np.concatenate([getattr(self, f.name), getattr(other, f.name)]) for f in fields(self)))


def _held(cell: Cell, path: BladePath, order: Index, direction: int, turns: Array, reasons: list[tuple[float, str]]) -> _Ways:
    """One place on the arc all along; notes how far the blade is beyond reach."""
    arc, turn = (grid.ravel() for grid in np.meshgrid(posture_grid(cell)[0], turns, indexing="ij"))
    T = flange_pose(cell, contact_poses(cell, path, order, arc, turn, direction, cell.process.sigma))
    q, reachable = inverse_branches(cell.robot, T.reshape(-1, 4, 4))
    q = q.reshape(len(arc), len(order), 8, 6).transpose(0, 2, 1, 3)
    ok = np.asarray(reachable.reshape(len(arc), len(order), 8).all(axis=1))
    if not ok.any():
        excess = reach_excess(cell.robot, T.reshape(-1, 4, 4)).reshape(len(arc), -1).max(axis=1).min()
        reasons.append((0.0, f"the blade would have to be held {excess * 1e3:.0f} mm beyond the robot's reach"))
    places = np.broadcast_to(arc[:, None, None], q.shape[:3])
    return _Ways(places, turn, np.unwrap(np.where(np.isfinite(q), q, 0.0), axis=2), ok)


def _rolled(cell: Cell, path: BladePath, order: Index, direction: int, turns: Array) -> _Ways:
    """The way over the arc on which the axes are calmest, for every turn and branch: the shortest path through stations x arcs,
    its steps within the axes' speed."""
    robot, wheel = cell.robot, cell.wheel
    middle, half = np.mean(wheel.arc), 0.5 * np.ptp(wheel.arc)
    arcs = middle + half * np.linspace(-0.95, 0.95, ROLLED_ARCS)
    arc, turn = (grid.ravel() for grid in np.meshgrid(arcs, turns, indexing="ij"))
    T = flange_pose(cell, contact_poses(cell, path, order, arc, turn, direction, cell.process.sigma))
    q, reachable = inverse_branches(robot, T.reshape(-1, 4, 4))
    shape = len(arcs), len(turns), len(order), 8
    q, k = np.where(np.isfinite(q), q, 0.0).reshape(*shape, 6), len(order)
    q, sound = (
        q.transpose(2, 1, 3, 0, 4),
        (reachable.reshape(shape) & keeps_ranges(cell, q)).transpose(2, 1, 3, 0),
    )  # stations first
    node = (
        WRIST_WEIGHT / np.maximum(np.abs(np.sin(q[..., 4])), 1e-3) ** 2 + ARC_WEIGHT * ((arcs - middle) / (2 * half)) ** 2
    ) / k
    node = np.where(sound, node, np.inf)
    seconds = np.abs(np.diff(path.s[order])) / path.feed.mean()
    total, back = node[0], []
    for i in range(1, k):
        turned = (q[i][..., None, :, :] - q[i - 1][..., :, None, :] + np.pi) % (2 * np.pi) - np.pi
        speed = (np.abs(turned) / seconds[i - 1] / robot.qd_max).max(axis=-1)
        step = np.where(speed < SEED_SPEED_SHARE, SPEED_WEIGHT * speed**2 / (k - 1), np.inf)
        through = total[..., None] + step
        back.append(np.argmin(through, axis=-2))
        total = through.min(axis=-2) + node[i]
    place = [np.argmin(total, axis=-1)]
    for pointers in reversed(back):
        place.append(np.take_along_axis(pointers, place[-1][..., None], axis=-1)[..., 0])
    chosen = np.array(place[::-1])  # (stations, turns, 8)
    way = np.take_along_axis(q, chosen[..., None, None], axis=3)[:, :, :, 0]
    ok = np.isfinite(total.min(axis=-1))
    return _Ways(arcs[chosen].transpose(1, 2, 0), turns, np.unwrap(way.transpose(1, 2, 0, 3), axis=2), ok)


def _families(
    cell: Cell, path: BladePath, order: Index, direction: int, ways: _Ways, reasons: list[tuple[float, str]]
) -> list[Seed]:
    """Seeds within limits from ways over the pass; notes why others fall."""
    robot, q, ok, turn = cell.robot, ways.q, ways.ok, ways.turn
    at = path.s[order] / path.s[-1]
    at = at if direction == 1 else 1.0 - at
    seconds = np.diff(at) * path.s[-1] / path.feed.mean()
    short = np.maximum(np.abs(path.turn) - np.sign(path.turn) * turn, 0.0)
    aside = ((ways.arc - np.mean(cell.wheel.arc)) / np.ptp(cell.wheel.arc)) ** 2
    # A whole turn of an axis moves nothing but that axis: what the other rules go by is the same for all of them.
    radius, least, most = wrist_radius(cell, q), q.min(axis=2), q.max(axis=2)
    wrist, shoulder = np.abs(np.sin(q[..., 4])).min(axis=2), np.abs(radius).min(axis=2)
    speed = (np.abs(np.diff(q, axis=2)) / seconds[:, None] / robot.qd_max).max(axis=(2, 3))
    elbow = np.abs(q[..., 2] - np.arctan2(robot.mdh[2, 2], robot.mdh[3, 1])).min(axis=2)
    sound = (wrist > np.sin(WRIST_MARGIN)) & (speed < SEED_SPEED_SHARE) & (shoulder > SHOULDER_MARGIN) & (elbow > ELBOW_MARGIN)
    calm = (
        ((turn**2 + UNTURNED_WEIGHT * short**2) / max(cell.process.turn_tolerance, 1e-3) ** 2)[:, None]
        + ARC_WEIGHT * aside.mean(axis=2)
        + WRIST_WEIGHT / np.maximum(wrist, 1e-3) ** 2
        + SPEED_WEIGHT * speed**2
    )
    reaching = 0.5 * np.asarray((radius < 0).any(axis=2))  # over its own axis 1, as no one would teach it
    seeds = []
    for a, b, c in product((-1, 0, 1), repeat=3):  # whole turns of axes 1, 4, 6
        turns = 2 * np.pi * np.array([a, 0, 0, b, 0, c])
        over = np.maximum(robot.q_min + AXIS_MARGIN - (least + turns), most + turns - robot.q_max + AXIS_MARGIN)
        inside = ok & (over <= 0).all(axis=-1)
        _note(reasons, ok, over, inside, wrist, speed, shoulder)
        for g, branch in np.argwhere(inside & sound):
            moved = q[g, branch] + turns
            wound = 0.02 * ((moved[:, [3, 5]] / np.pi) ** 2).max()
            off_middle = np.abs(2 * moved - robot.q_min - robot.q_max) / (robot.q_max - robot.q_min)
            cost = calm[g, branch] + wound + 0.5 * off_middle.max() ** 4 + reaching[g, branch]
            seeds.append(Seed(direction, int(branch), ways.arc[g, branch], float(turn[g]), moved, at, float(cost)))
    return seeds


def wrist_radius(cell: Cell, q: Array) -> Array:
    """Signed distance of the wrist centre from axis 1 (KRL.md, status bit 0)."""
    mdh = cell.robot.mdh
    q23 = q[..., 1] + q[..., 2]
    return np.asarray(mdh[0, 2] + mdh[1, 2] * np.cos(q[..., 1]) + mdh[3, 1] * np.cos(q23) + mdh[2, 2] * np.sin(q23))


def _note(
    reasons: list[tuple[float, str]], ok: Mask, over: Array, inside: Array, wrist: Array, speed: Array, shoulder: Array
) -> None:
    """Remember the farthest that any candidate came and what stopped it."""
    if not ok.any():
        return
    if not inside.any():
        worst = np.where(ok[..., None], over, np.inf).max(axis=-1)
        g = np.unravel_index(int(np.argmin(worst)), worst.shape)
        axis = int(np.argmax(over[g]))
        reasons.append((1.0 - worst[g], f"axis {axis + 1} would be {np.degrees(over[g][axis]):.1f} deg beyond its limit"))
        return
    best = np.where(inside, wrist, 0.0).max()
    if best <= np.sin(WRIST_MARGIN):
        reasons.append((2.0, f"axis 5 comes within {np.degrees(np.arcsin(best)):.1f} deg of the wrist singularity"))
    elif np.where(inside, speed, np.inf).min() >= SEED_SPEED_SHARE:
        share = np.where(inside, speed, np.inf).min()
        reasons.append((3.0, f"an axis would need {100 * share:.0f} % of its speed limit at the programmed feed"))
    elif np.where(inside, shoulder, 0.0).max() <= SHOULDER_MARGIN:
        reasons.append((3.0, "the wrist passes over axis 1 (overhead singularity)"))
    else:
        reasons.append((2.5, "every posture within limits is near a singularity"))
