"""The section "Which effect": how probable the explanations are, and what the data cannot tell apart."""

import numpy as np
from matplotlib.axes import Axes

from ocp.diagnose.report.words import effect_words
from ocp.diagnose.verdict.answer import Answer
from ocp.report.parts import Plot, Points
from ocp.report.plotting import Canvas, dressed
from ocp.report.section import Part, Section
from ocp.report.style import AFTER, BEFORE, SOFT, shorten

MOST = 10
_ROW = 0.2  # inch a bar


def which_effect_section(answer: Answer) -> Section:
    """Probabilities, classes, impostors, and what speaks for something unknown."""
    d = answer.diagnosis
    parts: list[Part | str] = [probabilities_plot(answer)]
    groups = [" = ".join(effect_words(name) for name in group) for group in d.classes]
    if groups:
        parts += ["These data cannot tell apart the members of each of these classes:", Points(tuple(groups))]
    if d.impostors:
        words = tuple(f"{effect_words(name)}: {why}" for name, why in d.impostors)
        parts += [
            "Impostors: they help where readings are left out at random and do harm where a condition is new.",
            Points(words),
        ]
    if d.unknown_reasons:
        parts += ["What speaks for an effect outside the catalogue:", Points(tuple(d.unknown_reasons))]
    return Section("Which effect", tuple(parts))


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


def _bars(ax: Axes, rows: list[tuple[str, float]], title: str, most: int) -> None:
    """Bars of probabilities with their numbers behind them."""
    place = -np.arange(float(len(rows)))
    values = [p for _, p in rows]
    ax.barh(place, values, height=0.62, color=[AFTER if p >= 0.5 else BEFORE for p in values])
    ax.set_yticks(place, [shorten(words, most) for words, _ in rows], fontsize=6.5)
    ax.set_xlim(0, 1)
    for y, p in zip(place, values, strict=True):
        ax.text(p + 0.015, y, f"{p:.3f}", va="center", fontsize=6.5, color=SOFT, clip_on=False)
    dressed(ax, title, "probability", grid="x")
    ax.tick_params(axis="y", length=0)
