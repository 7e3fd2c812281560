"""Pictures of where the gap lies: vectors in the workspace, split by approach, errors along the log, on the blade."""

from typing import Any

import numpy as np

from ocp.calibrate.report.maps import exaggeration, round_number
from ocp.calibrate.report.view import in_base
from ocp.diagnose.tracker.channel import TrackerChannel
from ocp.diagnose.verdict.answer import SCALE, SignalGap
from ocp.report.parts import Plot
from ocp.report.plotting import Canvas, dots, dressed, keys, panels, reach, running_median
from ocp.report.style import AFTER, BEFORE, COLOUR_MAP, INK, RULE, SIDE_COLOURS, SOFT
from robots.pose import Array

_ROW = 2.35
MINUS = SIDE_COLOURS[1]


def vectors_plot(gap: SignalGap) -> Plot:
    """Residual vectors in the workspace, before and after."""
    caption = (
        "What is left of the tracker's readings (measured less predicted), base frame, drawn longer by the factor given. Above: "
        "the believed robot refitted; below: with the named effects. Neighbours that point the same way are a pattern; arrows "
        "without order are noise."
    )
    return Plot("vectors", caption, 4.9, lambda canvas: _draw_vectors(canvas, gap))


def _draw_vectors(canvas: Canvas, gap: SignalGap) -> None:
    axes = panels(canvas, 2, 2, across=0.55, down=0.6)
    before, after = gap.baseline, gap.corrected
    assert isinstance(before, TrackerChannel) and isinstance(after, TrackerChannel)
    factor = 0.0
    for row, (when, channel, colour) in zip(
        axes, (("believed robot", before, BEFORE), ("with the effects", after, AFTER)), strict=True
    ):
        S = channel.fit.state.stations[channel.readings.station]
        point = in_base(channel.fit.linear.point - S[:, :3, 3], S)
        vectors = in_base(channel.gap(), S)
        kept = channel.fit.weight > 0.1
        factor = factor or exaggeration(point, vectors[kept])  # one scale, so that both can be compared
        for ax, (name, i, j) in zip(row, (("from above", 1, 0), ("from the side", 0, 2)), strict=True):
            ax.quiver(
                *(1e3 * point[kept][:, k] for k in (i, j)), *(1e3 * factor * vectors[kept][:, k] for k in (i, j)),
                angles="xy", scale_units="xy", scale=1, width=0.0028, headwidth=3.5, headlength=4, headaxislength=3.6,
                color=colour, rasterized=kept.sum() > 1500,
            )  # fmt: skip
            dots(ax, np.array([0.0]), np.array([0.0]), INK, 4, marker="s")
            ax.annotate("base", (0, 0), (4, 3), textcoords="offset points", fontsize=6, color=SOFT)
            ax.set_aspect("equal", adjustable="datalim")
            dressed(ax, f"{when}, {name}, {factor:.0f} times", f"{'xyz'[i]}, mm", f"{'xyz'[j]}, mm", grid="both")
            if i == 1:
                ax.invert_xaxis()  # y grows to the left where x goes up
            low, high = ax.get_xlim()
            size = round_number(max(0.1 * abs(high - low) / factor, 1e-4))
            share = factor * size / abs(high - low)
            ax.plot([0.98 - share, 0.98], [0.03, 0.03], transform=ax.transAxes, color=INK, lw=1.2, solid_capstyle="butt")
            ax.text(0.98, 0.05, f"{size:g} mm", transform=ax.transAxes, fontsize=6.5, ha="right", va="bottom", color=INK)


def along_joints(gap: SignalGap, before: bool = True) -> tuple[Array, Array, Array | None]:
    """Gap (n, 6) in the signal's unit along the way on which each joint carries what is measured, nan where it does not; joint
    angles (n, 6) rad; approach (n, 6) or None."""
    channel = gap.baseline if before else gap.corrected
    c = channel.conditions
    assert c.d_joints is not None
    way = np.linalg.norm(c.d_joints, axis=1)
    far = way > 0.05 * way.max()
    along = np.einsum("nk,nkj->nj", channel.gap(), c.d_joints) / np.where(far, way, 1.0)
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
    return Plot(f"hysteresis-{gap.name}", caption, 3.6, lambda canvas: _draw_hysteresis(canvas, gap, joint))


def _draw_hysteresis(canvas: Canvas, gap: SignalGap, joint: int) -> None:
    axes = [ax for row in panels(canvas, 2, 3, top=0.36, sharey=True, across=0.2, down=0.55) for ax in row]
    along, q, approach = along_joints(gap)
    limit = reach(along[np.isfinite(along)])
    for j, ax in enumerate(axes):
        known = np.isfinite(along[:, j])
        x, y = np.degrees(q[:, j]), np.clip(along[:, j], -limit, limit)
        sides = [(known, AFTER)] if approach is None else [
            (known & (approach[:, j] > 0), AFTER), (known & (approach[:, j] < 0), MINUS), (known & (approach[:, j] == 0), BEFORE)
        ]  # fmt: skip
        for rows, colour in sides:
            if rows.any():
                dots(ax, x[rows], y[rows], colour, 2.0)
                ax.plot(*running_median(x[rows], y[rows], bins=12), color=colour, lw=1.3)
        ax.axhline(0, color=RULE, lw=0.8, zorder=0)
        ax.set_ylim(-1.05 * limit, 1.05 * limit)
        title = f"A{j + 1}" + ("" if known.any() else ": not measured")
        dressed(ax, title, "deg" if j > 2 else "", gap.unit if j % 3 == 0 else "")
        if j + 1 == joint:
            for side in ("left", "bottom", "top", "right"):
                ax.spines[side].set(visible=True, color=INK, linewidth=1.2)
    if approach is not None:
        keys(axes[2], [("came from below (+)", AFTER), ("from above (−)", MINUS)], top=1.1)


def log_plot(gap: SignalGap) -> Plot:
    """Errors of a log in the order it was recorded, before and after."""
    caption = (
        f"The gap of the {'link-side encoders' if gap.name == 'joint' else 'force readings'} in the order of the recording: grey "
        "before, blue with the named effects."
    )
    c = gap.baseline.conditions
    joints = _joints_of(gap) if gap.name == "joint" else [0]
    return Plot(f"log-{gap.name}", caption, 0.5 + 1.15 * len(joints), lambda canvas: _draw_log(canvas, gap, joints, c.time))


def _joints_of(gap: SignalGap) -> list[int]:
    there = gap.baseline.conditions.d_joints
    return [] if there is None else [j for j in range(1, 7) if np.any(there[:, :, j - 1])]


def _draw_log(canvas: Canvas, gap: SignalGap, joints: list[int], time: Array | None) -> None:
    axes = [row[0] for row in panels(canvas, len(joints), 1, down=0.38, bottom=0.36)]
    scale = SCALE[gap.unit]
    before, after = (scale * channel.gap()[:, 0] for channel in (gap.baseline, gap.corrected))
    there = gap.baseline.conditions.d_joints
    run = gap.baseline.conditions.run
    for ax, j in zip(axes, joints, strict=True):
        rows = np.arange(len(before)) if j == 0 or there is None else np.flatnonzero(there[:, 0, j - 1])
        one_run = time is not None and (run is None or len(np.unique(run)) == 1)
        x = time[rows] if one_run and time is not None else np.arange(len(rows))
        limit = reach(before[rows])
        for values, colour in ((before, BEFORE), (after, AFTER)):
            dots(ax, x, np.clip(values[rows], -limit, limit), colour, 1.2)
        ax.set_ylim(-1.05 * limit, 1.05 * limit)
        ax.axhline(0, color=RULE, lw=0.8, zorder=0)
        dressed(ax, f"joint {j}" if j else "", ("s" if one_run else "reading") if j == joints[-1] else "", gap.unit)


def blade_plot(gap: SignalGap) -> Plot:
    """Force errors over the blade: along the lines, before and after."""
    caption = (
        "The force gap on the blade: every run along its line, coloured by measured less predicted force. A pattern that repeats "
        "from run to run belongs to the blade or the path, one that drifts from run to run to wheel or sensor."
    )
    return Plot("blade", caption, _ROW, lambda canvas: _draw_blade(canvas, gap))


def _draw_blade(canvas: Canvas, gap: SignalGap) -> None:
    axes = panels(canvas, 1, 2, right=0.65, sharey=True, across=0.2)[0]
    c = gap.baseline.conditions
    s = c.s if c.s is not None else np.arange(len(c.q)) * 1e-3
    group = c.run if c.run is not None else c.line if c.line is not None else np.zeros(len(c.q), int)
    contact = np.ones(len(c.q), bool) if c.contact is None else np.asarray(c.contact, bool)
    limit = reach(gap.baseline.gap()[contact, 0])
    image: Any = None
    for ax, (title, channel) in zip(axes, (("before", gap.baseline), ("with the effects", gap.corrected)), strict=True):
        values = np.clip(channel.gap()[contact, 0], -limit, limit)
        image = ax.scatter(
            1e3 * s[contact], group[contact], c=values, s=3, marker="s", linewidths=0, cmap=COLOUR_MAP, vmin=-limit, vmax=limit,
            rasterized=True,
        )  # fmt: skip
        dressed(ax, title, "along the line, mm", "run" if title == "before" else "", grid="")
        ax.invert_yaxis() if title == "before" else None
    bar = axes[-1].inset_axes((1.04, 0.0, 0.035, 1.0))
    canvas.figure.colorbar(image, cax=bar)
    bar.tick_params(length=2, labelsize=6, colors=SOFT)
    bar.set_title("N", fontsize=6.5, color=SOFT)
