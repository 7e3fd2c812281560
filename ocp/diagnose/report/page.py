"""The report of `python -m ocp.diagnose`: one page that loads nothing and runs nothing; its sections in their order.

Its short sections stand here: "Which effect" (how probable the explanations are, and what the data cannot tell apart), "How
far the gap shrinks" (sizes before and after, and what is to be expected on new data), "What to measure next".
"""

import numpy as np
from matplotlib.axes import Axes

from ocp.diagnose.report.evidence import evidence_section
from ocp.diagnose.report.verdict_sentence import SHORT, diagnosis_headline, effect_words, figure, shrinkage_words
from ocp.diagnose.report.where import ROW, draw_bars, where_section
from ocp.diagnose.verdict.answer import Answer, SignalGap, figures
from ocp.diagnose.verdict.shrinkage import NONE
from ocp.report.parts import Plot, Points, Table, made_from, table
from ocp.report.plotting import Canvas, dots, dressed, inline_svg, panels
from ocp.report.report import Report
from ocp.report.section import Part, Section
from ocp.report.style import AFTER, BEFORE, INK, RULE, SOFT, shorten

MOST_NAMED = 10


def which_effect_section(answer: Answer) -> Section:
    """Probabilities, classes, impostors, and what speaks for something unknown."""
    d = answer.diagnosis
    parts: list[Part | str] = [probabilities_plot(answer)]
    groups = [" = ".join(effect_words(name) for name in group) for group in d.classes]
    if groups:
        parts += ["These data cannot tell apart the members of each of these classes:", Points(tuple(groups))]
    if d.impostors:
        words = tuple(f"{effect_words(name)}: {why}" for name, why in d.impostors)
        parts += ["Impostors: they help where readings are left out at random and harm where a condition is new.", Points(words)]
    if d.unknown_reasons:
        parts += ["What speaks for an effect outside the catalogue:", Points(tuple(d.unknown_reasons))]
    return Section("Which effect", tuple(parts))


def probabilities_plot(answer: Answer) -> Plot:
    """Explanations and effects with their probabilities."""
    d = answer.diagnosis
    rows = len(_explained(answer)) + 2
    names = len(d.ranking[:MOST_NAMED])
    caption = (
        "Left: probability of every explanation as a whole; they sum to one. Right: probability that an effect is present at "
        "all, in whatever explanation."
    )
    return Plot("probability", caption, 0.65 + ROW * max(rows, names, 3), lambda canvas: _draw_probabilities(canvas, answer))


def _explained(answer: Answer) -> list[tuple[str, float]]:
    """Explanations by the names of the catalogue, joined."""
    told = [e for e in answer.diagnosis.explanations[: MOST_NAMED - 2] if e.probability > 5e-4]
    return [(" + ".join(str(n).replace("_", " ") for n in e.names), e.probability) for e in told]


def _draw_probabilities(canvas: Canvas, answer: Answer) -> None:
    d = answer.diagnosis
    left, right = canvas.subplots(1, 2, left=2.35, across=1.75, right=0.4)
    rows = [*_explained(answer), ("no name of the catalogue", d.p_none), ("none of these", d.p_unknown)]
    _bars(left, rows, "explanation", 46)
    _bars(right, [(str(r.name).replace("_", " "), r.probability) for r in d.ranking[:MOST_NAMED]], "effect", 26)


def _bars(ax: Axes, rows: list[tuple[str, float]], title: str, most: int) -> None:
    """Bars of probabilities with their numbers behind them."""
    values = [p for _, p in rows]
    words = [shorten(words, most) for words, _ in rows]
    draw_bars(ax, values, [AFTER if p >= 0.5 else BEFORE for p in values], words, [f"{p:.3f}" for p in values], 0.015)
    dressed(ax, title, "probability", grid="x")


def shrinkage_section(answer: Answer) -> Section:
    """Table of the gaps, and a plot for every signal whose gap shrinks."""
    parts: list[Part | str] = [
        "Sizes of the readings' errors, outliers apart; 'before' is the believed cell with its parameters refitted, as a good "
        "calibration leaves it.",
        gaps_table(answer),
    ]
    promises = [(SHORT[g.name], kind, shrinkage_words(s)) for g in answer.gaps for kind, s in g.promise.items()]
    if promises:
        parts.append(table(("signal", "new data", "shrinkage expected"), promises, text=(0, 1, 2)))
    if answer.diagnosis.active:
        parts += [shrinkage_plot(gap) for gap in answer.gaps if gap.shrinkage not in (None, NONE)]
    return Section("How far the gap shrinks", tuple(parts))


def gaps_table(answer: Answer) -> Table:
    """Gap of every signal before and after."""
    rows = []
    for gap in answer.gaps:
        before, after = figures(gap.before), figures(gap.after)
        s = gap.shrinkage
        told = "in the noise" if s is None else shrinkage_words(s)
        cells = (SHORT[gap.name], gap.unit, figure(gap.noise_floor))
        rows.append((*cells, *(figure(v[k]) for k in ("rms", "mean", "max") for v in (before, after)), told))
    sizes = [word for what in ("rms", "mean", "max") for word in (f"{what} before", "after")]
    return table(("signal", "unit", "noise", *sizes, "shrinkage expected"), rows, text=(0, 1, 9))


def shrinkage_plot(gap: SignalGap) -> Plot:
    """Predicted shrinkage with its interval, and what every withheld condition says."""
    rows = len(_folds(gap))
    caption = (
        f"How much of the {SHORT[gap.name]} gap beyond noise the named effects take away. Bar: to be expected "
        f"{gap.there}, with the 90 % interval. Dots: conditions left out of the fit as a whole; left of zero the "
        "effects would do harm."
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
        ax.text(1.04, 0, f"{100 * s.predicted:.0f} %", fontsize=8, va="center", fontweight="bold", clip_on=False)
    place = -1.0 - np.arange(len(folds))
    dots(ax, np.maximum([v for _, v in folds], low), place, BEFORE, 4)
    for y, (_, v) in zip(place, folds, strict=True):
        ax.text(1.04, y, f"{round(100 * v)} %", fontsize=6.5, va="center", color=SOFT, clip_on=False)
    names = [f"expected {gap.there}", *(shorten(f"without {name}", 34) for name, _ in folds)]
    ax.set_yticks([0, *place], names, fontsize=6.5)
    ax.set_xlim(low - 0.02, 1.02)
    ax.axvline(0, color=RULE, lw=0.8)
    dressed(ax, "", "share of the gap that goes", grid="x")
    ax.tick_params(axis="y", length=0)


KIND = "Diagnosis of the gap between model and cell"


def diagnosis_page(answer: Answer, hashes: dict[str, str]) -> bytes:
    """The page, UTF-8; equal answers give equal bytes. hashes: SHA-256 by file name of what was read."""
    cell, folder = answer.data.setup.tables.name, answer.data.folder.resolve().name
    title = cell if cell == folder else f"{cell}: {folder}"
    report = Report(KIND, title, diagnosis_headline(answer), (), diagnosis_sections(answer, hashes))
    return report.page().encode("utf-8", "replace")


def diagnosis_sections(answer: Answer, hashes: dict[str, str]) -> list[Section]:
    """All sections after the headline."""
    found = [which_effect_section(answer), shrinkage_section(answer), where_section(answer)]
    if answer.next:
        words = (
            "In order of what a minute of it brings. The probability is the one that the true explanation is expected to have "
            "against its rival once the experiment was made; tracker measurements are simulated with this campaign's own noise."
        )
        found.append(Section("What to measure next", (words, next_table(answer))))
    found.append(_not_seen(answer))
    return [*found, evidence_section(answer), made_from(hashes)]


def next_table(answer: Answer) -> Table:
    """Experiments with minutes and what they tell."""
    rows = [(e.do, f"{e.minutes:.0f}", " | ".join(e.tells_apart), f"{e.expected:.2f}") for e in answer.next]
    return table(("experiment", "minutes", "tells apart", "probability expected"), rows, text=(0, 2))


def _not_seen(answer: Answer) -> Section:
    parts: list[Part | str] = [Points(answer.blind)] if answer.blind else ["Every effect of the catalogue could be tested."]
    if answer.notices:
        parts += ["Notices", Points(answer.notices)]
    return Section("What these data cannot show", tuple(parts))


def warm_up() -> None:
    """Draw a plot of nothing: fonts and what else matplotlib reads at the first one are there when the answer comes."""
    inline_svg("nothing", "nothing", 1.0, lambda canvas: canvas.subplots().set_title("nothing"))
