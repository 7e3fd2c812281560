"""Where and how the blade touches the wheel, on paper: place on the wheel, turn about the normal, tilts.

The angles are those of docs/architecture.md; zero turn means that blade and belt move along one line.
"""

from itertools import cycle
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.lines import Line2D

from ocp.plan.report.data import PlanReport
from ocp.plan.report.quantities import sides_of
from ocp.report.style import INK, LIMIT, Sheet, grid_of_axes, new_sheet, printable
from robots.pose import Array


def contact_sheet(report: PlanReport) -> Sheet:
    """One sheet: arc over lateral position on the wheel, then turn and both tilts along the passes."""
    sheet = new_sheet(
        "Contact on the wheel",
        "A curve a pass, a dot at its start. Tilt 1 is the slope along the belt, tilt 2 the slope across it.",
    )
    sides, deg = sides_of(report), 180 / np.pi
    axes = grid_of_axes(sheet, 2, 2, spacing={"hspace": 0.25, "wspace": 0.25, "top": 0.86})
    place, turn, tilt_along, tilt_across = axes[0][0], axes[0][1], axes[1][0], axes[1][1]
    half = 500 * report.animation.wheel.width
    dashes = dict(zip(sides, cycle(((), (4, 1.5), (1, 1))), strict=False))
    for item in report.passes:
        s, style = 1e3 * np.asarray(item.s), {"color": sides[item.side], "dashes": dashes[item.side]}
        _curve(place, 1e3 * np.asarray(item.lateral), deg * np.asarray(item.arc), style)
        _curve(turn, s, deg * np.asarray(item.turn), style)
        _curve(tilt_along, s, deg * np.asarray(item.tilt)[:, 0], style)
        _curve(tilt_across, s, deg * np.asarray(item.tilt)[:, 1], style)
    for edge in (-half, half):
        place.axvline(edge, color=LIMIT, lw=1.0)
    place.set_xlim(-1.1 * half, 1.1 * half)
    _dress(place, "Place on the wheel: arc in deg over lateral in mm, red: wheel edges")
    _dress(turn, "Turn about the normal in deg over mm along the pass")
    _dress(tilt_along, "Tilt 1 in deg over mm along the pass")
    _dress(tilt_across, "Tilt 2 in deg over mm along the pass")
    handles = [Line2D([], [], color=c, dashes=dashes[side], label=printable(side)) for side, c in sides.items()]
    where = {"loc": "upper right", "bbox_to_anchor": (0.93, 0.95)}
    sheet.figure.legend(handles=handles, ncols=len(handles), frameon=False, **where)
    return sheet


def _curve(ax: Axes, x: Array, y: Array, style: dict[str, Any]) -> None:
    ax.plot(x, y, lw=0.8, alpha=0.85, **style)
    ax.plot(x[:1], y[:1], ".", color=style["color"], ms=4)


def _dress(ax: Axes, title: str) -> None:
    """Grid, small numbers, and a scale that does not blow up differences below a tenth of a degree."""
    ax.grid()
    ax.tick_params(length=2, labelsize=6.5)
    low, high = ax.get_ylim()
    if high - low < 0.2:
        ax.set_ylim((low + high) / 2 - 0.1, (low + high) / 2 + 0.1)
    ax.set_title(title, fontsize=7.5, color=INK, loc="left", pad=3)
