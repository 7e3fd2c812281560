"""The section "Where it lies": what the gap goes with; in the workspace, by joint, along the log, on the blade, as spectra."""

from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.ticker import FuncFormatter, NullLocator

from ocp.calibrate.report.view import in_base
from ocp.diagnose.engine.channel_system import SCALE
from ocp.diagnose.engine.findings import BudgetLine, SpectrumPeak
from ocp.diagnose.engine.search import outliers
from ocp.diagnose.report.verdict_sentence import SHORT, condition_words
from ocp.diagnose.tracker.channel import TrackerChannel
from ocp.diagnose.verdict.answer import Answer, SignalGap
from ocp.report.parts import Plot
from ocp.report.plotting import Canvas, dots, dressed, panels, reach
from ocp.report.section import Part, Section
from ocp.report.style import AFTER, BEFORE, COLOUR_MAP, INK, LIMIT, RULE, SHADE, SOFT, shorten
from ocp.report.workspace import draw_by_joint, draw_vectors, exaggeration
from robots.pose import Array

MOST = 10
SURE = 0.01  # p-value up to which a line of the budget or a peak is drawn as found
ROW = 0.2  # inch a bar


def where_section(answer: Answer) -> Section:
    """Pictures of every signal's gap."""
    d = answer.diagnosis
    joint = d.location.joint if d.location else 0
    parts: list[Part | str] = [budget_plot(answer)] if d.budget else []
    for gap in answer.gaps:
        of_force, c = gap.name == "force", gap.baseline.conditions
        plot = vectors_plot if isinstance(gap.baseline, TrackerChannel) else force_gap_plot if of_force else log_plot
        parts.append(plot(gap))
        if c.d_joints is not None and not of_force:
            parts.append(hysteresis_plot(gap, joint))
    if d.spectrum:
        parts.append(spectrum_plot(d.spectrum))
    return Section("Where it lies", tuple(parts))


def budget_plot(answer: Answer) -> Plot:
    """What the gap goes with."""
    rows = len(_lines(answer))
    caption = (
        "What the gap beyond noise goes with, before any effect is named and without the catalogue: share of its mean square "
        "that a dependence on the condition explains. Light: chance would do as well (the p-value stands behind)."
    )
    return Plot("budget", caption, 0.6 + ROW * max(rows, 2), lambda canvas: _draw_budget(canvas, answer))


def _lines(answer: Answer) -> list[BudgetLine]:
    """What explains anything at all."""
    return [line for k, line in enumerate(answer.diagnosis.budget) if k < 3 or line.share > 0][:MOST]


def _draw_budget(canvas: Canvas, answer: Answer) -> None:
    ax = canvas.subplots(1, 1, left=2.6, right=0.9, top=0.08)
    lines = _lines(answer)
    several = len(answer.gaps) > 1
    colours = [AFTER if line.p_value <= SURE else SHADE for line in lines]
    names = [f"{SHORT[b.channel]}: {condition_words(b.where)}" if several else condition_words(b.where) for b in lines]
    told = [f"{100 * line.share:.0f} %   p {line.p_value:.2g}" for line in lines]
    draw_bars(ax, [line.share for line in lines], colours, [shorten(name, 44) for name in names], told, 0.01)
    dressed(ax, "", "share of the gap beyond noise", grid="x")


def draw_bars(ax: Axes, values: list[float], colours: list[str], names: list[str], told: list[str], behind: float) -> None:
    """Bars of shares from the top down with their names before and words behind them."""
    place = -np.arange(float(len(values)))
    ax.barh(place, values, height=0.62, color=colours)
    ax.set_yticks(place, names, fontsize=6.5)
    ax.set_xlim(0, max([1.0, *values]))
    ax.tick_params(axis="y", length=0)
    for y, value, words in zip(place, values, told, strict=True):
        ax.text(value + behind, y, words, va="center", fontsize=6.5, color=SOFT, clip_on=False)


def vectors_plot(gap: SignalGap) -> Plot:
    """Residual vectors in the workspace, before and after."""
    caption = (
        "What is left of the tracker's readings (measured less predicted), base frame, drawn longer by the factor given. Above: "
        "the believed robot refitted; below: with the named effects. Neighbours that point the same way are a pattern; arrows "
        "without order are noise."
    )
    return Plot("vectors", caption, 4.9, lambda canvas: _draw_vectors(canvas, gap))


def _draw_vectors(canvas: Canvas, gap: SignalGap) -> None:
    factor = 0.0
    channels = (("believed robot", gap.baseline, BEFORE), ("with the effects", gap.corrected, AFTER))
    for axes, (when, channel, colour) in zip(panels(canvas, 2, 2, across=0.55, down=0.6), channels, strict=True):
        assert isinstance(channel, TrackerChannel)
        S = channel.fit.state.stations[channel.readings.station]
        point, vectors = in_base(channel.fit.linear.point - S[:, :3, 3], S), in_base(channel.gap(), S)
        kept = ~outliers(channel)
        factor = factor or exaggeration(point, vectors[kept])  # one scale, so that both can be compared
        draw_vectors(axes, when, point[kept], vectors[kept], factor, colour, np.zeros(int(kept.sum()), bool))


def along_joints(gap: SignalGap) -> tuple[Array, Array, Array | None]:
    """Gap (n, 6) in the signal's unit along the way on which each joint carries what is measured, nan where it does not; joint
    angles (n, 6) rad; approach (n, 6) or None."""
    c = gap.baseline.conditions
    assert c.d_joints is not None
    way = np.linalg.norm(c.d_joints, axis=1)
    far = way > 0.05 * way.max()
    along = np.einsum("nk,nkj->nj", gap.baseline.gap(), c.d_joints) / np.where(far, way, 1.0)
    return np.where(far, along, np.nan) * SCALE[gap.unit], c.q, c.approach


def hysteresis_plot(gap: SignalGap, joint: int) -> Plot:
    """The gap along each joint's motion against its angle, split by the side it came from."""
    split = gap.baseline.conditions.approach is not None
    caption = (
        "The gap along the way on which each joint carries what is measured, against the joint's angle, before any effect is "
        "named. Lines: running medians. Two levels by colour are backlash or friction, a wave is a gear or an encoder, a slope a "
        "spring or a scale."
        + ("" if split else " No approach columns: the two sides cannot be told apart.")
        + (f" The frame marks joint {joint}." if joint else "")
    )
    along, q, approach = along_joints(gap)
    return Plot(
        f"hysteresis-{gap.name}", caption, 3.6, lambda canvas: draw_by_joint(canvas, q, along, approach, gap.unit, framed=joint)
    )


def log_plot(gap: SignalGap) -> Plot:
    """Errors of a log of encoders in the order it was recorded, before and after."""
    caption = "The gap of the link-side encoders in the order of the recording: grey before, blue with the named effects."
    there = gap.baseline.conditions.d_joints
    assert there is not None
    joints = [j for j in range(1, 7) if np.any(there[:, :, j - 1])]
    return Plot(f"log-{gap.name}", caption, 0.5 + 1.15 * len(joints), lambda canvas: _draw_log(canvas, gap, joints, there))


def _draw_log(canvas: Canvas, gap: SignalGap, joints: list[int], there: Array) -> None:
    axes = [row[0] for row in panels(canvas, len(joints), 1, down=0.38, bottom=0.36)]
    before, after = (SCALE[gap.unit] * channel.gap()[:, 0] for channel in (gap.baseline, gap.corrected))
    time, run = gap.baseline.conditions.time, gap.baseline.conditions.run
    one_run = time is not None and (run is None or len(np.unique(run)) == 1)
    for ax, j in zip(axes, joints, strict=True):
        rows = np.flatnonzero(there[:, 0, j - 1])
        x = time[rows] if one_run and time is not None else np.arange(len(rows))
        limit = reach(before[rows])
        for values, colour in ((before, BEFORE), (after, AFTER)):
            dots(ax, x, np.clip(values[rows], -limit, limit), colour, 1.2)
        ax.set_ylim(-1.05 * limit, 1.05 * limit)
        ax.axhline(0, color=RULE, lw=0.8, zorder=0)
        dressed(ax, f"joint {j}", ("s" if one_run else "reading") if j == joints[-1] else "", gap.unit)


def force_gap_plot(gap: SignalGap) -> Plot:
    """Force errors over the blade: along the lines, before and after."""
    caption = (
        "The force gap on the blade: every run along its line, coloured by measured less predicted force. A pattern that repeats "
        "from run to run belongs to the blade or the path, one that drifts from run to run to wheel or sensor."
    )
    return Plot("blade", caption, 2.35, lambda canvas: _draw_blade(canvas, gap))


def _draw_blade(canvas: Canvas, gap: SignalGap) -> None:
    axes = panels(canvas, 1, 2, right=0.65, sharey=True, across=0.2)[0]
    c = gap.baseline.conditions
    s = c.s if c.s is not None else np.arange(len(c.q)) * 1e-3
    group = c.run if c.run is not None else c.line if c.line is not None else np.zeros(len(c.q), int)
    contact = np.ones(len(c.q), bool) if c.contact is None else np.asarray(c.contact, bool)
    limit = reach(gap.baseline.gap()[contact, 0])
    colours: dict[str, Any] = {"cmap": COLOUR_MAP, "vmin": -limit, "vmax": limit}
    image: Any = None
    for ax, (title, channel) in zip(axes, (("before", gap.baseline), ("with the effects", gap.corrected)), strict=True):
        values = np.clip(channel.gap()[contact, 0], -limit, limit)
        place = 1e3 * s[contact], group[contact]
        image = ax.scatter(*place, s=3, c=values, marker="s", linewidths=0, rasterized=True, **colours)
        dressed(ax, title, "along the line, mm", "run" if title == "before" else "", grid="")
        ax.invert_yaxis() if title == "before" else None
    bar = axes[-1].inset_axes((1.04, 0.0, 0.035, 1.0))
    canvas.figure.colorbar(image, cax=bar)
    bar.tick_params(labelsize=6, pad=3.5, colors=SOFT)
    bar.set_title("N", fontsize=6.5, color=SOFT)


def spectrum_plot(peaks: tuple[SpectrumPeak, ...]) -> Plot:
    """Power over orders per turn of every joint."""
    caption = (
        "Ripple of the gap in each joint's angle: power over waves per turn of the axis, weighed by how the joint moves what is "
        "measured. A peak marked in red would come by chance in fewer than one of a hundred data sets; amplitude in brackets."
        + (" The six most telling." if len(peaks) > 6 else "")
    )
    rows = 2 if len(peaks) > 3 else 1
    return Plot("spectrum", caption, 0.35 + 1.6 * rows, lambda canvas: _draw_spectra(canvas, peaks, rows))


def _draw_spectra(canvas: Canvas, peaks: tuple[SpectrumPeak, ...], rows: int) -> None:
    axes = [ax for row in panels(canvas, rows, 3, sharey=True, across=0.2, down=0.55) for ax in row]
    top = max((float(np.max(p.power)) for p in peaks), default=1.0) or 1.0
    several = len({p.signal for p in peaks}) > 1
    for ax, peak in zip(axes, peaks, strict=False):
        found = peak.p_value <= SURE
        ax.plot(peak.orders, peak.power / top, color=AFTER if found else BEFORE, lw=0.8)
        ax.set_xscale("log")
        ax.xaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
        ax.xaxis.set_minor_locator(NullLocator())  # small ticks would take half of the drawing
        ax.set_ylim(0, 1.12)
        name = f"A{peak.joint} {SHORT[peak.signal]}:" if several else f"A{peak.joint}: order"  # no room for both
        words = f"{name} {peak.order:g} ({SCALE['arcsec'] * peak.amplitude:.1f} arcsec), p {peak.p_value:.2g}"
        ax.axvline(peak.order, color=LIMIT if found else SOFT, lw=0.7, ls="--")
        dressed(ax, words, "waves per turn" if ax in axes[-3:] else "", "power" if ax in axes[::3] else "")
        ax.title.set_color(INK if found else SOFT)
        ax.title.set_fontsize(6.5)
    for ax in axes[len(peaks) :]:
        ax.set_visible(False)
