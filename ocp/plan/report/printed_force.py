"""Predicted force along every pass with the band of two standard deviations and the target, on paper."""

import numpy as np
from matplotlib.axes import Axes

from ocp.plan.report.charts import force_range
from ocp.plan.report.data import PassReport, PlanReport
from ocp.report.style import (
    CURVE,
    INK,
    SOFT,
    TARGET,
    Sheet,
    envelope,
    grid_of_axes,
    new_sheet,
    printable,
)

PASSES_PER_SHEET = 18
"""Nine rows of two: about 25 mm high each, enough to read a tenth of the axis."""


def force_sheets(report: PlanReport) -> list[Sheet]:
    """As many sheets as the passes need; all panels share both axes."""
    low, high = force_range(report)
    longest = max(float(item.s[-1]) for item in report.passes) * 1e3 or 1.0
    sheets = []
    for first in range(0, len(report.passes), PASSES_PER_SHEET):
        group = report.passes[first : first + PASSES_PER_SHEET]
        sheet = new_sheet(
            "Predicted force along each pass",
            f"N over mm along the pass. Band: plus and minus two standard deviations. Dashed: target {report.target_force:g} N.",
        )
        rows = max(3, (len(group) + 1) // 2)
        axes = [ax for row in grid_of_axes(sheet, rows, 2, sharex=True, sharey=True) for ax in row]
        for ax, item in zip(axes, group, strict=False):
            _panel(ax, item, report.target_force)
        axes[0].set_xlim(0, longest)
        axes[0].set_ylim(low, high)
        for ax in axes[len(group) :]:
            ax.set_visible(False)
        # Shared axes print their numbers in the lowest row only; an odd last row leaves one column without.
        for ax in axes[max(len(group) - 2, 0) : len(group)]:
            ax.tick_params(labelbottom=True)
        sheets.append(sheet)
    return sheets


def _panel(ax: Axes, item: PassReport, target: float) -> None:
    s = 1e3 * np.asarray(item.s, float)
    ax.fill_between(s, item.force - 2 * item.force_sd, item.force + 2 * item.force_sd, color=CURVE, alpha=0.18, lw=0)
    ax.axhline(target, color=TARGET, lw=0.8, dashes=(4, 3))
    ax.plot(*envelope(s, item.force), color=CURVE)
    ax.grid(axis="y")
    ax.tick_params(length=2, labelsize=6.5)
    ax.locator_params(axis="y", nbins=4)
    ax.set_title(printable(f"Line {item.line}, {item.side}"), fontsize=7.5, color=INK, loc="left", pad=2)
    ax.set_title(_figures(item), fontsize=6.5, color=SOFT, loc="right", pad=2)


def _figures(item: PassReport) -> str:
    """Range of the force and largest deviation in words, where they are known."""
    force, sd = item.force[np.isfinite(item.force)], item.force_sd[np.isfinite(item.force_sd)]
    words = [f"{force.min():.2f} to {force.max():.2f} N"] if len(force) else ["force not known"]
    return ", ".join(words + ([f"sd up to {sd.max():.2f} N"] if len(sd) else []))
