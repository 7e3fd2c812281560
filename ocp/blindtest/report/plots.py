"""Plots of a blind check: how often the name is right against the detectability, and what probabilities are worth."""

from collections.abc import Sequence
from itertools import pairwise
from typing import Any

import numpy as np

from ocp.blindtest.scoring.figures import by_bin, hit, of_kinds
from ocp.blindtest.scoring.intervals import Estimate, share_of_hits
from ocp.blindtest.worlds.recipes import BINS
from ocp.report.panels import AFTER, BAD, BEFORE, dressed, keys, panels
from ocp.report.section import Canvas, Plot
from ocp.report.style import SOFT

# Share of first names that are right when data are drawn from the model itself, at these lambda (DIAGNOSIS, "How it is judged").
CEILING = ((15, 22, 30, 50, 100), (0.71, 0.92, 0.93, 0.96, 0.98))
CURVES = (("diagnosis", AFTER, 0.97), ("oracle", "#12643a", 1.03), ("stepwise", BEFORE, 1.09), ("sparse", BAD, 0.91))
EDGES = (0.0, 0.05, 0.2, 0.4, 0.6, 0.8, 0.95, 1.0)
LAST = 300.0  # where the open bin is drawn


def curve_plot(rows: Sequence[dict[str, Any]]) -> Plot:
    """Top-1 and top-3 over the bins of lambda, with intervals."""
    shares = {(m, k): by_bin(rows, k, m) for m, *_ in CURVES for k in ("top1", "top3")}
    centres = [np.sqrt(low * min(high, LAST)) for low, high in BINS]

    def draw(canvas: Canvas) -> None:
        axes = panels(canvas, 1, 2)[0]
        for ax, key, title in zip(axes, ("top1", "top3"), ("first name right", "among the first three"), strict=True):
            dressed(ax, title, "detectability lambda", "share of worlds")
            for method, colour, aside in CURVES:
                _line(ax, centres, shares[method, key], colour, aside)
            if key == "top1":
                ax.plot(*CEILING, color=SOFT, linewidth=0.7, linestyle=":")
            ax.set_xscale("log")
            _ticks(ax)
            ax.set_xlim(13, LAST)
            ax.set_ylim(0, 1.03)
        keys(axes[1], [(m, c) for m, c, _ in CURVES], loc="lower right", bbox_to_anchor=(1.0, 0.0), ncols=1)

    words = (
        "Single effects of the catalogue by detectability, with 95 % intervals: the diagnosis, the oracle that knows every "
        "signature and the true noise, two rivals; dotted: what is reached on data drawn from the model itself."
    )
    return Plot("names-by-detectability", words, 2.4, draw)


def _ticks(ax: Any) -> None:
    """The edges of the bins as plain numbers."""
    ax.minorticks_off()
    ax.set_xticks([15, 30, 50, 100, 300], ["15", "30", "50", "100", "300"])


def _line(ax: Any, x: Sequence[float], found: Sequence[Estimate], colour: str, aside: float) -> None:
    known = [(a * aside, e) for a, e in zip(x, found, strict=True) if e.count]
    if not known:
        return
    at = [a for a, _ in known]
    value = np.array([e.value for _, e in known])
    bars = np.abs(np.array([[e.value - e.low, e.high - e.value] for _, e in known]).T)
    ax.errorbar(at, value, yerr=bars, color=colour, linewidth=1.0, elinewidth=0.7, marker="o", markersize=3)


def reliability_plot(rows: Sequence[dict[str, Any]]) -> Plot:
    """Told probabilities against how often the names were right, worlds whose effects the catalogue holds."""
    usual = of_kinds(rows, "single", "pair", "triple", "none", "none_background")
    pairs = [(p, right) for r in usual for p, right in r.get("reliability", ())]

    def draw(canvas: Canvas) -> None:
        axes = panels(canvas, 1, 2)[0]
        dressed(axes[0], "names", "told probability", "share that was right")
        axes[0].plot([0, 1], [0, 1], color=SOFT, linewidth=0.7, linestyle=":")
        for low, high in pairwise(EDGES):
            inside = [(p, right) for p, right in pairs if low < p <= high]
            if inside:
                e = share_of_hits([right for _, right in inside])
                middle = float(np.mean([p for p, _ in inside]))
                bar = [[e.value - e.low], [e.high - e.value]]
                axes[0].errorbar(middle, e.value, yerr=bar, color=AFTER, marker="o", markersize=3)
        dressed(axes[1], "single effects", "detectability lambda", "probability of the planted effect")
        singles = [r for r in of_kinds(rows, "single") if "said" in r]
        for right, colour in ((True, AFTER), (False, BAD)):
            some = [r for r in singles if hit(r, "top1") is right]
            own = [max((p for n, j, p in r["said"] if [n, j] == r["planted"][0][:2]), default=0.0) for r in some]
            axes[1].plot([r["lam"][0] for r in some], own, color=colour, linestyle="none", marker="o", markersize=2.4)
        axes[1].set_xscale("log")
        _ticks(axes[1])
        keys(axes[1], [("first name right", AFTER), ("wrong", BAD)])

    words = "Left: a name told with probability p should be right in a share p of all cases. Right: what the planted effect got."
    return Plot("probabilities", words, 2.3, draw)
