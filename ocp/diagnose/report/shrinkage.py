"""The section "How far the gap shrinks": sizes before and after, and what is to be expected on new data."""

import numpy as np

from ocp.diagnose.report.words import SHORT, figure
from ocp.diagnose.verdict.answer import Answer, SignalGap, figures
from ocp.diagnose.verdict.shrinkage import NONE
from ocp.report.parts import Plot, Table, table
from ocp.report.plotting import Canvas, dots, dressed, panels
from ocp.report.section import Part, Section
from ocp.report.style import AFTER, BEFORE, INK, RULE, SOFT, shorten


def shrinkage_section(answer: Answer) -> Section:
    """Table of the gaps, and a plot for every signal whose gap shrinks."""
    parts: list[Part | str] = [
        "Sizes of the readings' errors, outliers apart; 'before' is the believed cell with its parameters refitted, as a good "
        "calibration leaves it.",
        gaps_table(answer),
    ]
    if answer.diagnosis.active:
        parts += [shrinkage_plot(gap) for gap in answer.gaps if gap.shrinkage not in (None, NONE)]
    return Section("How far the gap shrinks", tuple(parts))


def gaps_table(answer: Answer) -> Table:
    """Gap of every signal before and after."""
    rows = []
    for gap in answer.gaps:
        before, after = figures(gap.before), figures(gap.after)
        s = gap.shrinkage
        told = "too small beside noise" if s is None else f"{100 * s.predicted:.0f} % ({100 * s.low:.0f} to {100 * s.high:.0f})"
        cells = (SHORT[gap.name], gap.unit, figure(gap.noise_floor))
        rows.append((*cells, *(figure(v[k]) for k in ("rms", "mean", "max") for v in (before, after)), told))
    sizes = [word for what in ("rms", "mean", "max") for word in (f"{what} before", "after")]
    columns = ("signal", "unit", "noise", *sizes, "shrinkage expected")
    return table(columns, rows, text=(0, 1, 9))


def shrinkage_plot(gap: SignalGap) -> Plot:
    """Predicted shrinkage with its interval, and what every withheld condition says."""
    rows = len(_folds(gap))
    caption = (
        f"How much of the {SHORT[gap.name]} gap beyond noise the named effects take away. Bar: to be expected on new data, with "
        "the 90 % interval. Dots: conditions left out of the fit as a whole; left of zero the effects would do harm."
    )
    return Plot(f"shrinkage-{gap.name}", caption, 0.75 + 0.17 * rows, lambda canvas: _draw_shrinkage(canvas, gap))


def _folds(gap: SignalGap) -> list[tuple[str, float]]:
    return [(name, value) for name, value in gap.extrapolation if value is not None][:14]


def _draw_shrinkage(canvas: Canvas, gap: SignalGap) -> None:
    ax = panels(canvas, 1, 1, left=2.0, right=0.5, top=0.08)[0][0]
    folds, s = _folds(gap), gap.shrinkage
    low = min([-0.05, *(v for _, v in folds), *([s.low] if s else [])])
    low = max(low, -1.0)
    if s is not None:
        ax.barh(0, s.predicted, height=0.55, color=AFTER)
        ax.plot([s.low, s.high], [0, 0], color=INK, lw=1.4, solid_capstyle="butt")
        ax.text(1.02, 0, f"{100 * s.predicted:.0f} %", fontsize=8, va="center", fontweight="bold", clip_on=False)
    place = -1.0 - np.arange(len(folds))
    dots(ax, np.maximum([v for _, v in folds], low), place, BEFORE, 4)
    for y, (_, v) in zip(place, folds, strict=True):
        ax.text(1.02, y, f"{100 * v:.0f} %", fontsize=6.5, va="center", color=SOFT, clip_on=False)
    ax.set_yticks([0, *place], ["expected on new data", *(shorten(f"without {name}", 34) for name, _ in folds)], fontsize=6.5)
    ax.set_xlim(low, 1.0)
    ax.axvline(0, color=RULE, lw=0.8)
    dressed(ax, "", "share of the gap that goes", grid="x")
    ax.tick_params(axis="y", length=0)
