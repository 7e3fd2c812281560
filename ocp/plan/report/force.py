"""The section "Predicted force along each pass": a panel a pass, with its band of two standard deviations, and their table.

On the page the panels are small SVG of their own, so that pointing at one can mark the place on the blade (viewer/page.js).
"""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from markupsafe import Markup

from ocp.plan.grades import SHARED
from ocp.plan.passes.stretches import LeftOut
from ocp.plan.report.plan_report import PassReport, PlanReport
from ocp.report.paper import picture
from ocp.report.parts import Facts, Table, table
from ocp.report.plotting import envelope
from ocp.report.section import Part, Section
from ocp.report.style import CURVE, RULE, SOFT, TARGET
from robots.pose import Array

MAX_POINTS = 400
"""Points drawn of one pass; a panel is about 400 pixels wide."""
_PAPER_STYLE = (  # viewer/panels.css has the page's
    f"text {{ fill: {SOFT}; font-size: 10px }} .y {{ text-anchor: end }} .x {{ text-anchor: middle }} .grid {{ stroke: {RULE} }} "
    f".band {{ fill: {CURVE}; fill-opacity: 0.18 }} .curve {{ fill: none; stroke: {CURVE}; stroke-width: 1.5 }} "
    f".target {{ stroke: {TARGET}; stroke-width: 1.2; stroke-dasharray: 5 4 }} .cursor {{ stroke: none }}"
)


@dataclass(frozen=True)
class PanelSize:
    """Size and margins of one panel in SVG units."""

    width: float = 320.0
    height: float = 132.0
    left: float = 34.0
    right: float = 8.0
    top: float = 8.0
    bottom: float = 20.0


PANEL = PanelSize()


def force_section(report: PlanReport) -> Section:
    """Force along the passes, and what each pass is in figures."""
    words = (
        "Line: predicted normal force in N over the distance along the pass in mm; band: plus and minus two standard deviations; "
        f"dashed: target {report.target_force:g} N."
    )
    style = (Path(__file__).parent / "viewer" / "panels.css").read_text(encoding="utf-8")
    return Section("Predicted force along each pass", (words, ForcePanels(report), pass_table(report)), style=style)


def left_out_section(report: PlanReport) -> Section:
    """What of the lines is not ground: where, why, and what would do."""
    rows = []
    for group in _alike([piece.lost for piece in report.left_out]):
        one, last = group[0], group[-1].line
        ends = [_span(np.array(of), 1) for of in zip(*(lost.ends_mm for lost in group), strict=True)]
        length = f"{1e3 * sum(lost.length for lost in group):.1f}"
        line = str(one.line) if last == one.line else f"{one.line} to {last}"
        rows.append((line, one.side, *ends, length, one.reason, one.would_do))
    names = ("line", "side", "from, mm", "to, mm", "in all, mm", "why", "what would do")
    words = (
        "Distances run along the line as it is driven; several lines in one row have a piece each, from the least to the largest "
        "distance, and in all. The scene shows these stretches in red, the maps hatched."
    )
    return Section("Left out", (words, table(names, rows, text=(0, 1, 5, 6))))


def _alike(lost: Sequence[LeftOut]) -> list[list[LeftOut]]:
    """Pieces of lines that follow one another, of one side, with the same reason and remedy: a piece a line in each group."""
    groups: list[list[LeftOut]] = []
    for one in sorted(lost, key=lambda piece: piece.line):
        key = (one.line - 1, one.side, one.reason, one.would_do)
        found = [group for group in groups if (group[-1].line, group[-1].side, group[-1].reason, group[-1].would_do) == key]
        if found:
            found[0].append(one)
        else:
            groups.append([one])
    return groups


def verification_section(report: PlanReport) -> Section:
    """What the independent route has in common with the planner, and what not."""
    words = "The force is judged on the written text by a route that is independent of the planner, but not in everything:"
    return Section("How the force was verified", (words, Facts(tuple(SHARED.items()))))


@dataclass(frozen=True)
class ForcePanels(Part):
    """One panel a pass; all share both axes, so that passes can be compared at a glance."""

    report: PlanReport

    def on_page(self) -> Markup:
        """As many panels side by side as there is room for."""
        return Markup('<div class="panels wide">\n{}\n</div>').format(Markup("\n").join(map(_figure, force_panels(self.report))))

    def on_paper(self) -> dict[str, Any]:
        """Two columns, in the order of the program."""
        shown = []
        for one, item in zip(force_panels(self.report), self.report.passes, strict=True):
            svg = str(_svg(one)).replace(">", f"><style>{_PAPER_STYLE}</style>", 1)
            shown.append({"title": f"Line {one.line}, {one.side}", "note": _figures(item), **picture(svg)})
        return {"is": "panels", "panels": shown}


def _figures(item: PassReport) -> str:
    """Range of the force and largest deviation in words, where they are known."""
    force, sd = item.force[np.isfinite(item.force)], item.force_sd[np.isfinite(item.force_sd)]
    words = [f"{force.min():.2f} to {force.max():.2f} N"] if len(force) else ["force not known"]
    return ", ".join(words + ([f"sd up to {sd.max():.2f} N"] if len(sd) else []))


@dataclass(frozen=True)
class ForcePanel:
    """One pass: paths of the band of two standard deviations and of the force, ticks (place, label), target height."""

    index: int
    line: int
    side: str
    band: str
    curve: str
    target: float
    x_ticks: tuple[tuple[float, str], ...]
    y_ticks: tuple[tuple[float, str], ...]


def force_panels(report: PlanReport) -> tuple[ForcePanel, ...]:
    """One panel a pass; all share the axes, so that passes can be compared at a glance."""
    low, high = force_range(report)
    longest = _longest(report)
    y_ticks = nice_ticks(low, high, 4)
    decimals = decimals_of(y_ticks)

    def across(s: Array) -> Array:
        return PANEL.left + (PANEL.width - PANEL.left - PANEL.right) * np.asarray(s) / longest

    def up(force: Array) -> Array:
        return PANEL.height - PANEL.bottom - (PANEL.height - PANEL.top - PANEL.bottom) * (np.asarray(force) - low) / (high - low)

    panels = []
    for index, item in enumerate(report.passes):
        pick = np.linspace(0, len(item.s) - 1, min(len(item.s), MAX_POINTS)).round().astype(int)
        x, force, sd = across(1e3 * item.s[pick]), item.force[pick], item.force_sd[pick]
        s, peaks = envelope(1e3 * item.s, item.force, MAX_POINTS // 2)
        panels.append(
            ForcePanel(
                index=index,
                line=int(item.line),
                side=item.side,
                band=_band_path(x, up(force + 2 * sd), up(force - 2 * sd)),
                curve=_path(across(s), up(peaks)),
                target=round(float(up(np.array(report.target_force))), 1),
                x_ticks=tuple((round(float(across(t)), 1), f"{t:g}") for t in nice_ticks(0, longest, 5)),
                y_ticks=tuple((round(float(up(t)), 1), f"{t:.{decimals}f}") for t in y_ticks),
            )
        )
    return tuple(panels)


def force_range(report: PlanReport) -> tuple[float, float]:
    """Common axis N of all force panels: target, forces and twice their deviations, with 5 % of air."""
    ends = [report.target_force - 0.1, report.target_force + 0.1]
    for item in report.passes:
        for edge in (item.force, item.force - 2 * item.force_sd, item.force + 2 * item.force_sd):
            known = edge[np.isfinite(edge)]
            ends += [float(known.min()), float(known.max())] if len(known) else []
    low, high = min(ends), max(ends)
    return low - 0.05 * (high - low), high + 0.05 * (high - low)


def _longest(report: PlanReport) -> float:
    return max(float(item.s[-1]) for item in report.passes) * 1e3 or 1.0


def _figure(panel: ForcePanel) -> Markup:
    """A panel as HTML."""
    words = Markup('<figcaption><b>Line {}</b> {} <span class="pointed"></span></figcaption>').format(panel.line, panel.side)
    return Markup("<figure>\n{}\n{}\n</figure>").format(words, _svg(panel))


def _svg(panel: ForcePanel) -> Markup:
    """Only numbers are put into paths; words are escaped."""
    right = PANEL.width - PANEL.right
    grid = Markup('<line class="grid" x1="{}" x2="{}" y1="{}" y2="{}"/><text class="y" x="{}" y="{}">{}</text>')
    y_ticks = (grid.format(PANEL.left, right, y, y, PANEL.left - 5, y + 3.5, label) for y, label in panel.y_ticks)
    x_ticks = (Markup('<text class="x" x="{}" y="{}">{}</text>').format(x, PANEL.height - 6, label) for x, label in panel.x_ticks)
    return Markup(
        '<svg viewBox="0 0 {size.width} {size.height}" data-pass="{index}" role="img" aria-label="Force along line {line}">\n'
        '{y_ticks}\n{x_ticks}\n<path class="band" d="{band}"/>'
        '<line class="target" x1="{size.left}" x2="{right}" y1="{target}" y2="{target}"/><path class="curve" d="{curve}"/>'
        '<line class="cursor" x1="-9" x2="-9" y1="{size.top}" y2="{foot}"/>\n</svg>'
    ).format(
        **{name: getattr(panel, name) for name in ("index", "line", "band", "curve", "target")},
        size=PANEL,
        right=right,
        foot=PANEL.height - PANEL.bottom,
        y_ticks=Markup("\n").join(y_ticks),
        x_ticks=Markup("\n").join(x_ticks),
    )


def nice_ticks(low: float, high: float, wanted: int = 4) -> Array:
    """Round numbers inside [low, high], about `wanted` of them: steps of 1, 2 or 5 times a power of ten."""
    raw = (high - low) / max(wanted, 1)
    if not np.isfinite(raw) or raw <= 0:
        return np.array([low])
    power = 10.0 ** np.floor(np.log10(raw))
    step = power * min((1.0, 2.0, 5.0, 10.0), key=lambda m: abs(m * power - raw))
    return np.round(step * np.arange(np.ceil(low / step - 1e-9), np.floor(high / step + 1e-9) + 1), 12) + 0.0


def decimals_of(ticks: Array) -> int:
    """Digits after the point that tell neighbouring ticks apart."""
    step = float(ticks[1] - ticks[0]) if len(ticks) > 1 else 1.0
    return max(0, int(np.ceil(-np.log10(step) - 1e-9)))


def _path(x: Array, y: Array) -> str:
    """SVG path through the finite points, a gap (new M) wherever some are not finite."""
    words, pen = [], "M"
    for a, b in zip(x.tolist(), y.tolist(), strict=True):
        if not (np.isfinite(a) and np.isfinite(b)):
            pen = "M"
            continue
        words.append(f"{pen}{a:.1f} {b:.1f}")
        pen = "L"
    return "".join(words)


def _band_path(x: Array, upper: Array, lower: Array) -> str:
    """Closed SVG path around a band, over the points where both edges are finite."""
    known = np.isfinite(upper) & np.isfinite(lower)
    if not known.any():
        return ""
    there = np.concatenate([x[known], x[known][::-1]])
    edge = np.concatenate([upper[known], lower[known][::-1]])
    return _path(there, edge) + "Z"


def pass_table(report: PlanReport) -> Table:
    """One row a pass, in the order of the program: length, force, largest deviation, feed, largest use of a limit."""
    columns = ("Line", "Side", "Length, mm", "Waypoints", "Force, N", "Largest sd, N", "Feed, mm/s", "Largest use of a limit")
    rows = [
        (
            str(item.line),
            item.side,
            f"{1e3 * item.s[-1]:.1f}",
            str(len(item.s)),
            _span(item.force, 2),
            _largest(item.force_sd, 2),
            _span(1e3 * np.asarray(item.feed), 1),
            _largest(item.limit_ratio, 2),
        )
        for item in report.passes
    ]
    return table(columns, rows, text=(0, 1), title="Passes")


def _span(sampled: Array, decimals: int) -> str:
    known = sampled[np.isfinite(sampled)]
    if len(known) == 0:
        return "not known"
    low, high = f"{known.min():.{decimals}f}", f"{known.max():.{decimals}f}"
    return low if low == high else f"{low} .. {high}"


def _largest(sampled: Array, decimals: int) -> str:
    known = sampled[np.isfinite(sampled)]
    return f"{known.max():.{decimals}f}" if len(known) else "not known"
