"""The section "Contact on the wheel": where and how the blade touches it: place, turn about the normal, tilts.

The angles are those of docs/architecture.md; zero turn means that blade and belt move along one line.
"""

from itertools import cycle
from typing import Any

import numpy as np
from matplotlib.axes import Axes

from ocp.plan.report.plan_report import PlanReport
from ocp.plan.report.quantities import sides_of
from ocp.report.parts import Plot
from ocp.report.plotting import Canvas, dressed, keys, panels
from ocp.report.section import Section
from ocp.report.style import LIMIT
from robots.pose import Array


def contact_section(report: PlanReport) -> Section:
    """Arc over lateral position on the wheel, then turn and both tilts along the passes."""
    caption = "A curve a pass, a dot at its start. Tilt 1 is the slope along the belt, tilt 2 the slope across it."
    return Section("Contact on the wheel", (Plot("contact", caption, 5.6, lambda canvas: _draw(canvas, report)),))


def _draw(canvas: Canvas, report: PlanReport) -> None:
    sides, deg = sides_of(report), 180 / np.pi
    (place, turn), (tilt_along, tilt_across) = panels(canvas, 2, 2, top=0.4, bottom=0.25)
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
    _dress(place, "Arc in deg over lateral place in mm, red: wheel edges")
    _dress(turn, "Turn about the normal in deg over mm along the pass")
    _dress(tilt_along, "Tilt 1 in deg over mm along the pass")
    _dress(tilt_across, "Tilt 2 in deg over mm along the pass")
    keys(turn, list(sides.items()), top=1.06)


def _curve(ax: Axes, x: Array, y: Array, style: dict[str, Any]) -> None:
    ax.plot(x, y, lw=0.8, alpha=0.85, **style)
    ax.plot(x[:1], y[:1], ".", color=style["color"], ms=4)


def _dress(ax: Axes, title: str) -> None:
    """A scale that does not blow up differences below a tenth of a degree."""
    low, high = ax.get_ylim()
    if high - low < 0.2:
        ax.set_ylim((low + high) / 2 - 0.1, (low + high) / 2 + 0.1)
    dressed(ax, title, grid="both")
