"""What measurements leave, drawn where the arm was: vectors in the workspace, and values along each joint's motion."""

from collections.abc import Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from numpy.typing import NDArray

from ocp.report.plotting import MANY, Canvas, dots, dressed, keys, panels, reach, running_median
from ocp.report.style import AFTER, BAD, BEFORE, INK, RULE, SIDE_COLOURS, SOFT
from robots.pose import Array

_LONG_ARROW = 0.11  # of the workspace's width, for an arrow of the 95th percentile
_CROSS: dict[str, Any] = {"marker": "x", "markeredgewidth": 1}


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


def draw_vectors(
    axes: Sequence[Axes], title: str, points: Array, vectors: Array, factor: float, colour: str, outlier: NDArray[np.bool_]
) -> None:
    """Vectors (n, 3) m at points (n, 3) m of the base frame, from above and from the side, `factor` times as long, with an arrow
    of known length in the corner; an outlier is a cross without an arrow."""
    kept = ~outlier
    head = {"width": 0.0028, "headwidth": 3.5, "headlength": 4, "headaxislength": 3.6, "rasterized": kept.sum() > MANY}
    for ax, (name, i, j) in zip(axes, (("from above", 1, 0), ("from the side", 0, 2)), strict=True):
        at, arrow = 1e3 * points[kept], 1e3 * factor * vectors[kept]
        ax.quiver(at[:, i], at[:, j], arrow[:, i], arrow[:, j], angles="xy", scale_units="xy", scale=1, color=colour, **head)
        dots(ax, 1e3 * points[outlier, i], 1e3 * points[outlier, j], BAD, 4, **_CROSS)
        dots(ax, np.array([0.0]), np.array([0.0]), INK, 4, marker="s")
        ax.annotate("base", (0, 0), (4, 3), textcoords="offset points", fontsize=6, color=SOFT)
        ax.set_aspect("equal", adjustable="datalim")
        dressed(ax, f"{title}, {name}, {factor:.0f} times", f"{'xyz'[i]}, mm", f"{'xyz'[j]}, mm", grid="both")
        if i == 1:
            ax.invert_xaxis()  # y grows to the left where x goes up
        _scale_arrow(ax, factor, vectors[kept])


def _scale_arrow(ax: Axes, factor: float, vectors: Array) -> None:
    size = round_number(max(1e3 * float(np.percentile(np.linalg.norm(vectors, axis=1), 95)), 1e-3)) if len(vectors) else 1.0
    low, high = ax.get_xlim()
    share = factor * size / abs(high - low)
    ax.plot([0.98 - share, 0.98], [0.03, 0.03], transform=ax.transAxes, color=INK, lw=1.2, solid_capstyle="butt")
    ax.text(0.98, 0.05, f"{size:g} mm", transform=ax.transAxes, fontsize=6.5, ha="right", va="bottom", color=INK)


def draw_by_joint(
    canvas: Canvas,
    q: Array,
    along: Array,
    approach: Array | None,
    unit: str,
    outlier: NDArray[np.bool_] | None = None,
    framed: int = 0,
) -> None:
    """Values (n, 6) along the way on which each joint carries what is measured (nan: not measured) over its angle q (n, 6) rad,
    with running medians, coloured by the sign of the joint's last motion `approach` (n, 6) where that is known."""
    axes = [ax for row in panels(canvas, 2, 3, top=0.36, sharey=True, across=0.2, down=0.55) for ax in row]
    odd = np.zeros(len(q), bool) if outlier is None else outlier
    limit = reach(along[~odd])
    for j, ax in enumerate(axes):
        x, y = np.degrees(q[:, j]), np.clip(along[:, j], -limit, limit)
        known = np.isfinite(y) & ~odd
        for rows, colour in _by_side(known, None if approach is None else approach[:, j]):
            if rows.any():
                dots(ax, x[rows], y[rows], colour, 2.0)
                ax.plot(*running_median(x[rows], y[rows]), color=colour, lw=1.2)
        dots(ax, x[odd], y[odd], BAD, 4, **_CROSS)
        ax.axhline(0, color=RULE, lw=0.8, zorder=0)
        ax.set_ylim(-1.05 * limit, 1.05 * limit)
        title = f"A{j + 1}" if known.any() else f"A{j + 1}: not measured"
        dressed(ax, title, "deg" if j > 2 else "", unit if j % 3 == 0 else "")
        if j + 1 == framed:
            for side in ("left", "bottom", "top", "right"):
                ax.spines[side].set(visible=True, color=INK, linewidth=1.2)
    entries = [] if approach is None else [("moved there in +", AFTER), ("in −", SIDE_COLOURS[1])]
    entries += [("outlier, at the edge where it is beyond", BAD)] if odd.any() else []
    if entries:
        keys(axes[2], entries, top=1.1)


def _by_side(known: NDArray[np.bool_], sign: Array | None) -> list[tuple[NDArray[np.bool_], str]]:
    """Rows by the sign of the joint's last motion, with their colours."""
    if sign is None:
        return [(known, AFTER)]
    return [((sign > 0) & known, AFTER), ((sign < 0) & known, SIDE_COLOURS[1]), ((sign == 0) & known, BEFORE)]
