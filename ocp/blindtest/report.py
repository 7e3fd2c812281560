"""The report of `python -m ocp.blindtest`: report.html, table.json, and table.md for docs/blindtest.md."""

import json
from collections.abc import Sequence
from dataclasses import asdict
from itertools import pairwise
from typing import Any

import numpy as np

from ocp.blindtest import figures as figs
from ocp.blindtest.figures import Estimate, Figure
from ocp.blindtest.record import Standing
from ocp.blindtest.worlds.recipes import BINS, WORDS, bin_words
from ocp.blindtest.worlds.sealing import Check
from ocp.report.parts import Plot, Table, table
from ocp.report.plotting import Canvas, dressed, keys, panels
from ocp.report.report import Report
from ocp.report.section import Headline, Part, Section
from ocp.report.style import AFTER, BAD, BEFORE, SOFT
from ocp.shell.output import files_added

KIND = "Blind check of the diagnosis"
TITLE = "Sealed worlds of the virtual cell"
METHOD_WORDS = {
    "diagnosis": "the diagnosis",
    "strict": "the diagnosis, declared classes not counted",
    "oracle": "oracle: knows signatures and noise",
    "single": "best single free parameter",
    "stepwise": "stepwise, Bayesian criterion",
    "sparse": "sparse regression",
    "unprojected": "score test, not projected",
}
# Share of first names that are right when data are drawn from the model itself, at these lambda (DIAGNOSIS, "How it is judged").
CEILING = ((15, 22, 30, 50, 100), (0.71, 0.92, 0.93, 0.96, 0.98))
CURVES = (("diagnosis", AFTER, 0.97), ("oracle", "#12643a", 1.03), ("stepwise", BEFORE, 1.09), ("sparse", BAD, 0.91))
EDGES = (0.0, 0.05, 0.2, 0.4, 0.6, 0.8, 0.95, 1.0)
LAST = 300.0  # where the open bin is drawn
Row = dict[str, Any]


def write_blindtest_report(check: Check, rows: Sequence[Row], standing: Standing) -> None:
    """Write the files into the check's folder; standing: what its answers are to its seed. Raises OSError."""
    figures = figs.all_figures(rows)
    sections = _sections(check, rows, figures)
    head = {"seed": check.seed, "worlds": check.worlds, "standing": standing.brief}
    lines = [
        {"figure": f.what, "sense": f.sense, "target": f.target, "met": f.met} | _plain(f.estimate) | {"oracle": _plain(f.oracle)}
        for f in figures
    ]
    with files_added(check.folder) as part:
        Report(KIND, TITLE, _headline(rows, figures, standing), (), sections).write_page(part / "report.html")
        (part / "table.json").write_text(json.dumps(head | {"figures": lines}, indent=1) + "\n", encoding="utf-8")
        (part / "table.md").write_text(_markdown(check, sections, standing), encoding="utf-8")


def blindtest_last_line(check: Check, rows: Sequence[Row], standing: Standing) -> str:
    """The command's answer."""
    figures = figs.all_figures(rows)
    judged = [f for f in figures if f.met is not None]
    reached = f"{sum(bool(f.met) for f in judged)} of {len(judged)} figures reach their target"
    told = f"{len(rows)} worlds, seed {check.seed} ({standing.brief}): {reached}"
    return f"{check.folder}: {told}; {check.folder / 'report.html'} shows all"


def _plain(e: Estimate) -> dict[str, Any]:
    return {k: (None if isinstance(v, float) and not np.isfinite(v) else v) for k, v in asdict(e).items()}


def _headline(rows: Sequence[Row], figures: Sequence[Figure], standing: Standing) -> Headline:
    judged = [f for f in figures if f.met is not None]
    missed = [f.what for f in judged if not f.met]
    kinds = ", ".join(f"{sum(r['kind'] == k for r in rows)} {w}" for k, w in WORDS.items() if any(r["kind"] == k for r in rows))
    return Headline(
        not missed,
        "All targets reached" if not missed else f"{len(judged) - len(missed)} of {len(judged)} targets reached",
        f"{len(rows)} worlds of the virtual cell were drawn and sealed, answered blind, and judged afterwards. "
        + standing.sentence,
        (("worlds", kinds), ("not reached", "; ".join(missed) or "none")),
        doubtful=not standing.counts,
    )


def _sections(check: Check, rows: Sequence[Row], figures: Sequence[Figure]) -> list[Section]:
    rests = (
        "Every figure with its 95 % confidence interval and the number of worlds it rests on. A name counts as right within its "
        "declared class, with the joint."
    )
    wrong = "Planted effects with their detectability, what was said with its probability, and what is wrong with it."
    bad = [(r["world"].lstrip("0"), figs.planted_words(r), figs.said_words(r), figs.why_words(r)) for r in figs.worst(rows)]
    return [
        Section("How often the name is right", (_curve_plot(rows), method_table(rows, "top1"), method_table(rows, "top3"))),
        Section("Figures", (rests, figures_table(figures))),
        Section("What the probabilities are worth", (_reliability_plot(rows),)),
        Section("The worst answers", (wrong, table(("world", "planted (lambda)", "said", "fault"), bad, text=(0, 1, 2, 3)))),
        Section("How it was made", tuple(_made(check))),
    ]


def interval_words(e: Estimate, percent: bool) -> str:
    """Value, interval and count."""
    if not e.count or not np.isfinite(e.value):
        return "none"
    if percent:
        return f"{100 * e.value:.1f} % ({100 * e.low:.0f}-{100 * e.high:.0f})"
    return f"{e.value:.3g} ({e.low:.2g}-{e.high:.2g})"


def _target(f: Figure) -> str:
    scale, unit = (100.0, " %") if f.percent else (1.0, "")
    words = [f"{scale * value:g}" for value in f.target]
    return f"{'' if f.sense == 'in' else f.sense + ' '}{'-'.join(words)}{unit}" if words else ""


def figures_table(figures: Sequence[Figure]) -> Table:
    """The table of DIAGNOSIS.md."""
    mark = {True: "yes", False: "no", None: ""}
    rows = []
    for f in figures:
        oracle = interval_words(f.oracle, f.percent) if f.oracle.count else ""
        rows.append((f.what, _target(f), interval_words(f.estimate, f.percent), str(f.estimate.count), mark[f.met], oracle))
    missed = [k for k, f in enumerate(figures) if f.met is False]
    return table(("figure", "target", "value (95 %)", "n", "reached", "oracle"), rows, text=(0, 4), strong=missed)


def method_table(rows: Sequence[Row], key: str) -> Table:
    """Hits in every bin: the diagnosis, the oracle, the rivals, chance."""
    heads = ("which", *(f"lambda {bin_words(k)}" for k in range(len(BINS))))
    lines = [
        (words, *(interval_words(e, True) for e in figs.by_bin(rows, key, method))) for method, words in METHOD_WORDS.items()
    ]
    lines.append(("chance: labels dealt anew", interval_words(figs.chance(rows, key), True), "", "", ""))
    return table(heads, lines, title="First name right" if key == "top1" else "Among the first three")


def _made(check: Check) -> list[Part | str]:
    return [
        f"python -m ocp.blindtest --worlds {check.worlds} --seed {check.seed} --kinds {','.join(check.kinds)} --readings "
        f"{check.readings}",
        "Worlds are drawn by the virtual cell, which shares no code with the diagnosis (tests/simulate/test_twin_imports.py). "
        "Effects and sizes are drawn and sealed with their SHA-256 before the first answer; the answering processes are given "
        "the folders of the measurements alone; labels are opened when all answers are written.",
        "Lambda is computed from what the virtual machine was drawn with: its own signature of the effect, the instrument's "
        "noise and repeatability, and the variances of placement, nests, springs and masses.",
    ]


def _markdown(check: Check, sections: Sequence[Section], standing: Standing) -> str:
    """Tables as text for the documentation."""
    lines = []
    for section in sections:
        for part in section.parts:
            if isinstance(part, Table):
                lines += [f"## {part.title or section.title}", "", "| " + " | ".join(part.columns) + " |"]
                lines += ["|" + "---|" * len(part.columns)]
                lines += ["| " + " | ".join(cell.replace("|", "/") for cell in row) + " |" for row in part.rows] + [""]
    return "\n".join([f"{check.worlds} worlds, seed {check.seed}: {standing.brief}", "", *lines])


def _curve_plot(rows: Sequence[Row]) -> Plot:
    """Top-1 and top-3 over the bins of lambda, with intervals."""
    shares = {(m, k): figs.by_bin(rows, k, m) for m, *_ in CURVES for k in ("top1", "top3")}
    centres = [np.sqrt(low * min(high, LAST)) for low, high in BINS]

    def draw(canvas: Canvas) -> None:
        axes = panels(canvas, 1, 2)[0]
        for ax, key, title in zip(axes, ("top1", "top3"), ("first name right", "among the first three"), strict=True):
            dressed(ax, title, "detectability lambda", "share of worlds")
            for method, colour, aside in CURVES:
                _line(ax, centres, shares[method, key], colour, aside)
            if key == "top1":
                ax.plot(*CEILING, color=SOFT, linewidth=0.7, linestyle=":")
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
    """Lambda on a logarithmic axis, with the edges of the bins as plain numbers."""
    ax.set_xscale("log")
    ax.minorticks_off()
    ax.set_xticks([15, 30, 50, 100, 300], ["15", "30", "50", "100", "300"])


def _line(ax: Any, x: Sequence[float], found: Sequence[Estimate], colour: str, aside: float) -> None:
    known = [(a * aside, e.value, abs(e.value - e.low), abs(e.high - e.value)) for a, e in zip(x, found, strict=True) if e.count]
    if known:
        at, value, *bars = (list(part) for part in zip(*known, strict=True))
        ax.errorbar(at, value, yerr=bars, color=colour, linewidth=1.0, elinewidth=0.7, marker="o", markersize=3)


def _reliability_plot(rows: Sequence[Row]) -> Plot:
    """Told probabilities against how often the names were right, worlds whose effects the catalogue holds."""
    pairs = [(p, right) for r in figs.of_kinds(rows, *figs.USUAL) for p, right in r.get("reliability", ())]

    def draw(canvas: Canvas) -> None:
        axes = panels(canvas, 1, 2)[0]
        dressed(axes[0], "names", "told probability", "share that was right")
        axes[0].plot([0, 1], [0, 1], color=SOFT, linewidth=0.7, linestyle=":")
        for low, high in pairwise(EDGES):
            inside = [(p, right) for p, right in pairs if low < p <= high]
            if inside:
                e = figs.share_of_hits([right for _, right in inside])
                middle = float(np.mean([p for p, _ in inside]))
                bar = [[e.value - e.low], [e.high - e.value]]
                axes[0].errorbar(middle, e.value, yerr=bar, color=AFTER, marker="o", markersize=3)
        dressed(axes[1], "single effects", "detectability lambda", "probability of the planted effect")
        singles = [r for r in figs.of_kinds(rows, "single") if "said" in r]
        for right, colour in ((True, AFTER), (False, BAD)):
            some = [r for r in singles if figs.hit(r, "top1") is right]
            own = [max((p for n, j, p in r["said"] if [n, j] == r["planted"][0][:2]), default=0.0) for r in some]
            axes[1].plot([r["lam"][0] for r in some], own, color=colour, linestyle="none", marker="o", markersize=2.4)
        _ticks(axes[1])
        keys(axes[1], [("first name right", AFTER), ("wrong", BAD)])

    words = "Left: a name told with probability p should be right in a share p of all cases. Right: what the planted effect got."
    return Plot("probabilities", words, 2.3, draw)
