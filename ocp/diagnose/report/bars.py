"""Bars of a diagnosis: what goes with the gap, how probable the explanations are, how far the gap shrinks."""

import numpy as np

from ocp.diagnose.engine.findings import BudgetLine
from ocp.diagnose.report.words import SHORT, condition_words
from ocp.diagnose.verdict.answer import Answer, SignalGap
from ocp.report.parts import Plot
from ocp.report.plotting import Canvas, dots, dressed, panels
from ocp.report.style import AFTER, BEFORE, INK, RULE, SHADE, SOFT, shorten

MOST = 10
SURE = 0.01  # p-value up to which a line of the budget is drawn as found
_ROW = 0.2  # inch a bar


def probabilities_plot(answer: Answer) -> Plot:
    """Explanations and effects with their probabilities."""
    d = answer.diagnosis
    rows = len(_explained(answer)) + 2
    names = len(d.ranking[:MOST])
    caption = (
        "Left: probability of every explanation as a whole; they sum to one. Right: probability that an effect is present at "
        "all, in whatever explanation."
    )
    return Plot("probability", caption, 0.65 + _ROW * max(rows, names, 3), lambda canvas: _draw_probabilities(canvas, answer))


def _explained(answer: Answer) -> list[tuple[str, float]]:
    """Explanations by the names of the catalogue, joined."""
    told = [e for e in answer.diagnosis.explanations[: MOST - 2] if e.probability > 5e-4]
    return [(" + ".join(str(n) for n in e.names), e.probability) for e in told]


def _draw_probabilities(canvas: Canvas, answer: Answer) -> None:
    d = answer.diagnosis
    left, right = canvas.subplots(1, 2, left=2.35, across=1.75, right=0.4)
    rows = [*_explained(answer), ("nothing at all", d.p_none), ("none of these", d.p_unknown)]
    _bars(left, rows, "explanation", 46)
    _bars(right, [(str(r.name).replace("_", " "), r.probability) for r in d.ranking[:MOST]], "effect", 26)


def _bars(ax: object, rows: list[tuple[str, float]], title: str, most: int) -> None:
    """Bars of probabilities with their numbers behind them."""
    place = -np.arange(len(rows))
    values = [p for _, p in rows]
    ax.barh(place, values, height=0.62, color=[AFTER if p >= 0.5 else BEFORE for p in values])  # type: ignore[attr-defined]
    ax.set_yticks(place, [shorten(words, most) for words, _ in rows], fontsize=6.5)  # type: ignore[attr-defined]
    ax.set_xlim(0, 1)  # type: ignore[attr-defined]
    for y, p in zip(place, values, strict=True):
        ax.text(p + 0.015, y, f"{p:.3f}", va="center", fontsize=6.5, color=SOFT, clip_on=False)  # type: ignore[attr-defined]
    dressed(ax, title, "probability", grid="x")  # type: ignore[arg-type]
    ax.tick_params(axis="y", length=0)  # type: ignore[attr-defined]


def budget_plot(answer: Answer) -> Plot:
    """What the gap goes with."""
    rows = len(_lines(answer))
    caption = (
        "What the gap beyond noise goes with, before any effect is named and without the catalogue: share of its mean square "
        "that a dependence on the condition explains. Light: chance would do as well (the p-value stands behind)."
    )
    return Plot("budget", caption, 0.6 + _ROW * max(rows, 2), lambda canvas: _draw_budget(canvas, answer))


def _lines(answer: Answer) -> list[BudgetLine]:
    """What explains anything at all."""
    return [line for k, line in enumerate(answer.diagnosis.budget) if k < 3 or line.share > 0][:MOST]


def _draw_budget(canvas: Canvas, answer: Answer) -> None:
    ax = canvas.subplots(1, 1, left=2.6, right=0.9, top=0.08)
    lines = _lines(answer)
    several = len(answer.gaps) > 1
    place = -np.arange(len(lines))
    colours = [AFTER if line.p_value <= SURE else SHADE for line in lines]
    ax.barh(place, [line.share for line in lines], height=0.62, color=colours)
    names = [f"{SHORT[b.channel]}: {condition_words(b.where)}" if several else condition_words(b.where) for b in lines]
    ax.set_yticks(place, [shorten(name, 44) for name in names], fontsize=6.5)
    ax.set_xlim(0, max(1.0, *(line.share for line in lines)) if lines else 1.0)
    for y, line in zip(place, lines, strict=True):
        ax.text(line.share + 0.01, y, f"{100 * line.share:.0f} %   p {line.p_value:.2g}", va="center", fontsize=6.5, color=SOFT)
    dressed(ax, "", "share of the gap beyond noise", grid="x")
    ax.tick_params(axis="y", length=0)


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
