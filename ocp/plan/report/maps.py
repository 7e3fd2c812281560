"""The section "On the unrolled blade": quantities along the passes as colours, a bar a pass, distance along it to the right."""

import numpy as np
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.collections import PolyCollection
from matplotlib.colors import Normalize

from ocp.plan.report.plan_report import PassReport, PlanReport
from ocp.plan.report.quantities import Quantity, colour_range, quantity, sides_of
from ocp.report.parts import Plot
from ocp.report.plotting import Canvas, dressed, panels
from ocp.report.section import Section
from ocp.report.style import COLOUR_MAP, RULE
from robots.pose import Array


def maps_section(report: PlanReport) -> Section:
    """Compliance and force; removal, feed and limits."""
    words = "A row a line of the blade; across: mm from the end where the side's first pass starts; arrow: feed."
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
    sides = list(sides_of(report))
    axes = panels(canvas, len(keys), len(sides), left=0.3, right=0.7, across=0.35, down=0.45, bottom=0.3)
    for row, key in zip(axes, keys, strict=True):
        item = quantity(key)
        norm = Normalize(*colour_range(report, item))
        for ax, side in zip(row, sides, strict=True):
            group = [one for one in report.passes if one.side == side]
            _draw_bars(ax, group, item, norm)
            ax.set_facecolor("#f2f4f6")
            step = max(1, len(group) // 16)
            ax.set_yticks(range(0, len(group), step), [str(one.line) for one in group[::step]])
            dressed(ax, f"{item.label}{f', {item.unit}' if item.unit else ''}: {side}", grid="")
            ax.tick_params(color=RULE)
        bar = row[-1].inset_axes((1.05, 0.0, 0.045, 1.0))
        canvas.figure.colorbar(ScalarMappable(norm, COLOUR_MAP), cax=bar)
        bar.tick_params(length=2, labelsize=6.5)


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


def _draw_bars(ax: Axes, group: list[PassReport], item: Quantity, norm: Normalize) -> None:
    """A strip of cells a pass with the waypoints in their middles, and an arrow along it."""
    cells, values, ends = [], [], []
    for place, (one, along) in enumerate(zip(group, common_distance(group), strict=True)):
        x = 1e3 * along
        edges = np.concatenate([x[:1], (x[1:] + x[:-1]) / 2, x[-1:]]) if len(x) > 1 else x[0] + np.array([-0.5, 0.5])
        left, right, foot, head = edges[:-1], edges[1:], np.full(len(x), place - 0.42), np.full(len(x), place + 0.42)
        cells.append(np.stack([np.c_[left, foot], np.c_[right, foot], np.c_[right, head], np.c_[left, head]], axis=1))
        values.append(item.factor * np.asarray(getattr(one, item.key), float))
        ends.append((edges[0], edges[-1]))
    # Rasterised: thousands of cells as vectors make a slow, heavy file with hairlines between the cells.
    bars = PolyCollection(
        list(np.concatenate(cells)), cmap=COLOUR_MAP, norm=norm, rasterized=True, edgecolors="face", linewidths=0.1
    )
    bars.set_array(np.ma.masked_invalid(np.concatenate(values)))
    ax.add_collection(bars)
    start, end = np.array(ends).T
    ax.set_xlim(min(start.min(), end.min()), max(start.max(), end.max()))
    ax.set_ylim(-0.6, len(group) - 0.4)
    way = 0.94 * (end - start)
    ax.quiver(
        start + 0.03 * (end - start),
        np.arange(len(group)),
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
