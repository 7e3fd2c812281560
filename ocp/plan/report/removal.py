"""The section "Material taken off": depth over what is wanted on the unrolled flanks, all lines summed, and its shares."""

import numpy as np
from matplotlib.cm import ScalarMappable
from matplotlib.colors import Normalize

from ocp.plan.removal.result import Removal, SideRemoval
from ocp.plan.report.plan_report import PlanReport
from ocp.report.parts import Facts, Plot
from ocp.report.plotting import Canvas, Draw, dressed, panels
from ocp.report.section import Part, Section
from ocp.report.style import COLOUR_MAP, INK, NOT_GROUND

SPAN = 0.5  # colours reach from 1 - SPAN to 1 + SPAN of what is wanted, so that maps of two plans can be compared


def removal_section(report: PlanReport) -> Section:
    """The map, a picture a side, and the shares of plan.json."""
    removal = report.removal
    if removal is None:
        return Section("Material taken off", ("It was not worked out.",))
    parts: list[Part | str] = [
        "Preston's law on the pressure of the contact, every row of contact of every pass summed. Colour: depth over what is "
        "wanted; thin line: what is asked, between the margins; grey: less than a hundredth. Both axes in mm on the surface.",
        Facts(tuple(_facts(removal))),
    ]
    for one in removal.sides:
        height = 0.55 + 6.0 * min(float(np.ptp(one.cells.across) / np.ptp(one.cells.along)), 0.8)
        parts.append(Plot(f"removal-{one.cells.side}", f"The {one.cells.side} side.", height, _drawing(one)))
    return Section("Material taken off", tuple(parts))


def _facts(removal: Removal) -> list[tuple[str, str]]:
    figures = removal.figures

    def share(value: float | None) -> str:
        return "no such surface" if value is None else f"{100 * value:.1f} %"

    return [
        ("Asked surface with at least half of the wanted depth", share(figures.ground_share)),
        ("Core within 5 %, within 10 % of wanted", f"{share(figures.core_within_5)}, {share(figures.core_within_10)}"),
        ("All of the asked surface within 10 %", share(figures.all_within_10)),
        *([("Least and most depth over wanted", f"{figures.least:.2f}, {figures.most:.2f}")] if figures.most is not None else []),
        *([("Most beside the asked surface", f"{figures.most_beside:.2f}")] if figures.most_beside is not None else []),
    ]


def _drawing(one: SideRemoval) -> Draw:
    def draw(canvas: Canvas) -> None:
        ((ax,),) = panels(canvas, 1, 1, left=0.35, right=0.7, top=0.25, bottom=0.3)
        cells, norm = one.cells, Normalize(1 - SPAN, 1 + SPAN)
        depth = np.ma.masked_where(~(one.relative > 0.01), one.relative)
        x, y = 1e3 * cells.along, 1e3 * cells.across
        ax.set_facecolor(NOT_GROUND)
        ax.pcolormesh(x, y, depth, cmap=COLOUR_MAP, norm=norm, shading="nearest", rasterized=True)
        ax.contour(x, y, cells.asked.astype(float), levels=[0.5], colors=[INK], linewidths=0.6)
        ax.set_aspect("equal")
        dressed(ax, "mm from the leading edge over mm along the span", grid="")
        bar = ax.inset_axes((1.03, 0.0, 0.025, 1.0))
        canvas.figure.colorbar(ScalarMappable(norm, COLOUR_MAP), cax=bar, extend="both")
        bar.tick_params(pad=3.5)

    return draw
