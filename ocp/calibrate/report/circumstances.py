"""Pictures of what is left against time and temperature, by payload, nest, session and tracker station."""

from dataclasses import dataclass
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from numpy.typing import NDArray

from ocp.calibrate.report.view import ReadingsView, present
from ocp.report.parts import Plot
from ocp.report.plotting import Canvas, dots, dressed, keys, panels, reach, running_median
from ocp.report.style import AFTER, BAD, RULE, SIDE_COLOURS, printable, shorten
from robots.pose import Array
from robots.tracker_readings import Index

AXIS_COLOURS = (SIDE_COLOURS[0], SIDE_COLOURS[1], "#2a8a7a")  # x, y, z
MOST_NAMES = 8  # that stand side by side


@dataclass(frozen=True)
class Circumstance:
    """What may have changed between readings: label, and values (n,) or, where it has names, indices (n,) into them."""

    label: str
    values: NDArray[Any]
    names: tuple[str, ...] = ()


def circumstances_plot(view: ReadingsView) -> Plot:
    """Residuals against time and temperature, by payload, nest, session and station, as far as the file has them."""
    drawn = circumstances(view)
    height = 0.25 + 1.85 * ((len(drawn) + 1) // 2)
    caption = (
        "Left over against what else was different. Where that is a number: x, y, z of the base with running medians. "
        "Where it is a name: distances with their median (bar)."
    )
    return Plot("circumstances", caption, height, lambda canvas: _draw_circumstances(canvas, view, drawn))


def circumstances(view: ReadingsView) -> list[Circumstance]:
    """What the readings have; but for the payload, what never changes is left out."""
    r = view.readings
    found = []
    for label, values in (("time, min", None if r.time is None else r.time / 60), ("temperature, °C", r.temperature)):
        if values is not None and np.ptp(values) > 0:
            found.append(Circumstance(label, values))
    for label, index, names in (
        ("payload", r.payload, r.payloads), ("reflector nest", r.target, r.targets),
        ("session", r.session, r.sessions), ("tracker station", r.station, r.stations),
    ):  # fmt: skip
        if label == "payload" or len(present(index)) > 1:
            found.append(Circumstance(label, index, names))
    return found


def _draw_circumstances(canvas: Canvas, view: ReadingsView, drawn: list[Circumstance]) -> None:
    axes = [ax for row in panels(canvas, (len(drawn) + 1) // 2, 2, top=0.32) for ax in row]
    kept = ~view.outlier
    error, residual = 1e3 * view.error[kept], 1e3 * view.residual[kept]
    limit = reach(residual)
    for ax, one in zip(axes, drawn, strict=False):
        if one.names:
            _strips(ax, error, one.values[kept], one)
            dressed(ax, f"mm, by {one.label}")
            continue
        for i, colour in enumerate(AXIS_COLOURS):
            dots(ax, one.values[kept], residual[:, i], colour, 1.6)
            ax.plot(*running_median(one.values[kept], residual[:, i]), color=colour, lw=1.1)
        ax.axhline(0, color=RULE, lw=0.8, zorder=0)
        ax.set_ylim(-limit, limit)
        dressed(ax, "mm", one.label)
        keys(ax, list(zip("xyz", AXIS_COLOURS, strict=True)))
    for ax in axes[len(drawn) :]:
        ax.set_axis_off()


def _strips(ax: Axes, error: Array, index: Index, one: Circumstance) -> None:
    """Distances by name, spread sideways so that they can be told apart, the median as a bar."""
    used = present(one.values)
    most = max(3, 40 // min(len(used), MOST_NAMES))
    labels = []
    for place, k in enumerate(used):
        rows = np.flatnonzero(index == k)
        # The golden ratio's multiples fill the width evenly, the same every time.
        sideways = 0.5 * ((np.arange(len(rows)) * 0.6180339887) % 1 - 0.5)
        dots(ax, place + sideways, error[rows], AFTER, 1.8)
        if len(rows):
            ax.plot([place - 0.33, place + 0.33], [np.median(error[rows])] * 2, color=BAD, lw=1.4)
        # Dozens of names would run into each other: every so many are written.
        written = place % ((len(used) - 1) // MOST_NAMES + 1) == 0
        labels.append(f"{shorten(printable(one.names[k] or 'no name'), most)} ({len(rows)})" if written else "")
    ax.set_xticks(range(len(used)), labels)
    ax.set_xlim(-0.6, len(used) - 0.4)
    ax.set_ylim(bottom=0)
