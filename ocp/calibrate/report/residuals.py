"""The section "What is left over": residuals in the workspace, along the joints, by circumstance, beside their expected size."""

from dataclasses import dataclass
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from numpy.typing import NDArray
from scipy.stats import chi, norm

from ocp.calibrate.report.view import ReadingsView, mm, named, present
from ocp.calibrate.tracker import TrackerCalibration
from ocp.report.parts import Plot, Table, table
from ocp.report.plotting import Canvas, dots, dressed, keys, panels, reach, running_median
from ocp.report.section import Section
from ocp.report.style import AFTER, BAD, BEFORE, INK, RULE, SHADE, SIDE_COLOURS, printable, shorten
from ocp.report.workspace import draw_by_joint, draw_vectors, exaggeration
from robots.pose import Array
from robots.tracker_readings import Index

AXIS_COLOURS = (SIDE_COLOURS[0], SIDE_COLOURS[1], "#2a8a7a")  # x, y, z
MOST_NAMES = 8  # that stand side by side
_EDGE = 5.0  # sigmas shown of the histogram
WORST = 8  # readings listed


def residuals_section(c: TrackerCalibration, view: ReadingsView) -> Section:
    """Pictures of the residuals, and the readings that fit worst."""
    freedom = max(1.0 - c.fit.layout.size / (3.0 * len(view.point)), 0.1)
    words = (
        "What the fitted arm leaves of the readings it was fitted to. A model that has everything leaves noise without a pattern."
    )
    plots = (map_plot(view), joints_plot(view), circumstances_plot(view), whitened_plot(view, freedom))
    return Section("What is left over", (words, *plots, worst_readings_table(view)))


def map_plot(view: ReadingsView) -> Plot:
    """Residual vectors from above and from the side, believed arm and fitted arm."""
    caption = (
        "Residual vectors (measured less predicted) at the reflector, base frame, drawn longer by the factor given. Neighbours "
        "that point the same way are a pattern that the model does not have; arrows without order are noise. Red crosses: "
        "outliers, without arrow."
    )
    return Plot("map", caption, 4.9, lambda canvas: _draw_maps(canvas, view))


def _draw_maps(canvas: Canvas, view: ReadingsView) -> None:
    drawn = (("believed arm", view.before, BEFORE), ("fitted arm", view.residual, AFTER))
    for axes, (when, vectors, colour) in zip(panels(canvas, 2, 2, across=0.55, down=0.6), drawn, strict=True):
        factor = exaggeration(view.point, vectors[~view.outlier])
        draw_vectors(axes, when, view.point, vectors, factor, colour, view.outlier)


def joints_plot(view: ReadingsView) -> Plot:
    """Residual along each joint's motion against the joint's angle."""
    r = view.readings
    caption = (
        "Residual along the way on which the joint carries the reflector, against the joint's angle. Line: running median. A "
        "wave is a gear or an encoder, a slope a spring or an offset. "
        + ("No approach columns: backlash cannot be seen." if r.approach is None else "Two levels by colour are backlash.")
    )
    along = 1e3 * view.along
    return Plot("joints", caption, 3.5, lambda canvas: draw_by_joint(canvas, r.q, along, r.approach, "mm", view.outlier))


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
        ("payload", r.payload, r.payloads),
        ("reflector nest", r.target, r.targets),
        ("session", r.session, r.sessions),
        ("tracker station", r.station, r.stations),
    ):
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


def whitened_plot(view: ReadingsView, freedom: float) -> Plot:
    """Histogram of whitened residuals, and their distances against those expected."""
    caption = (
        "Residuals in units of their predicted sigma. Left: x, y, z together beside the bell that the noise model predicts. "
        "Right: distances in order against those expected; on the line the model is right, steeper at the end are outliers "
        "(with their line in the file)."
    )
    return Plot("whitened", caption, 2.5, lambda canvas: _draw_whitened(canvas, view, freedom))


def _draw_whitened(canvas: Canvas, view: ReadingsView, freedom: float) -> None:
    left, right = panels(canvas, 1, 2, right=0.3)[0]
    values = view.whitened[~view.outlier].ravel()
    edges = np.linspace(-_EDGE, _EDGE, 41 if len(values) > 200 else 21)
    left.hist(np.clip(values, -_EDGE, _EDGE), edges.tolist(), color=SHADE, edgecolor=AFTER, linewidth=0.6)
    x = np.linspace(-_EDGE, _EDGE, 201)
    expected = len(values) * (edges[1] - edges[0]) * norm.pdf(x, scale=np.sqrt(freedom))
    left.plot(x, expected, color=INK, lw=1.0)
    wild = np.clip(view.whitened[view.outlier].ravel(), -_EDGE, _EDGE)
    dots(left, wild, np.full(len(wild), -0.03 * left.get_ylim()[1]), BAD, 4, marker="|", markeredgewidth=1.2, clip_on=False)
    dressed(left, "count", "residual over its predicted sigma")
    keys(left, [("found", AFTER), ("expected", INK), *([("outliers", BAD)] if len(wild) else [])])
    _draw_ordered(right, view, freedom)


def _draw_ordered(ax: Axes, view: ReadingsView, freedom: float) -> None:
    distance = np.linalg.norm(view.whitened, axis=1)
    order = np.argsort(distance, kind="stable")
    n = len(order)
    expected = chi(3).ppf((np.arange(n) + 0.5) / n) * np.sqrt(freedom)
    found, out = distance[order], view.outlier[order]
    top = max(1.15 * expected[-1], 1.1 * float(found[~out].max(initial=1.0)))
    ax.plot([0, expected[-1]], [0, expected[-1]], color=INK, lw=0.8)
    dots(ax, expected, np.minimum(found, top), AFTER, 2.2)
    dots(ax, expected[out], np.minimum(found[out], top), BAD, 4, marker="x", markeredgewidth=1, clip_on=False)
    marked = np.flatnonzero(out)[-4:][::-1]
    words = [f"line {view.readings.line[order[k]]}: {found[k]:.0f} sigma" for k in marked]
    more = int(out.sum()) - len(marked)
    words += [f"and {more} more"] if more else []
    ax.text(0.03, 0.97, "\n".join(words), transform=ax.transAxes, va="top", fontsize=6.5, color=BAD)
    ax.set_ylim(0, top)
    ax.set_xlim(left=0)
    dressed(ax, "distance found, in sigmas", "distance expected, in sigmas", grid="both")


def worst_readings_table(view: ReadingsView) -> Table:
    """The readings that fit worst, outliers strong."""
    distance = np.linalg.norm(view.whitened, axis=1)
    order = np.argsort(-distance, kind="stable")[: max(WORST, int(view.outlier.sum()))][:40]
    r = view.readings
    rows = [
        (
            str(r.line[k]),
            named(r.targets[r.target[k]], "nest"),
            named(r.payloads[r.payload[k]], "payload"),
            ", ".join(f"{v:.1f}" for v in np.degrees(r.q[k])),
            mm(view.error[k]),
            f"{distance[k]:.1f}",
            "outlier" if view.outlier[k] else f"counts {view.weight[k]:.2f}",
        )
        for k in order
    ]
    strong = [place for place, k in enumerate(order) if view.outlier[k]]
    columns = ("line", "nest", "payload", "axes, deg", "error, mm", "sigmas", "in the fit")
    return table(columns, rows, text=(1, 2, 3, 6), strong=strong, title="The readings that fit worst")
