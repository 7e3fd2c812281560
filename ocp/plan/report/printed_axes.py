"""Positions, speeds, accelerations and torques of the six axes over time against their limits, on paper.

Where an axis uses little of a limit the curve would be a flat line between far limits: the panel then shows
the curve at its own size and says where the limit is.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np
from matplotlib.axes import Axes

from ocp.plan.report.charts import contact_spans
from ocp.plan.report.data import PlanReport
from ocp.report.style import CURVE, INK, LIMIT, SHADE, SOFT, Sheet, envelope, grid_of_axes, new_sheet
from robots.pose import Array

SHOW_LIMIT_FROM = 0.4
"""Use of a limit from which its line is drawn to scale."""


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


def axes_sheets(report: PlanReport) -> list[Sheet]:
    """Two sheets: positions and speeds, accelerations and torques; a row an axis, contact shaded."""
    motion, limits, deg = report.motion, report.limits, 180 / np.pi

    def curve(kind: str, unit: str, sampled: Array, low: Array, high: Array, i: int, k: float, digits: int) -> AxisCurve:
        scaled = (k * np.asarray(sampled, float)[:, i], k * float(low[i]), k * float(high[i]))
        return AxisCurve(f"A{i + 1} {kind}", unit, motion.time, *scaled, digits)

    first = [
        [
            curve("position", "deg", motion.q, limits.q_min, limits.q_max, i, deg, 1),
            curve("speed", "deg/s", motion.qd, -limits.qd_max, limits.qd_max, i, deg, 1),
        ]
        for i in range(6)
    ]
    second = [
        [
            curve("acceleration", "rad/s²", motion.qdd, -limits.qdd_max, limits.qdd_max, i, 1.0, 2),
            curve("torque", "N m", motion.torque, -limits.torque_max, limits.torque_max, i, 1.0, 0),
        ]
        for i in range(6)
    ]
    spans = contact_spans(report)
    return [
        _sheet("Axis positions and speeds", first, spans),
        _sheet("Axis accelerations and torques", second, spans),
    ]


def _sheet(heading: str, curves: list[list[AxisCurve]], spans: tuple[tuple[int, float, float], ...]) -> Sheet:
    sheet = new_sheet(
        heading,
        "Over time in s; shaded: in contact; red: limit. Where little of a limit is used it is off the scale and told in words.",
    )
    axes = grid_of_axes(sheet, len(curves), 2, sharex=True, spacing={"hspace": 0.42})
    for row, pair in zip(axes, curves, strict=True):
        for ax, curve in zip(row, pair, strict=True):
            _panel(ax, curve)
            # One collection for all stretches: a hundred passes stay quick.
            ax.broken_barh(
                [(start, end - start) for _, start, end in spans],
                (0, 1),
                transform=ax.get_xaxis_transform(),
                color=SHADE,
                lw=0,
                zorder=0,
            )
    axes[0][0].set_xlim(float(curves[0][0].time[0]), float(curves[0][0].time[-1]))
    return sheet


def use_of_limit(curve: AxisCurve) -> float:
    """Largest distance from the middle of the range over half the range; nan where there is no limit."""
    if not (np.isfinite(curve.low) and np.isfinite(curve.high)):
        return float("nan")
    return float(np.nanmax(np.abs(2 * curve.sampled - curve.low - curve.high)) / (curve.high - curve.low))


def _panel(ax: Axes, curve: AxisCurve) -> None:
    use = use_of_limit(curve)
    ax.plot(*envelope(curve.time, curve.sampled), color=CURVE, lw=0.7)
    ax.grid(axis="y")
    ax.tick_params(length=2, labelsize=6.5)
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
    ax.set_title(f"{curve.title}, {curve.unit}", fontsize=7.5, color=INK, loc="left", pad=2)
    ax.set_title(words, fontsize=6.5, loc="right", pad=2, **style)
