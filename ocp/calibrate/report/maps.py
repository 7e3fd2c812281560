"""Pictures of what is left: residual vectors over the workspace, residuals along each joint's motion."""

import numpy as np
from matplotlib.axes import Axes

from ocp.calibrate.report.view import Mask, ReadingsView
from ocp.report.parts import Plot
from ocp.report.plotting import Canvas, dots, dressed, keys, panels, reach, running_median
from ocp.report.style import AFTER, BAD, BEFORE, INK, RULE, SIDE_COLOURS, SOFT
from robots.pose import Array

_MAP_HEIGHT, _JOINT_HEIGHT = 4.9, 3.5
_LONG_ARROW = 0.11  # of the workspace's width, for an arrow of the 95th percentile


def map_plot(view: ReadingsView) -> Plot:
    """Residual vectors from above and from the side, believed arm and fitted arm."""
    caption = (
        "Residual vectors (measured less predicted) at the reflector, base frame, drawn longer by the factor given. "
        "Neighbours that point "
        "the same way are a pattern that the model does not have; arrows without order are noise. Red crosses: outliers, "
        "without arrow."
    )
    return Plot("map", caption, _MAP_HEIGHT, lambda canvas: _draw_maps(canvas, view))


def _draw_maps(canvas: Canvas, view: ReadingsView) -> None:
    axes = panels(canvas, 2, 2, across=0.55, down=0.6)
    for row, (when, vectors) in zip(axes, (("believed arm", view.before), ("fitted arm", view.residual)), strict=True):
        factor = exaggeration(view.point, vectors[~view.outlier])
        for ax, (name, i, j) in zip(row, (("from above", 1, 0), ("from the side", 0, 2)), strict=True):
            kept = ~view.outlier
            ax.quiver(
                *(1e3 * view.point[kept][:, k] for k in (i, j)), *(1e3 * factor * vectors[kept][:, k] for k in (i, j)),
                angles="xy", scale_units="xy", scale=1, width=0.0028, headwidth=3.5, headlength=4, headaxislength=3.6,
                color=AFTER if when == "fitted arm" else BEFORE, rasterized=kept.sum() > 1500,
            )  # fmt: skip
            dots(ax, 1e3 * view.point[view.outlier, i], 1e3 * view.point[view.outlier, j], BAD, 4, marker="x", markeredgewidth=1)
            dots(ax, np.array([0.0]), np.array([0.0]), INK, 4, marker="s")
            ax.annotate("base", (0, 0), (4, 3), textcoords="offset points", fontsize=6, color=SOFT)
            ax.set_aspect("equal", adjustable="datalim")
            dressed(ax, f"{when}, {name}, {factor:.0f} times", f"{'xyz'[i]}, mm", f"{'xyz'[j]}, mm", grid="both")
            if i == 1:
                ax.invert_xaxis()  # y grows to the left where x goes up
            _scale_arrow(ax, factor, vectors[kept])


def exaggeration(points: Array, vectors: Array) -> float:
    """1, 2 or 5 times a power of ten that makes the 95th percentile of the vectors a readable arrow among the points."""
    size = float(np.percentile(np.linalg.norm(vectors, axis=1), 95)) if len(vectors) else 0.0
    extent = float(np.ptp(points, axis=0).max())
    if size <= 0.0 or extent <= 0.0:
        return 1.0
    return max(round_number(_LONG_ARROW * extent / size), 1.0)


def round_number(value: float) -> float:
    """1, 2 or 5 times a power of ten, the largest that is not above `value` > 0."""
    power = 10.0 ** np.floor(np.log10(value))
    return float(power * max(m for m in (1.0, 2.0, 5.0) if m * power <= value * (1 + 1e-9)))


def _scale_arrow(ax: Axes, factor: float, vectors: Array) -> None:
    """An arrow of known length in the corner."""
    size = round_number(max(1e3 * float(np.percentile(np.linalg.norm(vectors, axis=1), 95)), 1e-3)) if len(vectors) else 1.0
    low, high = ax.get_xlim()
    share = factor * size / abs(high - low)
    ax.plot([0.98 - share, 0.98], [0.03, 0.03], transform=ax.transAxes, color=INK, lw=1.2, solid_capstyle="butt")
    ax.text(0.98, 0.05, f"{size:g} mm", transform=ax.transAxes, fontsize=6.5, ha="right", va="bottom", color=INK)


def joints_plot(view: ReadingsView) -> Plot:
    """Residual along each joint's motion against the joint's angle."""
    signed = view.readings.approach is not None
    caption = (
        "Residual along the way on which the joint carries the reflector, against the joint's angle. Line: running median. A "
        "wave is "
        "a gear or an encoder, a slope a spring or an offset. "
        + ("Two levels by colour are backlash." if signed else "No approach columns: backlash cannot be seen.")
    )
    return Plot("joints", caption, _JOINT_HEIGHT, lambda canvas: _draw_joints(canvas, view))


def _draw_joints(canvas: Canvas, view: ReadingsView) -> None:
    axes = [ax for row in panels(canvas, 2, 3, top=0.36, sharey=True, across=0.2, down=0.55) for ax in row]
    limit = reach(1e3 * view.along[~view.outlier])
    approach, kept = view.readings.approach, ~view.outlier
    for j, ax in enumerate(axes):
        q, along = np.degrees(view.readings.q[:, j]), np.clip(1e3 * view.along[:, j], -limit, limit)
        for rows, colour in [(kept, AFTER)] if approach is None else _by_side(approach[:, j], kept):
            dots(ax, q[rows], along[rows], colour, 2.0)
            ax.plot(*running_median(q[rows], along[rows], bins=10), color=colour, lw=1.1)
        dots(ax, q[view.outlier], along[view.outlier], BAD, 4, marker="x", markeredgewidth=1)
        ax.axhline(0, color=RULE, lw=0.8, zorder=0)
        ax.set_ylim(-1.05 * limit, 1.05 * limit)
        dressed(ax, f"A{j + 1}", "deg" if j > 2 else "", "mm" if j % 3 == 0 else "")
    entries = [("moved there in +", AFTER), ("in −", SIDE_COLOURS[1])] if approach is not None else []
    if view.outlier.any():
        entries.append(("outlier, at the edge where it is beyond", BAD))
    if entries:
        keys(axes[2], entries, top=1.1)


def _by_side(sign: Array, kept: Mask) -> list[tuple[Mask, str]]:
    """Readings by the sign of the axis' last motion, with their colours."""
    return [((sign > 0) & kept, AFTER), ((sign < 0) & kept, SIDE_COLOURS[1]), ((sign == 0) & kept, BEFORE)]
