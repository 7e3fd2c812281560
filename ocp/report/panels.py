"""Axes of plots that stand on the page and on paper alike: margins in inches, quiet frames, titles at the left."""

from typing import Any, Literal

import numpy as np
from matplotlib.axes import Axes
from matplotlib.ticker import FuncFormatter

from ocp.report.section import Canvas
from ocp.report.style import CURVE, INK, SOFT, printable
from robots.pose import Array

DOTS: dict[str, Any] = {"linestyle": "none", "marker": "o", "markeredgewidth": 0}
BEFORE = "#8a94a0"  # grey of everything before calibration
AFTER = CURVE
BAD = "#9c2f0a"  # outliers
MANY = 1500  # points of a panel from which they are drawn as pixels: a page of 100 000 marks opens slowly


def panels(canvas: Canvas, rows: int, columns: int, **options: Any) -> list[list[Axes]]:
    """Rows of axes that fill a canvas; options as `Canvas.subplots`."""
    return [list(row) for row in canvas.subplots(rows, columns, squeeze=False, **options)]


def dressed(ax: Axes, title: str = "", x: str = "", y: str = "", grid: Literal["", "x", "y", "both"] = "y") -> Axes:
    """Title, labels and grid in the report's manner."""
    if title:
        ax.set_title(printable(title), fontsize=7.5, color=INK, loc="left", pad=3)
    if x:
        ax.set_xlabel(printable(x), fontsize=7, labelpad=2)
    if y:
        ax.set_ylabel(printable(y), fontsize=7, labelpad=2)
    ax.tick_params(length=2, labelsize=6.5, pad=2)
    ax.set_axisbelow(True)
    if grid:
        ax.grid(axis=grid)
    return ax


def dots(ax: Axes, x: Any, y: Any, colour: str, size: float = 2.2, **options: Any) -> None:
    """Points without lines; as pixels where they are many."""
    ax.plot(x, y, color=colour, markersize=size, rasterized=len(np.atleast_1d(x)) > MANY, **(DOTS | options))


def keys(ax: Axes, entries: list[tuple[str, str]], top: float = 1.0, **options: Any) -> None:
    """A legend in one line above the right end of the axes: (label, colour)."""
    handles = [ax.plot([], [], color=colour, markersize=3.5, **DOTS)[0] for _, colour in entries]
    settings: dict[str, Any] = {
        "loc": "lower right", "bbox_to_anchor": (1.0, top), "ncols": len(entries), "frameon": False, "fontsize": 6.5,
        "handletextpad": 0.1, "columnspacing": 1.2, "borderaxespad": 0.1, "labelcolor": SOFT,
    }  # fmt: skip
    ax.legend(handles, [printable(label) for label, _ in entries], **(settings | options))


def log_scale(ax: Axes) -> None:
    """A logarithmic y axis with plain numbers at the powers of ten."""
    ax.set_yscale("log")
    ax.yaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
    ax.yaxis.set_minor_formatter(FuncFormatter(lambda value, _: ""))


def reach(values: Array, least: float = 1e-6) -> float:
    """Half a symmetric range that holds all but the wildest values: 1.25 times the 98th percentile of their sizes."""
    sizes = np.abs(values[np.isfinite(values)])
    return max(1.25 * float(np.percentile(sizes, 98)), least) if len(sizes) else least


def running_median(x: Array, y: Array, bins: int = 12, fewest: int = 5) -> tuple[Array, Array]:
    """Medians of y over bins of equally many points; nothing where there would be fewer than two bins."""
    bins = min(bins, len(x) // fewest)
    if bins < 2:
        return np.array([]), np.array([])
    parts = np.array_split(np.argsort(x, kind="stable"), bins)
    return np.array([np.median(x[p]) for p in parts]), np.array([np.median(y[p]) for p in parts])
