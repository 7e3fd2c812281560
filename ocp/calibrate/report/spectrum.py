"""Pictures of what the readings could tell: whitened residuals beside their expected spread, correlations, singular values."""

import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import LinearSegmentedColormap
from scipy.stats import chi, norm

from ocp.calibrate.report.view import ReadingsView
from ocp.calibrate.tracker import TrackerCalibration
from ocp.report.parts import Plot
from ocp.report.plotting import Canvas, dots, dressed, keys, log_scale, panels
from ocp.report.style import AFTER, BAD, BEFORE, INK, SHADE, SOFT
from robots.calibration.fit import Fit
from robots.calibration.identifiability import SEPARATED
from robots.calibration.parameters import SYMBOLS
from robots.pose import Array

_WHITE_HEIGHT, _SEEN_HEIGHT = 2.5, 3.9
_EDGE = 5.0  # sigmas shown of the histogram
CORRELATION = LinearSegmentedColormap.from_list("correlation", ["#8a3d0a", "#e9b98f", "#ffffff", "#9dc0d9", "#123e5c"])


def whitened_plot(view: ReadingsView, freedom: float) -> Plot:
    """Histogram of whitened residuals, and their distances against those expected."""
    caption = (
        "Residuals in units of their predicted sigma. Left: x, y, z together beside the bell that the noise model predicts. "
        "Right: "
        "distances in order against those expected; on the line the model is right, steeper at the end are outliers (with "
        "their line "
        "in the file)."
    )
    return Plot("whitened", caption, _WHITE_HEIGHT, lambda canvas: _draw_whitened(canvas, view, freedom))


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
    ax.text(
        0.03, 0.97, "\n".join(words + ([f"and {more} more"] if more else [])), transform=ax.transAxes, va="top", fontsize=6.5,
        color=BAD,
    )  # fmt: skip
    ax.set_ylim(0, top)
    ax.set_xlim(left=0)
    dressed(ax, "distance found, in sigmas", "distance expected, in sigmas", grid="both")


def seen_plot(c: TrackerCalibration) -> Plot:
    """Singular values with the rank, and correlations of the robot's parameters."""
    caption = (
        "Left: how strongly the readings see each independent direction of the robot's parameters, over noise and prior; "
        "below the line "
        "they see nothing. Right: correlations of the estimates; dark off the diagonal is a pair that goes together."
    )
    return Plot("seen", caption, _SEEN_HEIGHT, lambda canvas: _draw_seen(canvas, c))


def _draw_seen(canvas: Canvas, c: TrackerCalibration) -> None:
    left, right = panels(canvas, 1, 2, widths=(1, 1.35), across=0.55, right=0.55)[0]
    found = c.identifiability
    values = np.maximum(found.singular_values, 1e-3)
    place = np.arange(1, len(values) + 1)
    seen = place <= found.rank
    dots(left, place[seen], values[seen], AFTER, 4)
    dots(left, place[~seen], values[~seen], BEFORE, 4)
    left.axhline(1.0 / SEPARATED, color=BAD, lw=0.8)
    left.text(len(values) + 0.5, 1.25 / SEPARATED, f"rank {found.rank} of {found.parameters}", fontsize=7, ha="right", color=BAD)
    log_scale(left)
    dressed(left, "singular value", "direction")
    names, C = correlations(c.fit)
    size = min(6.0, 170.0 / max(len(names), 1))
    image = right.imshow(C, cmap=CORRELATION, vmin=-1, vmax=1, interpolation="none", aspect="auto")
    dressed(right, "correlation", grid="")
    right.set_xticks(range(len(names)), names, rotation=90, fontsize=size)
    right.set_yticks(range(len(names)), names, fontsize=size)
    right.tick_params(length=0, labelsize=size, pad=1)
    bar = right.inset_axes((1.03, 0.0, 0.03, 1.0))
    canvas.figure.colorbar(image, cax=bar, ticks=(-1, -0.5, 0, 0.5, 1))
    bar.tick_params(length=2, labelsize=6, colors=SOFT)
    bar.spines["outline"].set_linewidth(0.4)


def correlations(fit: Fit) -> tuple[list[str], Array]:
    """Names and correlations (m, m) of the robot's parameters that were fitted."""
    pick = [i for i, name in enumerate(fit.layout.names) if name in SYMBOLS]
    sd = np.maximum(fit.sd[pick], 1e-30)
    return [fit.layout.names[i] for i in pick], fit.covariance[np.ix_(pick, pick)] / np.outer(sd, sd)
