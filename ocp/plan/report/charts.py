"""Force along every pass as paths for inline SVG, and the bands of the time line.

Only numbers are put into the strings here; words reach the page through the template, which escapes them.
"""

from dataclasses import dataclass

import numpy as np

from ocp.plan.report.data import PlanReport
from ocp.plan.report.quantities import nice_ticks
from robots.pose import Array

WIDTH, HEIGHT = 320.0, 132.0
LEFT, RIGHT, TOP, BOTTOM = 34.0, 8.0, 8.0, 20.0
"""Size and margins of one panel in SVG units."""
MAX_POINTS = 400
"""Points drawn of one pass; a panel is about 400 pixels wide."""


@dataclass(frozen=True)
class Tick:
    """A tick: place in the panel and its label."""

    at: float
    label: str


@dataclass(frozen=True)
class ForcePanel:
    """One pass: paths of the band of two standard deviations and of the force, ticks, target height."""

    index: int
    line: int
    side: str
    band: str
    curve: str
    target: float
    x_ticks: tuple[Tick, ...]
    y_ticks: tuple[Tick, ...]


@dataclass(frozen=True)
class Band:
    """A stretch of contact on the time line, in percent of the whole duration."""

    line: int
    left: float
    width: float


def force_panels(report: PlanReport) -> tuple[ForcePanel, ...]:
    """One panel a pass; all share the axes, so that passes can be compared at a glance."""
    low, high = force_range(report)
    longest = max(float(item.s[-1]) for item in report.passes) * 1e3 or 1.0
    y_ticks = nice_ticks(low, high, 4)
    decimals = decimals_of(y_ticks)

    def across(s: Array) -> Array:
        return LEFT + (WIDTH - LEFT - RIGHT) * np.asarray(s) / longest

    def up(force: Array) -> Array:
        return HEIGHT - BOTTOM - (HEIGHT - TOP - BOTTOM) * (np.asarray(force) - low) / (high - low)

    panels = []
    for index, item in enumerate(report.passes):
        pick = np.linspace(0, len(item.s) - 1, min(len(item.s), MAX_POINTS)).round().astype(int)
        x, force, sd = across(1e3 * item.s[pick]), item.force[pick], item.force_sd[pick]
        panels.append(
            ForcePanel(
                index=index,
                line=int(item.line),
                side=item.side,
                band=_band_path(x, up(force + 2 * sd), up(force - 2 * sd)),
                curve=_path(x, up(force)),
                target=round(float(up(np.array(report.target_force))), 1),
                x_ticks=tuple(Tick(round(float(across(t)), 1), f"{t:g}") for t in nice_ticks(0, longest, 5)),
                y_ticks=tuple(Tick(round(float(up(t)), 1), f"{t:.{decimals}f}") for t in y_ticks),
            )
        )
    return tuple(panels)


def force_range(report: PlanReport) -> tuple[float, float]:
    """Common axis N of all force panels: target, forces and twice their deviations, with 5 % of air."""
    ends = [report.target_force - 0.1, report.target_force + 0.1]
    for item in report.passes:
        for edge in (item.force, item.force - 2 * item.force_sd, item.force + 2 * item.force_sd):
            known = edge[np.isfinite(edge)]
            ends += [float(known.min()), float(known.max())] if len(known) else []
    low, high = min(ends), max(ends)
    return low - 0.05 * (high - low), high + 0.05 * (high - low)


def contact_bands(report: PlanReport) -> tuple[Band, ...]:
    """Stretches of contact of the motion, for shading: one for each run of samples with the same line."""
    time, length = report.motion.time, float(report.motion.time[-1] - report.motion.time[0])
    bands = []
    for line, start, end in contact_spans(report):
        left = 100 * (start - float(time[0])) / length
        bands.append(Band(line, round(left, 3), round(100 * (end - start) / length, 3)))
    return tuple(bands)


def contact_spans(report: PlanReport) -> tuple[tuple[int, float, float], ...]:
    """(line, start s, end s) of every stretch of contact."""
    motion = report.motion
    key = np.where(np.asarray(motion.contact, bool), np.asarray(motion.line, int), 0)
    edges = np.flatnonzero(np.diff(key)) + 1
    starts, ends = np.concatenate([[0], edges]), np.concatenate([edges, [len(key)]]) - 1
    return tuple((int(key[a]), float(motion.time[a]), float(motion.time[b])) for a, b in zip(starts, ends, strict=True) if key[a])


def decimals_of(ticks: Array) -> int:
    """Digits after the point that tell neighbouring ticks apart."""
    step = float(ticks[1] - ticks[0]) if len(ticks) > 1 else 1.0
    return max(0, int(np.ceil(-np.log10(step) - 1e-9)))


def _path(x: Array, y: Array) -> str:
    """SVG path through the finite points, a gap (new M) wherever some are not finite."""
    words, pen = [], "M"
    for a, b in zip(x.tolist(), y.tolist(), strict=True):
        if not (np.isfinite(a) and np.isfinite(b)):
            pen = "M"
            continue
        words.append(f"{pen}{a:.1f} {b:.1f}")
        pen = "L"
    return "".join(words)


def _band_path(x: Array, upper: Array, lower: Array) -> str:
    """Closed SVG path around a band, over the points where both edges are finite."""
    known = np.isfinite(upper) & np.isfinite(lower)
    if not known.any():
        return ""
    there = np.concatenate([x[known], x[known][::-1]])
    edge = np.concatenate([upper[known], lower[known][::-1]])
    return _path(there, edge) + "Z"
