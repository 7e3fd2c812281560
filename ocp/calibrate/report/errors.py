"""Pictures of how good the calibration is on readings that were left out: by method, and by what was left out."""

import numpy as np

from ocp.calibrate.report.view import held_out_in_base
from ocp.calibrate.report.words import beyond_chance, fold_name
from ocp.calibrate.tracker import TrackerCalibration
from ocp.report.parts import Plot
from ocp.report.plotting import Canvas, dots, dressed, keys, log_scale, panels
from ocp.report.style import AFTER, BAD, BEFORE, INK, RULE, SIDE_COLOURS, printable, shorten

COLOURS = {"full": AFTER, "geometry": SIDE_COLOURS[1], "relative": SIDE_COLOURS[3], "relative-literal": "#2a8a7a"}
HONEST = (0.8, 1.25)  # error over prediction that is drawn as honest
_METHODS_HEIGHT, _AXES_HEIGHT = 2.9, 3.3


def methods_plot(c: TrackerCalibration) -> Plot:
    """Error per pose of all methods."""
    caption = "Distance between reading and prediction, log scale. Each dot is a reading that the model had not seen."
    return Plot("methods", caption, _METHODS_HEIGHT, lambda canvas: _draw_methods(canvas, c))


def components_plot(c: TrackerCalibration) -> Plot:
    """x, y, z of the error of the chosen method beside what was before."""
    caption = (
        f"The same errors along the axes of the base, before calibration (grey) and after it ('{c.method}', blue). At the right: "
        "mean absolute error."
    )
    return Plot("components", caption, _AXES_HEIGHT, lambda canvas: _draw_components(canvas, c))


def _draw_methods(canvas: Canvas, c: TrackerCalibration) -> None:
    table, rows = c.methods, np.arange(1, len(c.methods.rows) + 1)
    ax = panels(canvas, 1, 1, right=0.5)[0][0]
    dots(ax, rows, 1e3 * table.before, BEFORE)
    for method in [m for m in table.error if m != c.method] + [c.method]:
        dots(ax, rows, 1e3 * table.error[method], COLOURS[method], 3.0 if method == c.method else 2.0)
    log_scale(ax)
    dressed(ax, "absolute error, mm", "reading that was left out, in the order of the file")
    keys(ax, [("before", BEFORE), *((m, COLOURS[m]) for m in table.error)])
    ax.set_xlim(0, len(rows) + 1)


def _draw_components(canvas: Canvas, c: TrackerCalibration) -> None:
    table, rows = c.methods, np.arange(1, len(c.methods.rows) + 1)
    axes = [row[0] for row in panels(canvas, 3, 1, sharex=True, down=0.3, right=0.5)]
    before, after = (1e3 * held_out_in_base(c, off) for off in (table.off_before, table.off[c.method]))
    limit = float(np.abs(np.vstack([before, after])).max()) * 1.05
    for i, ax in enumerate(axes):
        dots(ax, rows, before[:, i], BEFORE)
        dots(ax, rows, after[:, i], AFTER)
        ax.axhline(0, color=RULE, lw=0.8, zorder=0)
        ax.set_ylim(-limit, limit)
        dressed(ax, f"{'xyz'[i]} of the base, measured less predicted, mm")
        for place, values, colour in ((0.66, before[:, i], BEFORE), (0.34, after[:, i], AFTER)):
            words = f"{np.abs(values).mean():.3f}"
            ax.text(1.012, place, words, transform=ax.transAxes, fontsize=7, color=colour, va="center")
    dressed(axes[-1], x="reading that was left out, in the order of the file")
    axes[-1].set_xlim(0, len(rows) + 1)


def folds_plot(c: TrackerCalibration) -> Plot:
    """Every fold: mean and largest error, and error over prediction."""
    caption = (
        "Each row was left out, the model fitted to the rest, and the row predicted. Left: mean (dot) and largest error (end "
        "of the "
        "line). Right: error over what the model itself predicts; 1 is honest, beyond the band the model is surer than it may be "
        "(right) or more careful than it need be (left)."
    )
    held = c.held_out
    kinds = len({h.fold.kind for h in held})
    height = 0.62 + 0.145 * len(held) + 0.08 * kinds
    return Plot("folds", caption, height, lambda canvas: _draw_folds(canvas, c))


def _draw_folds(canvas: Canvas, c: TrackerCalibration) -> None:
    error, ratio = panels(canvas, 1, 2, left=2.1, across=0.25, sharey=True, widths=(3, 2))[0]
    y, places, labels, kind = 0.0, [], [], ""
    for h in c.held_out:
        y += 1.0 if h.fold.kind == kind else 1.5
        kind = h.fold.kind
        figures = h.figures()
        error.plot([1e3 * figures["mean"], 1e3 * figures["max"]], [y, y], color=BEFORE, lw=1.0)
        dots(error, np.array([1e3 * figures["mean"]]), np.array([y]), AFTER, 4.0)
        over = figures["over_predicted"]
        dots(ratio, np.array([over]), np.array([y]), BAD if beyond_chance(h) and over > HONEST[1] else AFTER, 4.0)
        places.append(y)
        labels.append(f"{shorten(printable(fold_name(c, h)), 34)} ({len(h.rows)})")
    ratio.axvspan(*HONEST, color="#e6edf3", lw=0, zorder=0)
    ratio.axvline(1.0, color=INK, lw=0.6)
    error.set_yticks(places, labels)
    error.set_ylim(y + 0.8, 0.7)
    error.set_xlim(left=0)
    low, high = ratio.get_xlim()
    ratio.set_xlim(min(low, 0.6), max(high, 1.4))
    dressed(error, "error, mm (readings)", grid="x")
    dressed(ratio, "error over prediction", grid="x")
