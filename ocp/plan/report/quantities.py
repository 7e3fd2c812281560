"""What can be shown along the passes: label, unit, factor from SI and the range its colours span; and the sections that show it.

Page and print take names, units and ranges from here, so the same colour means the same value in both. Sections: "On the unrolled
blade" (quantities as colours, a bar a pass, distance along it to the right) and "Contact on the wheel" (where and how the blade
touches it: place, turn about the normal, tilts; zero turn means that blade and belt move along one line).
"""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import cycle
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.collections import PathCollection, PolyCollection
from matplotlib.colors import Normalize
from matplotlib.path import Path as Outline

from ocp.plan.report.plan_report import GroundPass, LeftOutReport, PassReport, PlanReport
from ocp.report.parts import Plot
from ocp.report.plotting import Canvas, dressed, keys, panels
from ocp.report.section import Section
from ocp.report.style import COLOUR_MAP, LEFT_OUT, LIMIT, RULE, SIDE_COLOURS
from robots.pose import Array


@dataclass(frozen=True)
class Quantity:
    """A value along the passes; `span`: smallest colour range (display units) about `centre`."""

    key: str
    label: str
    unit: str
    factor: float
    decimals: int
    span: float
    centre: str = ""


QUANTITIES = (
    Quantity("force", "Predicted force", "N", 1.0, 2, 0.4, "target"),
    Quantity("force_sd", "Standard deviation of the force", "N", 1.0, 2, 0.1, "zero"),
    Quantity("compliance_nn", "Blade compliance", "µm/N", 1e6, 2, 0.1, "zero"),
    Quantity("removal", "Removal, relative to intended", "", 1.0, 3, 0.04, "one"),
    Quantity("limit_ratio", "Largest use of an axis limit", "", 1.0, 2, 1.0, "zero"),
    Quantity("interference", "Interference of blade and wheel", "mm", 1e3, 3, 0.02),
    Quantity("feed", "Feed", "mm/s", 1e3, 1, 5.0, "zero"),
    Quantity("arc", "Arc angle on the wheel", "deg", 180 / np.pi, 2, 1.0),
    Quantity("lateral", "Lateral position on the wheel", "mm", 1e3, 2, 1.0),
    Quantity("turn", "Turn about the normal", "deg", 180 / np.pi, 2, 1.0),
)
"""What the page offers, in this order; PHYSICS.md 3.1 and docs/architecture.md define the terms."""


def quantity(key: str) -> Quantity:
    """The quantity of that name; KeyError where there is none."""
    return {item.key: item for item in QUANTITIES}[key]


def values_along(report: PlanReport, item: Quantity) -> Array:
    """The quantity at every waypoint of all passes in order, display units, (n,)."""
    return item.factor * np.concatenate([np.asarray(getattr(one, item.key), float) for one in report.passes])


def colour_range(report: PlanReport, item: Quantity) -> tuple[float, float]:
    """Display values of the first and the last colour.

    Around a centre the range is symmetric, so that the middle colour is "as wanted"; it never gets so
    narrow that differences without meaning (solver tolerance) show as colour.
    """
    known = values_along(report, item)
    known = known[np.isfinite(known)]
    low, high = (float(known.min()), float(known.max())) if len(known) else (0.0, 1.0)
    if item.centre in ("target", "one"):
        middle = report.target_force if item.centre == "target" else 1.0
        half = max(abs(low - middle), abs(high - middle), item.span / 2)
        return middle - half, middle + half
    if item.centre == "zero":
        return min(0.0, low), max(high, item.span)
    if high - low < item.span:
        return (low + high - item.span) / 2, (low + high + item.span) / 2
    return low, high


def sides_of(report: PlanReport) -> dict[str, str]:
    """Sides in order of appearance with their colours."""
    names = list(dict.fromkeys(item.side for item in report.passes))
    return {name: SIDE_COLOURS[i % len(SIDE_COLOURS)] for i, name in enumerate(names)}


def maps_section(report: PlanReport) -> Section:
    """Compliance and force; removal, feed and limits."""
    words = "A row a line of the blade; across: mm from the end where the side's first pass starts; arrow: feed."
    if report.left_out:
        words += " Hatched red: left out."
    return Section(
        "On the unrolled blade",
        (
            words,
            _map_plot(report, "Compliance and force", ("compliance_nn", "force_sd", "force")),
            _map_plot(report, "Removal, feed and limits", ("removal", "feed", "limit_ratio")),
        ),
    )


def _map_plot(report: PlanReport, caption: str, keys: tuple[str, ...]) -> Plot:
    """A row a quantity (of `QUANTITIES`) and a column a side of the blade."""
    most = max(sum(one.side == side for one in report.passes) for side in sides_of(report))
    height = 0.3 + len(keys) * (0.45 + min(max(0.9, 0.22 * most), 2.2))
    return Plot(f"map-{keys[0].replace('_', '-')}", caption, height, lambda canvas: _draw_maps(canvas, report, keys))


def _draw_maps(canvas: Canvas, report: PlanReport, keys: tuple[str, ...]) -> None:
    sides = {side: _Strips.of(report, side) for side in sides_of(report)}
    axes = panels(canvas, len(keys), len(sides), left=0.3, right=0.7, across=0.35, down=0.45, bottom=0.3)
    for row, key in zip(axes, keys, strict=True):
        item = quantity(key)
        norm = Normalize(*colour_range(report, item))
        for ax, (side, strips) in zip(row, sides.items(), strict=True):
            _draw_bars(ax, strips, item, norm)
            ax.set_facecolor("#f2f4f6")
            step = max(1, len(strips.lines) // 16)
            ax.set_yticks(range(0, len(strips.lines), step), [str(line) for line in strips.lines[::step]])
            dressed(ax, f"{item.label}{f', {item.unit}' if item.unit else ''}: {side}", grid="")
            ax.tick_params(color=RULE)
        bar = row[-1].inset_axes((1.05, 0.0, 0.045, 1.0))
        canvas.figure.colorbar(ScalarMappable(norm, COLOUR_MAP), cax=bar)
        bar.tick_params(pad=3.5)


def common_distance(group: Sequence[GroundPass]) -> list[Array]:
    """Distance m along each pass from the same end of the blade, whichever way the pass is fed.

    The direction is the first pass's; passes fed against it are counted backwards. Starts are set apart by
    where they lie along that direction.
    """
    direction = group[0].p[-1] - group[0].p[0]
    direction = direction / max(float(np.linalg.norm(direction)), 1e-12)
    origin = min(float((item.p @ direction).min()) for item in group)
    result = []
    for item in group:
        forward = (item.p[-1] - item.p[0]) @ direction >= 0
        along = item.s if forward else item.s[-1] - item.s
        result.append(np.asarray(along + float((item.p @ direction).min()) - origin))
    return result


@dataclass(frozen=True)
class _Strips:
    """The passes of a side as strips of cells with the waypoints in their middles, in the rows of their `lines`: outlines of all
    cells, laid once for every quantity that colours them; ends (passes, 2) mm; distances m along passes and what is left out."""

    group: list[PassReport]
    lost: list[LeftOutReport]
    lines: list[int]
    distances: list[Array]
    ends: Array
    cells: Sequence[Outline]

    @staticmethod
    def of(report: PlanReport, side: str) -> "_Strips":
        """Those of a side."""
        group = [one for one in report.passes if one.side == side]
        lost = [one for one in report.left_out if one.side == side and len(one.s)]
        lines = list(dict.fromkeys([one.line for one in group] + [one.lost.line for one in lost]))
        distances, cells, ends = common_distance([*group, *lost]), [], []
        for one, along in zip(group, distances[: len(group)], strict=True):
            place = lines.index(one.line)
            x = 1e3 * along
            edges = np.concatenate([x[:1], (x[1:] + x[:-1]) / 2, x[-1:]]) if len(x) > 1 else x[0] + np.array([-0.5, 0.5])
            left, right, foot, head = edges[:-1], edges[1:], np.full(len(x), place - 0.42), np.full(len(x), place + 0.42)
            cells.append(np.stack([np.c_[left, foot], np.c_[right, foot], np.c_[right, head], np.c_[left, head]], axis=1))
            ends.append((edges[0], edges[-1]))
        corners: Any = np.concatenate(cells)  # as one array, of which outlines are made faster than of a list
        return _Strips(group, lost, lines, distances, np.array(ends), PolyCollection(corners).get_paths())


def _draw_bars(ax: Axes, strips: _Strips, item: Quantity, norm: Normalize) -> None:
    """The strips in the colours of a quantity, and an arrow along each pass; a plain strip for what is left out."""
    group, lines, distances = strips.group, strips.lines, strips.distances
    for gone, along in zip(strips.lost, distances[len(group) :], strict=True):
        low, high = 1e3 * float(along.min()), 1e3 * float(along.max())
        ax.barh(lines.index(gone.lost.line), high - low, 0.84, low, color=LEFT_OUT, hatch="////", edgecolor="white", lw=0)
    # Rasterised: thousands of cells as vectors make a slow, heavy file with hairlines between the cells.
    bars = PathCollection(strips.cells, cmap=COLOUR_MAP, norm=norm, rasterized=True, edgecolors="face", linewidths=0.1)
    values = np.concatenate([item.factor * np.asarray(getattr(one, item.key), float) for one in group])
    bars.set_array(np.ma.masked_invalid(values))
    ax.add_collection(bars)
    start, end = strips.ends.T
    everywhere = 1e3 * np.concatenate(distances)
    ax.set_xlim(everywhere.min(), everywhere.max())
    ax.set_ylim(-0.6, len(lines) - 0.4)
    way = 0.94 * (end - start)
    ax.quiver(
        start + 0.03 * (end - start),
        np.array([lines.index(one.line) for one in group]),
        way,
        0 * way,
        angles="xy",
        scale_units="xy",
        scale=1,
        color="white",
        width=0.003,
        headwidth=5,
        headlength=6,
        headaxislength=5,
    )


def contact_section(report: PlanReport) -> Section:
    """Arc over lateral position on the wheel, then turn and both tilts along the passes."""
    caption = "A curve a pass, a dot at its start. Tilt 1 is the slope along the belt, tilt 2 the slope across it."
    return Section("Contact on the wheel", (Plot("contact", caption, 5.6, lambda canvas: _draw(canvas, report)),))


def _draw(canvas: Canvas, report: PlanReport) -> None:
    sides, deg = sides_of(report), 180 / np.pi
    (place, turn), (tilt_along, tilt_across) = panels(canvas, 2, 2, top=0.4, bottom=0.25)
    half = 500 * report.wheel.width
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
