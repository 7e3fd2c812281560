"""Quantities on the unrolled blade, on paper: one bar a pass, distance along it to the right."""

import numpy as np
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.colors import Normalize

from ocp.plan.report.data import PassReport, PlanReport
from ocp.plan.report.quantities import colour_range, quantity, sides_of
from ocp.report.style import COLOUR_MAP, INK, RULE, Sheet, grid_of_axes, new_sheet, printable
from robots.pose import Array


def map_sheet(report: PlanReport, heading: str, keys: tuple[str, ...]) -> Sheet:
    """A sheet with a row a quantity (of `QUANTITIES`) and a column a side of the blade."""
    sides = list(sides_of(report))
    sheet = new_sheet(
        heading,
        "A row a line of the blade; across: mm from the end where the side's first pass starts; arrow: feed.",
    )
    spacing = {"hspace": 0.34, "wspace": 0.16, "right": 0.86}
    axes = grid_of_axes(sheet, len(keys), len(sides), spacing=spacing)
    for row, key in zip(axes, keys, strict=True):
        item = quantity(key)
        norm = Normalize(*colour_range(report, item))
        for ax, side in zip(row, sides, strict=True):
            group = [one for one in report.passes if one.side == side]
            for place, (one, along) in enumerate(zip(group, common_distance(group), strict=True)):
                sampled = item.factor * np.asarray(getattr(one, key), float)
                _bar(ax, 1e3 * along, sampled, place, norm)
            _dress(ax, group)
            unit = f", {item.unit}" if item.unit else ""
            ax.set_title(printable(f"{item.label}{unit}: {side}"), fontsize=7.5, color=INK, loc="left", pad=3)
        beside = row[-1].get_position()
        bar = sheet.figure.add_axes((0.88, beside.y0, 0.016, beside.height))
        sheet.figure.colorbar(ScalarMappable(norm, COLOUR_MAP), cax=bar)
        bar.tick_params(length=2, labelsize=6.5)
    return sheet


def common_distance(group: list[PassReport]) -> list[Array]:
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


def _bar(ax: Axes, along: Array, sampled: Array, place: int, norm: Normalize) -> None:
    """One pass as a strip of cells with the waypoints in their middles."""
    if len(along) == 1:
        edges = along[0] + np.array([-0.5, 0.5])
    else:
        middles = (along[1:] + along[:-1]) / 2
        edges = np.concatenate([[along[0]], middles, [along[-1]]])
    values = np.ma.masked_invalid(sampled)[None, :]
    # Rasterised: thousands of cells as vectors make a slow, heavy file with hairlines between the cells.
    ax.pcolormesh(edges, [place - 0.42, place + 0.42], values, cmap=COLOUR_MAP, norm=norm, rasterized=True)
    ax.annotate(
        "", (along[-1], place), (along[0], place),
        arrowprops={"arrowstyle": "->", "color": "white", "lw": 0.5, "shrinkA": 4, "shrinkB": 4},
    )  # fmt: skip


def _dress(ax: Axes, group: list[PassReport]) -> None:
    ax.set_facecolor("#f2f4f6")
    ax.set_ylim(-0.6, len(group) - 0.4)
    step = max(1, len(group) // 16)
    ax.set_yticks(range(0, len(group), step), [str(item.line) for item in group[::step]])
    ax.tick_params(length=2, labelsize=6.5, color=RULE)
