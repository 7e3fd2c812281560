"""Every pass from the air to the air: where blade and wheel may touch outside of the planned contact, the force there in balance
or in time, and its figures.

A window is the way of a pass, approach and lift included, and some travel before and after. Where the plan names no contact
point, the one of touch or of lift stands: there the wheel touches first and last.
"""

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline

from ocp.model.cell import Cell
from ocp.simulate.twin.contact import ContactMoments, ContactResult, Index
from ocp.simulate.twin.contact.flange_motion import MovedLane, move
from ocp.simulate.twin.contact.grinder import Grinder, moving_device
from ocp.simulate.twin.contact.wheel_and_blade import friction, knocked
from ocp.simulate.twin.controller import Track
from ocp.simulate.twin.path_motion import flange
from ocp.simulate.twin.plan_knowledge import AWAY, Matched
from robots.pose import Array

BEFORE, AFTER = 1.0, 0.2  # s of travel before a pass's approach, in which the flange comes to rest, and after its lift
HELD = ("p", "n", "t", "s", "feed", "force")  # columns of the plan that outside of its contact stand as at its ends


@dataclass(frozen=True)
class TouchWindows:
    """Samples of the windows of some passes, one after the other: `index` (n,) into the track, `run` (n,) the pass, `planned`
    (n,) whether that is the pass itself, neither led in nor out, `plan`: what it says there, held at a pass's ends."""

    index: Index
    run: Index
    planned: NDArray[np.bool_]
    plan: Matched


@dataclass(frozen=True)
class Touching:
    """What became of the contact in the windows, n samples: the force N then, its mean and most until the next sample, share of
    that time in contact, losses of contact in it; `still` N: the same in balance; stroke m; dt s between samples; moments:
    what it was worked out from."""

    windows: TouchWindows
    moments: ContactMoments
    time: Array
    force: Array
    mean: Array
    most: Array
    touching: Array
    losses: Index
    still: Array
    stroke: Array
    dt: float


@dataclass(frozen=True)
class TouchFigures:
    """One pass: line of the blade; peak N anywhere in its window; seconds of contact outside of the pass itself, lead-ins and
    lead-outs among them; losses of contact between first and last touch and the seconds they took; the most N above and below
    what is planned in the pass itself."""

    line: int
    peak: float
    outside: float
    losses: int
    lost: float
    over: float
    under: float


def touch_windows(track: Track, plan: Matched, runs: Index) -> TouchWindows:
    """The windows of the passes `runs`."""
    step, last = float(np.median(np.diff(track.time))), len(track.time) - 1
    parts: list[tuple[Index, Index, Index]] = []
    for k in runs:
        inside = np.flatnonzero(plan.run == k)
        a, b, line = int(inside[0]), int(inside[-1]), plan.line[inside[0]]
        # Of what lies between two stretches of one line half belongs to each.
        grinding = np.flatnonzero((plan.run >= 0) & (plan.line == line))
        before, after = grinding[grinding < a], grinding[grinding > b]
        first = (int(before[-1]) + a + 1) // 2 if len(before) else 0
        final = (int(after[0]) + b + 1) // 2 - 1 if len(after) else last
        while a > first and plan.line[a - 1] == line:
            a -= 1
        while b < final and plan.line[b + 1] == line:
            b += 1
        for _ in range(round(BEFORE / step)):
            a -= int(a > 0 and plan.phase[a - 1] == AWAY)
        for _ in range(round(AFTER / step)):
            b += int(b < last and plan.phase[b + 1] == AWAY)
        index = np.arange(a, b + 1)
        parts.append((index, np.full(len(index), k), inside[np.argmin(np.abs(index[:, None] - inside), axis=1)]))
    index, run, nearest = (np.concatenate(columns) for columns in zip(*parts, strict=True))
    held: dict[str, Any] = {name: getattr(plan, name)[nearest] for name in HELD}
    own = {name: getattr(plan, name)[index] for name in ("phase", "interference")}
    own |= {"planned": plan.planned[index], "setpoint": plan.setpoint[index]}
    said = Matched(run=plan.run[index], line=plan.line[nearest], **own, **held)
    return TouchWindows(index, run, (said.run == run) & said.planned, said)


def carried_acceleration(cell: Cell, track: Track, windows: TouchWindows) -> Array:
    """Acceleration (n, 3) m/s^2, base axes, of the payload's centre as the programmed axes move it, the flange's stroke held."""
    found = np.empty((len(windows.index), 3))
    for k in np.unique(windows.run):
        rows = np.flatnonzero(windows.run == k)
        T = flange(cell.robot, track.q[windows.index[rows]])
        place = T[:, :3, :3] @ cell.workpiece.payload.com + T[:, :3, 3]
        found[rows] = CubicSpline(track.time[windows.index[rows]], place)(track.time[windows.index[rows]], 2)
    return found


def in_balance(windows: TouchWindows, c: ContactMoments, still: ContactResult) -> Touching:
    """The contact of a flange that is in balance at every instant."""
    touches = still.force > 0
    opened = np.append(False, touches[:-1]) & ~touches & (np.diff(windows.run, prepend=-1) == 0)
    parts = (still.force, still.force, still.force, touches.astype(float), opened.astype(np.int64), still.force, still.stroke)
    return Touching(windows, c, c.time_s, *parts, _rate(windows, c))


def in_time(windows: TouchWindows, c: ContactMoments, still: ContactResult, lanes: list[MovedLane]) -> Touching:
    """The contact of a flange that moves in time; lanes: a pass each, in their order; `c` as `Grinder.in_reach` gives it."""
    names = ("force", "mean", "most", "touching", "losses")
    force, mean, most, touches, losses = (np.concatenate([getattr(lane, name) for lane in lanes]) for name in names)
    stroke = np.concatenate([lane.stroke for lane in lanes])
    return Touching(windows, c, c.time_s, force, mean, most, touches, losses, still.force, stroke, _rate(windows, c))


def _rate(windows: TouchWindows, c: ContactMoments) -> float:
    return float(np.median(np.diff(c.time_s[windows.run == windows.run[0]])))


def touch(grinder: Grinder, c: ContactMoments, windows: TouchWindows, driven: Array) -> tuple[Touching, ContactResult]:
    """The contact in the windows on a grinder's own flange, and its result at the samples; driven: as `Grinder.closing`."""
    reached = grinder.in_reach(c)
    still, own = grinder.force(reached), grinder.cell.flange
    if own is None or not own.moves_in_time:
        return in_balance(windows, reached, still), still
    paths = grinder.closing(reached, driven, still)
    found = in_time(windows, reached, still, move(paths, np.arange(len(paths)), moving_device(grinder.truth, own, len(paths))))
    force, mean, most = (knocked(grinder.truth, reached, values) for values in (found.force, found.mean, found.most))
    found = replace(found, force=force, mean=mean, most=most)
    tangential = friction(grinder.truth, grinder.cell, c) * found.force
    return found, replace(still, force=found.force, tangential=tangential, stroke=found.stroke)


def touch_figures(t: Touching) -> list[TouchFigures]:
    """The figures of every pass, in the order of the program."""
    found = []
    for k in dict.fromkeys(t.windows.run.tolist()):
        rows = np.flatnonzero(t.windows.run == k)
        planned, touches = t.windows.planned[rows], t.touching[rows]
        error = (t.force[rows] - t.windows.plan.force[rows])[planned]
        met = np.flatnonzero(touches > 0)
        between = touches[met[0] : met[-1] + 1] if len(met) else touches[:0]
        apart_at_last = len(met) > 0 and met[-1] < len(rows) - 1
        losses = max(int(t.losses[rows].sum()) - int(apart_at_last), 0)
        found.append(
            TouchFigures(
                line=int(t.windows.plan.line[rows[0]]),
                peak=float(max(t.most[rows].max(), t.force[rows].max())),
                outside=float(touches[~planned].sum() * t.dt),
                losses=losses,
                lost=float((1.0 - between).sum() * t.dt) if losses else 0.0,
                over=float(error.max(initial=0.0)),
                under=abs(float(error.min(initial=0.0))),
            )
        )
    return found
