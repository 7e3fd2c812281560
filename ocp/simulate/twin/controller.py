"""The virtual controller: a program becomes axes over time.

Between points it does what is known of such controllers (KRL.md): fifth-order curves through the points of a block that begins
and ends at rest, timed blocks keep their times, path motions keep $VEL.CP where the axes allow it. Only the curve's being
smooth matters here; the maker's own is not published.
"""

from collections.abc import Callable, Container, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from ocp.simulate.twin.krl_text import DrivenMotion, KrlProgram, ProgramPause
from ocp.simulate.twin.path_motion import (
    bounds_of_path,
    drive_path,
    flange,
    flange_poses,
    inverse_by_status,
    rest_to_rest,
    solve_posture,
    timed_curve,
)
from robots.errors import BadInput, Infeasible
from robots.pose import Array
from robots.robot import Robot

Index = NDArray[np.int64]

HZ = 250.0  # samples of the axes a second: the cycle of such controllers is 4 ms (M)
STOOD = np.radians(1e-3)  # rad; nearer than this the robot already stands where it is sent
LIMIT = np.radians(1e-3)  # rad, rounding of a printed axis at its limit
LONGEST = 24 * 3600.0  # s of a whole program; longer ones are mistakes, and their samples fill the memory
NOTICED = 1.02  # share of an axis' speed or acceleration above which the notice comes


@dataclass(frozen=True)
class Track:
    """Axes over time, n samples at a fixed rate.

    time (n,) s; q, qd (n, 6) rad, rad/s; approach (n, 6) sign of each axis' last motion (0 before its first); motion (n,)
    index into `places`, each (file, line) of a motion in the program; row (n,) line of the point that was passed last; notices in
    sentences.
    """

    time: Array
    q: Array
    qd: Array
    approach: Array
    motion: Index
    row: Index
    places: tuple[tuple[str, int], ...]
    notices: tuple[str, ...]

    @property
    def duration(self) -> float:
        """s."""
        return float(self.time[-1])


@dataclass(frozen=True)
class _Piece:
    """One motion: its curve over time, and which line of the program it passes at which time."""

    place: tuple[str, int]
    start: float
    duration: float
    curve: Callable[..., Array]
    rows: tuple[Array, Index]
    notice: str = ""


def drive(program: KrlProgram, robot: Robot, hz: float = HZ) -> Track:
    """Drive the whole program. The robot is taken to stand where the first motion goes.

    Raises BadInput (a first motion without full axes, poses that no status reaches; in a planned program a block that begins
    elsewhere than the last one ended, or asks for more than the axes do) and Infeasible (an axis beyond its limit, a pose out of
    reach, more than a day), with file and line.
    """
    pieces: list[_Piece] = []
    clock, where = 0.0, None
    steps, k = program.steps, 0
    while k < len(steps):
        step = steps[k]
        if isinstance(step, ProgramPause):
            clock += step.seconds or 0.0
            k += 1
            continue
        chain = _chain(steps, k)
        k += len(chain)
        for piece in _pieces(robot, chain, where, clock, program.planned):
            pieces.append(piece)
            clock = piece.start + piece.duration
            if clock > LONGEST:
                place = f"{piece.place[0]}, line {piece.place[1]}"
                raise Infeasible(f"{place}: the program goes on for more than {LONGEST / 3600:g} hours; is a decimal point lost?")
        where = _end(robot, chain[0]) if not pieces else pieces[-1].curve(pieces[-1].duration)
    if not pieces:
        raise BadInput(f"{program.main}: the robot never leaves its first posture")
    track = _sampled(robot, pieces, clock, hz)
    track = replace(track, notices=(*track.notices, *(piece.notice for piece in pieces if piece.notice)))
    if program.planned and track.notices:
        raise BadInput(track.notices[0])
    return track


def _chain(steps: Sequence[DrivenMotion | ProgramPause], k: int) -> list[DrivenMotion]:
    """The motion at k, with the LIN motions after it where they blend into one another."""
    chain: list[DrivenMotion] = []
    for step in steps[k:]:
        blended = not chain or (chain[-1].kind == "LIN" and chain[-1].targets[0].blend)
        if not isinstance(step, DrivenMotion) or not blended or (chain and step.kind != "LIN"):
            break
        chain.append(step)
    return chain


def _end(robot: Robot, first: DrivenMotion) -> Array:
    """Where the first motion of a program puts the robot."""
    target = first.targets[-1]
    if target.q is not None:
        _within(robot, target.q[None], [(first.file, target.line)])
        return target.q
    if first.kind != "PTP" or target.status is None or target.pose is None:
        raise BadInput(f"{first.file}, line {first.line}: the first motion must be a PTP to full axes, or to a pose with S and T")
    goal = flange_poses(first.frames, target.pose[None])[0]
    q = inverse_by_status(robot, goal, target.status, target.turn)
    if q is None:
        raise BadInput(
            f"{first.file}, line {first.line}: no posture of {robot.name} reaches this pose with S {target.status}, "
            f"T {target.turn}"
        )
    return q


def _pieces(robot: Robot, chain: list[DrivenMotion], where: Array | None, clock: float, planned: bool) -> list[_Piece]:
    first = chain[0]
    if first.kind in ("LIN", "SPLINE") and where is None:
        raise BadInput(f"{first.file}, line {first.line}: the first motion must be a PTP to full axes")
    if first.times is not None:
        return _timed_pieces(robot, first, where, clock, planned)
    if first.kind in ("LIN", "SPLINE"):
        path = drive_path(robot, chain, np.asarray(where))
        return [] if path is None else [_Piece((first.file, first.line), clock, *path)]
    goal = first.targets[0].q if first.targets[0].q is not None else _posed(robot, first, where)
    piece = None if where is None else _point_to_point(robot, first, where, goal, clock)
    return [] if piece is None else [piece]


def _timed_pieces(robot: Robot, first: DrivenMotion, where: Array | None, clock: float, planned: bool) -> list[_Piece]:
    """A timed block of axes or poses, and the way to where it begins, which only a program that is not planned may leave open."""
    assert first.times is not None
    targets, place = first.targets, (first.file, first.line)
    if of_axes := first.kind == "TIMED":
        _within(robot, np.array([t.q for t in targets]), [(first.file, t.line) for t in targets])
    curve, notice = _curve(robot, first, first.times, np.asarray(where)), "" if of_axes else bounds_of_path(first)
    begin, found = np.asarray(curve(0.0)), []
    if where is not None and (off := np.abs(begin - where).max()) >= STOOD:
        if planned:
            raise BadInput(
                f"{first.file}, line {targets[0].line}: the block begins {np.degrees(off):.4f} deg off where the robot stands; "
                "nobody planned that way, write the program anew"
            )
        before = _point_to_point(robot, first, where, begin, clock) if of_axes else _to_pose(robot, first, where, clock)
        found = [] if before is None else [before]
        clock += sum(piece.duration for piece in found)
    rows = (first.times, np.array([t.line for t in targets]))
    return [*found, _Piece(place, clock, float(first.times[-1]), curve, rows, notice)]


def _to_pose(robot: Robot, block: DrivenMotion, where: Array, clock: float) -> _Piece | None:
    """The way to the first pose of a block of poses, which its times do not rule."""
    path = drive_path(robot, [replace(block, targets=block.targets[:1], times=None)], where)
    return None if path is None else _Piece((block.file, block.line), clock, *path)


def _posed(robot: Robot, motion: DrivenMotion, where: Array | None) -> Array:
    """The posture of a PTP to a pose: by its status, else the one nearest to where the robot stands."""
    target = motion.targets[0]
    assert target.pose is not None
    if target.status is not None or where is None:
        return _end(robot, motion)
    goal = flange_poses(motion.frames, target.pose[None])
    q, left = solve_posture(robot, goal, where[None])
    if left[0] > 1e-7:
        raise Infeasible(f"{motion.file}, line {motion.line}: the arm cannot reach this pose from where it stands")
    return np.asarray(q[0])


def _point_to_point(robot: Robot, motion: DrivenMotion, start: Array, goal: Array, clock: float) -> _Piece | None:
    """Fifth order from rest to rest: peak speed 15/8 d/T, peak acceleration 10/sqrt(3) d/T^2 (zero jerk is not asked for)."""
    _within(robot, goal[None], [(motion.file, motion.line)])
    way = np.abs(goal - start)
    if way.max() < STOOD:
        return None
    speed, acceleration = motion.axis_speed * robot.qd_max, motion.axis_acceleration * robot.qdd_max
    T = max(float((1.875 * way / speed).max()), float(np.sqrt(5.7735 * way / acceleration).max()))
    curve = rest_to_rest(np.array([0.0, T]), np.array([start, goal]))
    return _Piece((motion.file, motion.line), clock, T, curve, (np.zeros(1), np.array([motion.line])))


def _within(robot: Robot, q: Array, places: list[tuple[str, int]]) -> None:
    """Raises Infeasible: an axis beyond its limit."""
    over = np.maximum(robot.q_min - q, q - robot.q_max)
    k, j = np.unravel_index(int(np.argmax(over)), over.shape)
    if over[k, j] > LIMIT:
        low, high = np.degrees([robot.q_min[j], robot.q_max[j]])
        raise Infeasible(
            f"{places[k][0]}, line {places[k][1]}: A{j + 1} goes to {np.degrees(q[k, j]):.2f} deg, beyond {low:g} to {high:g} of "
            f"{robot.name}"
        )


def _sampled(robot: Robot, pieces: list[_Piece], end: float, hz: float) -> Track:
    """Samples at a fixed rate over all pieces; between pieces the robot stands."""
    time = np.append(np.arange(0.0, end, 1.0 / hz), end)
    starts = np.array([p.start for p in pieces])
    which = np.clip(np.searchsorted(starts, time, side="right") - 1, 0, len(pieces) - 1).astype(np.int64)
    q, qd, qdd = (np.empty((len(time), 6)) for _ in range(3))
    row = np.empty(len(time), np.int64)
    for i in np.unique(which):
        mine = which == i
        piece = pieces[i]
        at = np.clip(time[mine] - piece.start, 0.0, piece.duration)
        q[mine] = piece.curve(at)
        moving = ((time[mine] - piece.start) <= piece.duration)[:, None]
        qd[mine], qdd[mine] = (moving * piece.curve(at, nu=order) for order in (1, 2))
        row[mine] = piece.rows[1][np.clip(np.searchsorted(piece.rows[0], at + 1e-9, side="right") - 1, 0, None)]
    places = tuple(p.place for p in pieces)
    _within(robot, q, [(places[w][0], int(r)) for w, r in zip(which, row, strict=True)])
    notices = _notices(robot, qd, qdd, which, row, places)
    return Track(time, q, qd, _approach(qd), which, row, places, notices)


def _approach(qd: Array) -> Array:
    """Sign of each axis' last motion: where it stands, that of the motion before."""
    sign = np.where(np.abs(qd) > 1e-7, np.sign(qd), 0.0)
    index = np.where(sign != 0, np.arange(len(sign))[:, None], 0)
    np.maximum.accumulate(index, axis=0, out=index)
    return np.take_along_axis(sign, index, axis=0)


def _notices(
    robot: Robot, qd: Array, qdd: Array, which: Index, row: Index, places: tuple[tuple[str, int], ...]
) -> tuple[str, ...]:
    """Timed blocks that ask for more than the axes do: the controller would be slower there."""
    found = []
    for what, values, most in (("speed", qd, robot.qd_max), ("acceleration", qdd, robot.qdd_max)):
        share = np.abs(values) / most
        k, j = np.unravel_index(int(np.argmax(share)), share.shape)
        if share[k, j] > NOTICED:
            found.append(
                f"{places[which[k]][0]}, line {int(row[k])}: A{j + 1} needs {100 * share[k, j]:.0f} % of its {what}; a "
                "controller would stretch the time there, and what was planned is not what it drives"
            )
    return tuple(found)


PART_ERROR, PART_DRAWS = 0.05, 4  # how much a PART may be missed by, of itself, and how often that is drawn


@dataclass(frozen=True)
class MissedParts:
    """What a program does whose PARTs are met within a share and whose ENDs are exact: the largest lag of an axis rad, of the
    flange along its way m, of the flange off its way m, and of the speed along it as a share."""

    share: float
    axes: float
    along: float
    aside: float
    speed: float


def missed_parts(program: KrlProgram, robot: Robot, places: Container[tuple[str, int]]) -> MissedParts | None:
    """Timed blocks that begin at `places` (file, line) driven with PARTs missed at random by up to PART_ERROR; None without any.

    Only END is exact on a real controller (KRL.md). The points are met, at other times than planned.
    """
    rng, found, where = np.random.default_rng(0), [], np.zeros(6)
    timed = {k for k, m in enumerate(program.motions) if m.times is not None and (m.file, m.line) in places}
    for k, motion in enumerate(program.motions[: max(timed, default=-1) + 1]):
        begin, where = where, _stands(robot, motion, where)
        if motion.times is None or k not in timed:
            continue
        t, planned = motion.times, _curve(robot, motion, motion.times, begin)
        fine = np.interp(np.arange(0.0, len(t) - 1, 0.25), np.arange(len(t)), t)
        T = flange(robot, planned(fine))[:, :3, 3]
        way = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(T, axis=0), axis=1))])
        for _ in range(PART_DRAWS):
            parts = np.diff(t) * (1.0 + PART_ERROR * rng.uniform(-1.0, 1.0, len(t) - 1))
            late = np.concatenate([[0.0], np.cumsum(parts)]) * (t[-1] / parts.sum())
            driven = _curve(robot, motion, late, begin)
            lag = np.abs(driven(fine) - planned(fine)).max()
            # The same share of the same part: what is left is off the way, not behind on it.
            same = np.interp(fine, t, late)
            aside = np.linalg.norm(flange(robot, driven(same))[:, :3, 3] - T, axis=1).max()
            along = np.abs(np.interp(fine, late, np.interp(t, fine, way)) - way).max()
            speed = np.abs(t[-1] / parts.sum() * parts / np.diff(t) - 1.0).max()
            found.append((lag, along, aside, speed))
    return MissedParts(PART_ERROR, *np.array(found).max(axis=0).tolist()) if found else None


def _curve(robot: Robot, motion: DrivenMotion, times: Array, begin: Array) -> Callable[..., Array]:
    """Joints over time of a block whose points are met at `times` (m,) s, from near `begin` (6,)."""
    if motion.kind == "TIMED":
        return rest_to_rest(times, np.array([target.q for target in motion.targets]))
    return timed_curve(robot, motion, times, begin)


def _stands(robot: Robot, motion: DrivenMotion, where: Array) -> Array:
    """The posture at the end of a motion from `where` (6,)."""
    target = motion.targets[-1]
    if target.q is not None:
        return target.q
    if motion.kind == "PTP":
        return _posed(robot, motion, where)
    assert target.pose is not None
    return np.asarray(solve_posture(robot, flange_poses(motion.frames, target.pose[None]), where[None])[0][0])
