"""How a pass is meant to be driven: one way from rest in the air over touch, pass and lift to rest in the air.

The parameter of the way is its nominal time. Along it the contact's arc length has no slope at touch and lift: there the
contact point stands still on the blade while the blade still closes along the normal, so that no axis rests in contact, and
force and feed grow from zero together (docs/process.md).
"""

from dataclasses import dataclass, fields, replace
from math import floor
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicHermiteSpline, CubicSpline

from ocp.model.cell import Cell
from ocp.plan.passes.stretches import CannotGrind
from ocp.plan.rules import APPROACH_SPEED, CARRIED_FORCE, CREEP, LEAST_RAMP, LIFT_OFF, TOUCH_SPEED
from robots.pose import Array
from trajectories.passes import BladePath

AIR_NODES = 10  # of an approach and of a lift
RAMP_NODES = 26  # of a lead-in and of a lead-out
LONGEST_RAMPS = 0.8  # of a line's time, both ramps together: shorter lines are driven slower, with less force
LEAST_PEAK = 0.25  # share of the force up to which it has to rise: with less no contact is solved directly
FITTED = 8e-3  # m of a line's end by which it is made longer
STEEPEST = 1.0  # first slope of a rise over its mean: beyond 5/3 it would be steepest at touch, beyond 5/2 overshoot


def rise(x: Array, slope: float, order: int = 0) -> Array:
    """A polynomial from 0 to 1 over x in 0..1: first slope `slope`, no curvature at both ends, no last slope; its derivative of
    `order`, -1 the integral from 0."""
    c3, c4, c5 = np.linalg.solve([[1, 1, 1], [3, 4, 5], [6, 12, 20]], [1 - slope, -slope, 0.0])
    poly = np.polynomial.Polynomial([0.0, slope, 0.0, c3, c4, c5])
    return np.asarray((poly.integ() if order < 0 else poly.deriv(order) if order else poly)(np.clip(x, 0.0, 1.0)))


@dataclass(frozen=True)
class Engagement:
    """How contact begins and ends: ramp s of the force; touch m/s, at which the blade closes; far m off the wheel where the way
    begins, approach s from there; stiffness N/m of the contact chain where it begins to bear; force N, the pass's."""

    ramp: float
    touch: float
    far: float
    approach: float
    stiffness: float
    force: float

    @property
    def slope(self) -> float:
        """First slope of the force's rise, so that the blade closes on without a jump of speed."""
        return min(self.touch * self.stiffness * self.ramp / self.force, STEEPEST)

    @property
    def closing(self) -> float:
        """Speed m/s along the normal at touch: `touch`, or less where the chain is so stiff that the force would overshoot."""
        return self.slope * self.force / (self.stiffness * self.ramp)


def entry_of(cell: Cell, force: float, stiffness: float) -> Engagement:
    """How a pass of `force` N begins and ends on a contact chain of `stiffness` N/m: the ramp lasts as long as the carried mass
    of the flange asks, so that moving it takes no more than CARRIED_FORCE."""
    mass = cell.flange.carried_mass if cell.flange is not None else 0.0
    peak = 10 / np.sqrt(3)  # of the second derivative of a rise without slope at its ends
    ramp = max(LEAST_RAMP, float(np.sqrt(peak * mass * force / stiffness / CARRIED_FORCE)))
    return Engagement(ramp, TOUCH_SPEED, LIFT_OFF, 1.9 * LIFT_OFF / APPROACH_SPEED + CREEP, stiffness, force)


@dataclass(frozen=True)
class PassCourse:
    """The nominal way at its n nodes: at (n,) s, nominal time; s (n,) m, arc length of the contact; share (n,) of the programmed
    feed, and at the nominal rate of the programmed force; speed (n,) m/s of the contact over the blade; gap (n,) m between blade
    and wheel, zero in contact; grinding (n,) 1 in the pass proper, 0 before and after; edges: nominal times of begin, touch, full
    force, end of it, lift, end; peak: largest share; entry: None for a pass alone."""

    at: Array
    s: Array
    share: Array
    speed: Array
    gap: Array
    grinding: Array
    edges: Array
    peak: float = 1.0
    entry: Engagement | None = None

    @property
    def touching(self) -> slice:
        """The nodes in contact, those of touch and lift left out: no force there."""
        on = np.flatnonzero(self.share > 0)
        return slice(int(on[0]), int(on[-1]) + 1)

    def share_at(self, t: Array) -> Array:
        """Share of the feed at nominal times t (m,)."""
        if self.entry is None:
            return np.ones_like(t)
        inside = np.minimum(t - self.edges[1], self.edges[4] - t)
        return np.where(inside > 0, self.peak * rise(inside / self.entry.ramp, self.entry.slope), 0.0)

    def arc_at(self, t: Array) -> Array:
        """Arc length (m,) m of the contact at nominal times t (m,)."""
        return np.asarray(CubicHermiteSpline(self.at, self.s, self.speed)(np.clip(t, self.at[0], self.at[-1])))

    def gap_at(self, t: Array) -> Array:
        """Gap (m,) m at nominal times t (m,)."""
        if self.entry is None:
            return np.zeros_like(t)
        one, rest = self.entry, self.entry.approach - CREEP
        outside = np.maximum(np.maximum(self.edges[1] - t, t - self.edges[4]), 0.0)
        closing = self.peak * one.closing  # less where the force's share is less: the blade goes on without a jump of speed
        beyond = one.far - closing * CREEP
        return closing * np.minimum(outside, CREEP) + beyond * rise((outside - CREEP) / rest, closing * rest / beyond)

    def phase_at(self, t: Array) -> NDArray[np.int64]:
        """The phase (m,) at nominal times: 0 travel, 1 lead-in, 2 pass, 3 lead-out, 4 travel."""
        return np.asarray(np.searchsorted(self.edges[1:5], t, side="right"))


def steady(path: BladePath) -> PassCourse:
    """The pass alone, at its programmed feed from end to end; nodes are the waypoints."""
    n = len(path.s)
    seconds = np.diff(path.s) / (0.5 * (path.feed[1:] + path.feed[:-1]))
    at = np.concatenate([[0.0], np.cumsum(seconds)])
    edges = np.array([0.0, 0.0, 0.0, at[-1], at[-1], at[-1]])
    return PassCourse(at, path.s, np.ones(n), path.feed, np.zeros(n), np.ones(n), edges)


def air_to_air(path: BladePath, entry: Engagement, step: float) -> PassCourse:
    """The whole way of a line; nodes in the pass about `step` s apart, closer where blade and wheel meet.

    Raises CannotGrind where the line is so short that no node stands between its ramps, or the force hardly rises.
    """
    length = np.diff(path.s) / (0.5 * (path.feed[1:] + path.feed[:-1]))
    driven = np.concatenate([[0.0], np.cumsum(length)])  # s at the programmed feed
    ramp_way = entry.ramp * float(rise(np.array(1.0), entry.slope, -1))
    peak = peak_share(float(driven[-1]), ramp_way)
    full = (driven[-1] - 2.0 * peak * ramp_way) / peak
    if full < 2.0 * step or peak < LEAST_PEAK:
        raise _too_short(path, full, peak, step)
    edges = np.cumsum([0.0, entry.approach, entry.ramp, full, entry.ramp, entry.approach])
    out = np.linspace(0.0, 1.0, AIR_NODES + 1)
    up = np.linspace(0.0, 1.0, RAMP_NODES + 1)
    middle = np.linspace(edges[2], edges[3], max(int(np.ceil(full / step)), 2) + 1)
    at = np.concatenate(
        [
            edges[1] * out,
            edges[1] + entry.ramp * up[1:],
            middle[1:],
            edges[3] + entry.ramp * up[1:],
            edges[4] + entry.approach * out[1:],
        ]
    )
    x = np.minimum(at - edges[1], edges[4] - at) / entry.ramp
    ramped = peak * entry.ramp * rise(x, entry.slope, -1)
    cruised = peak * np.clip(at - edges[2], 0.0, full)
    way = np.where(at <= 0.5 * (edges[2] + edges[3]), ramped + cruised, driven[-1] - ramped - peak * full + cruised)
    s = np.interp(way, driven, path.s) if np.ptp(path.feed) > 0 else path.s[0] + way * path.feed[0]
    s = np.clip(s, path.s[0], path.s[-1])
    blank = np.zeros(len(at))
    course = PassCourse(at, s, blank, blank, blank, ((at > edges[2] - 1e-9) & (at < edges[3] + 1e-9)) * 1.0, edges, peak, entry)
    share = course.share_at(at)
    return replace(course, share=share, speed=share * np.interp(s, path.s, path.feed), gap=course.gap_at(at))


def _too_short(path: BladePath, full: float, peak: float, step: float) -> CannotGrind:
    """Of a line whose force rises to `peak` of what it should and stays there for `full` s, with nodes `step` s apart: any piece
    is shorter still, but where it is driven faster than on average nodes are nearer to each other in time."""
    feed = float(path.feed.mean())
    reason = f"{path.s[-1] * 1e3:.1f} mm are too short to engage and to lift off at {1e3 * feed:.3g} mm/s"
    slower = 0.99 * feed * min(peak / LEAST_PEAK, 1.0) if peak < LEAST_PEAK else feed
    ways = [f"lower the feed there to {1e3 * slower:.3g} mm/s or less"] if slower < feed else []
    if full * slower < 2.0 * step * feed:  # ramps that shorten a force leave as long under it at any feed
        ways.append(f"use a --step of at most {floor(1e5 * full / 2.0 * slower) / 100:g} mm")
    would_do = f"{' and '.join(ways)}, or make the line longer"
    everywhere = np.full(len(path.s), peak < LEAST_PEAK or np.ptp(path.feed) == 0)
    told = f"line {path.line} ({path.side}): {reason}; {would_do}"
    return CannotGrind.of(path, everywhere, reason, would_do, 0, told)


def peak_share(seconds: float, ramp: float) -> float:
    """The share of the programmed force and feed that a line of `seconds` at that feed is driven with, when each of its ramps
    covers what takes `ramp` seconds there."""
    return min(1.0, 0.5 * LONGEST_RAMPS * seconds / ramp)


def lengthened(path: BladePath, before: float, after: float) -> BladePath:
    """The line with waypoints as far apart as its own, `before` and `after` m beyond its ends, where the surface goes on as
    cubics through its last stretch have it; s there is negative and beyond its length."""
    step = float(np.median(np.diff(path.s)))
    front, back = (int(room / step + 1e-6) for room in (before, after))  # not one less by rounding
    ends = [-step * np.arange(front, 0, -1), path.s[-1] + step * np.arange(1, back + 1)]
    length = float(path.s[-1])
    values: dict[str, Any] = {"s": np.concatenate([ends[0], path.s, ends[1]])}
    for name in ("p", "n", "t", "curvature", "extent", "feed", "force"):
        own = getattr(path, name)
        parts = [own]
        if name in ("p", "n", "t"):
            for s, at in ((ends[0], 0.0), (ends[1], length)):
                near = np.abs(path.s - at) <= min(FITTED, length)
                fit = np.polynomial.polynomial.polyfit(path.s[near] - at, own[near], min(3, max(int(near.sum()) - 2, 1)))
                fit[0] = own[0] if at == 0.0 else own[-1]
                more = np.polynomial.polynomial.polyval(s - at, fit).T
                parts = [more, *parts] if at == 0.0 else [*parts, more]
        else:
            parts = [np.repeat(own[:1], len(ends[0]), axis=0), own, np.repeat(own[-1:], len(ends[1]), axis=0)]
        values[name] = np.concatenate(parts)
    for name in ("n", "t"):
        values[name] /= np.linalg.norm(values[name], axis=1, keepdims=True)
    return replace(path, **values)


def path_at(path: BladePath, s: Array) -> BladePath:
    """The line at other arc lengths s (n,) m, in any order."""
    values: dict[str, Any] = {}
    for field in fields(path):
        value = getattr(path, field.name)
        if isinstance(value, np.ndarray) and field.name != "s":
            values[field.name] = np.asarray(CubicSpline(path.s, value)(s))
    for name in ("n", "t"):
        values[name] /= np.linalg.norm(values[name], axis=1, keepdims=True)
    values |= {name: np.interp(s, path.s, getattr(path, name)) for name in ("feed", "force")}
    return replace(path, s=s, **values)
