"""The section "Axes against their limits": how far each limit is used, and positions, speeds, accelerations, torques over time.

Where an axis uses little of a limit the curve would be a flat line between far limits: the panel then shows the curve at its own
size and says where the limit is.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np
from matplotlib.axes import Axes

from ocp.plan.report.plan_report import PlanReport
from ocp.report.parts import Plot, Table, table
from ocp.report.plotting import Canvas, dressed, envelope, panels
from ocp.report.section import Section
from ocp.report.style import CURVE, LIMIT, SHADE, SOFT
from robots.pose import Array

SHOW_LIMIT_FROM = 0.4
"""Use of a limit from which its line is drawn to scale."""
DIGITS = {"position": 1, "speed": 2, "acceleration": 2, "torque": 0}
"""Decimals of the table by what is limited."""


def axes_section(report: PlanReport) -> Section:
    """Table and curves of the six axes over the whole motion."""
    words = (
        "Largest values over the whole program, air moves included. Position: 0 % in the middle of the range, 100 % at an end. "
        "Torque at the link side."
    )
    return Section(
        "Axes against their limits",
        (
            words,
            limit_table(limit_rows(report)),
            _curves_plot(report, "positions and speeds", ("position", "speed")),
            _curves_plot(report, "accelerations and torques", ("acceleration", "torque")),
        ),
    )


@dataclass(frozen=True)
class AxisCurve:
    """One panel: title, unit, time s, values, limits in that unit (not finite = none), decimals."""

    title: str
    unit: str
    time: Array
    sampled: Array
    low: float
    high: float
    decimals: int = 0


def axis_curves(report: PlanReport, kind: str) -> list[AxisCurve]:
    """The six axes' curves of "position", "speed", "acceleration" or "torque"."""
    motion, limits, deg = report.motion, report.robot, 180 / np.pi
    unit, sampled, low, high, factor, decimals = {
        "position": ("deg", motion.q, limits.q_min, limits.q_max, deg, 1),
        "speed": ("deg/s", motion.qd, -limits.qd_max, limits.qd_max, deg, 1),
        "acceleration": ("rad/s²", motion.qdd, -limits.qdd_max, limits.qdd_max, 1.0, 2),
        "torque": ("N m", motion.torque, -limits.torque_max, limits.torque_max, 1.0, 0),
    }[kind]
    scaled = factor * np.asarray(sampled, float)
    return [
        AxisCurve(f"A{i + 1} {kind}", unit, motion.time, scaled[:, i], factor * float(low[i]), factor * float(high[i]), decimals)
        for i in range(6)
    ]


@dataclass(frozen=True)
class LimitRow:
    """Use of one kind of limit by one axis: "A1", kind, the extreme value, the limit, their ratio (1 = at
    the limit).
    """

    axis: str
    kind: str
    value: str
    limit: str
    ratio: float
    time: float


def limit_rows(report: PlanReport) -> tuple[LimitRow, ...]:
    """Six axes times position, speed, acceleration and torque over the whole motion, air moves included."""
    curves = {kind: axis_curves(report, kind) for kind in DIGITS}
    return tuple(_limit_row(axis, kind, curves[kind][axis]) for axis in range(6) for kind in DIGITS)


def _limit_row(axis: int, kind: str, curve: AxisCurve) -> LimitRow:
    limited = np.isfinite(curve.low) and np.isfinite(curve.high) and curve.low < curve.high
    middle = 0.5 * (curve.low + curve.high) if limited else 0.0
    worst = int(np.argmax(np.abs(np.nan_to_num(curve.sampled - middle))))
    digits, unit = DIGITS[kind], curve.unit
    size = abs(float(np.nan_to_num(curve.sampled[worst])))
    if not limited:
        value, limit = f"{size:.3g} {unit}", "none"
    elif kind == "position":
        value = f"{curve.sampled.min():.{digits}f} .. {curve.sampled.max():.{digits}f} {unit}"
        limit = f"{curve.low:.{digits}f} .. {curve.high:.{digits}f} {unit}"
    else:
        value, limit = f"{size:.{digits}f} {unit}", f"{curve.high:.{digits}f} {unit}"
    ratio = use_of_limit(curve) if limited else float("nan")
    return LimitRow(f"A{axis + 1}", kind, value, limit, ratio, float(curve.time[worst]))


def limit_table(rows: tuple[LimitRow, ...]) -> Table:
    """Extreme values beside their limits, with bars of the use; bold where a limit is exceeded."""
    cells = [
        (row.axis if k % 4 == 0 else "", row.kind, row.value, row.limit, _use(row), f"{row.time:.2f} s")
        for k, row in enumerate(rows)
    ]
    over = [k for k, row in enumerate(rows) if row.ratio > 1]
    columns = ("Axis", "What", "Reached", "Limit", "Use", "At")
    return table(columns, cells, text=(0, 1, 4), strong=over, bars={4: tuple(row.ratio for row in rows)})


def _use(row: LimitRow) -> str:
    if not np.isfinite(row.ratio):
        return "not limited"
    return f"{100 * row.ratio:.0f} %{' over the limit' if row.ratio > 1 else ''}"


def _curves_plot(report: PlanReport, what: str, kinds: tuple[str, str]) -> Plot:
    caption = (
        f"{what.capitalize()} over time in s; shaded: in contact; red: limit. Where little of a limit is used it is off the "
        "scale and told in words."
    )
    return Plot(what.replace(" ", "-"), caption, 8.7, lambda canvas: _draw_curves(canvas, report, kinds))


def _draw_curves(canvas: Canvas, report: PlanReport, kinds: tuple[str, str]) -> None:
    spans = [(start, end - start) for _, start, end in report.contact_spans()]
    axes = panels(canvas, 6, 2, down=0.4, across=0.45, bottom=0.3, sharex=True)
    for column, kind in enumerate(kinds):
        for row, curve in zip(axes, axis_curves(report, kind), strict=True):
            ax = row[column]
            _draw_curve(ax, curve)
            # One collection for all stretches: a hundred passes stay quick.
            ax.broken_barh(spans, (0, 1), transform=ax.get_xaxis_transform(), color=SHADE, lw=0, zorder=0)
    axes[0][0].set_xlim(float(report.motion.time[0]), float(report.motion.time[-1]))


def use_of_limit(curve: AxisCurve) -> float:
    """Largest distance from the middle of the range over half the range; nan where there is no limit."""
    if not (np.isfinite(curve.low) and np.isfinite(curve.high)):
        return float("nan")
    return float(np.nanmax(np.abs(2 * curve.sampled - curve.low - curve.high)) / (curve.high - curve.low))


def _draw_curve(ax: Axes, curve: AxisCurve) -> None:
    use = use_of_limit(curve)
    ax.plot(*envelope(curve.time, curve.sampled), color=CURVE, lw=0.7)
    ax.locator_params(axis="y", nbins=5)
    words = "no limit"
    if use >= SHOW_LIMIT_FROM:
        for bound in (curve.low, curve.high):
            ax.axhline(bound, color=LIMIT, lw=1.0)
        gap = 0.06 * (curve.high - curve.low)
        ax.set_ylim(min(curve.low, np.nanmin(curve.sampled)) - gap, max(curve.high, np.nanmax(curve.sampled)) + gap)
        words = f"{100 * use:.0f} % used"
    elif np.isfinite(use):
        low, high = f"{curve.low:.{curve.decimals}f}", f"{curve.high:.{curve.decimals}f}"
        words = f"{100 * use:.0f} % used, limit " + (f"±{high}" if curve.low == -curve.high else f"{low} to {high}")
    style: dict[str, Any] = {"color": LIMIT, "fontweight": "bold"} if use > 1 else {"color": SOFT}
    dressed(ax, f"{curve.title}, {curve.unit}")
    ax.set_title(words, fontsize=6.5, loc="right", pad=3, **style)
