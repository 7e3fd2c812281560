"""rehearsal.html: what force a program would make on the virtual cell, where it is worst, and what brings the errors."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ocp.plan.report.surface import GroundPass, draw_blade, paint_blade
from ocp.report.parts import Plot, Table, table
from ocp.report.plotting import Canvas, dressed, keys, panels
from ocp.report.report import Report
from ocp.report.section import Headline, Section
from ocp.report.style import CURVE, RULE, SIDE_COLOURS, SOFT, TARGET
from ocp.simulate.report_passes import FORCE_MAP, WholePasses, ends_in_words, whole_pass_sections
from ocp.simulate.twin.controller import MissedParts
from ocp.simulate.twin.rehearsal import PARTS, WITHIN, Rehearsal
from trajectories.blade import Blade

KIND = "Rehearsal on a virtual cell"
GOOD = 0.95  # share of samples within 1 N from which the page is green
WORDS = {
    "arm": "the arm stands elsewhere",
    "wheel": "the wheel stands elsewhere",
    "blade": "the blade is held elsewhere",
    "contact": "stiffness, friction, the flange's motion, planted effects",
}
PART_COLOURS = dict(zip(PARTS, (*SIDE_COLOURS[:2], "#2f8559", "#7a5195"), strict=True))
COLUMNS = 3
BLADE = "Blade from both sides, coloured by the force pressing on it; grey is not ground. White is what was planned."
BROUGHT = "What each part of the cell brings to the force, over the whole program in its order; numbers are lines of the blade."


def rehearsal_headline(rehearsal: Rehearsal, whole: WholePasses, machine: str) -> Headline:
    """Whether the program would grind as planned inside its passes, in figures, and what it does outside of them. `machine`: what
    it was run on, in words."""
    f = rehearsal.figures
    good = f["within_1_N"] >= GOOD
    sentence = (
        f"On {machine} the force would be {f['mean_N']:.2f} N on average with a standard deviation of {f['sd_N']:.2f} N, from "
        f"{f['min_N']:.1f} to {f['max_N']:.1f} N, where {f['goal_N']:.3g} N were planned; "
        f"{int(100 * f['within_1_N'])} % of the time within 1 N."
    )
    if f["lost"] > 0:
        sentence += f" For {100 * f['lost']:.1f} % of the time the blade does not touch the wheel."
    return Headline(good, "As planned." if good else "Not as planned.", f"{sentence} {ends_in_words(whole)}")


def write_rehearsal_page(
    rehearsal: Rehearsal,
    missed: MissedParts | None,
    whole: WholePasses,
    blade: Blade,
    title: str,
    machine: str,
    notices: Sequence[str],
    path: Path,
) -> None:
    """Write the page; equal rehearsals give equal bytes. Raises OSError where the file cannot be written."""
    Report(
        KIND, title, rehearsal_headline(rehearsal, whole, machine), notices, _sections(rehearsal, missed, whole, blade)
    ).write_page(path)


def _sections(rehearsal: Rehearsal, missed: MissedParts | None, whole: WholePasses, blade: Blade) -> tuple[Section, ...]:
    intro = (
        "The programs were read from their files and driven on a virtual cell that shares no code with the planner's model. The "
        "force shown is the true one between blade and wheel, not what the sensor reads."
    )
    parts = (
        "The error of the force is followed along the chain: the flange stands where the plan did not expect it (arm), then the "
        "wheel and the blade stand elsewhere than the frames of the program say; each by its share of the overlap times the "
        "stiffness of the whole chain. What is left is of the contact: cover, blade and flange, friction, what was planted."
    )
    parts_plot = Plot("parts", BROUGHT, 2.3, lambda canvas: _draw_parts(canvas, rehearsal))
    return (
        Section("Force on the blade", (intro, Plot("blade", BLADE, 3.9, lambda canvas: _draw_blade(canvas, rehearsal, blade)))),
        Section("Force along each line", (_lines_plot(rehearsal),)),
        *whole_pass_sections(whole, blade),
        Section("Where the errors come from", (parts, parts_plot, _parts_table(rehearsal))),
        Section("Worst places", (_worst_table(rehearsal),)),
        *([] if missed is None else [Section("If the controller misses the parts of its times", _missed_parts(missed))]),
    )


def missed_parts_figures(missed: MissedParts) -> dict[str, float]:
    """What happens where PARTs are missed, by the names of rehearsal.json."""
    return {
        "share": missed.share,
        "axes_deg": float(np.degrees(missed.axes)),
        "along_mm": 1e3 * missed.along,
        "aside_mm": 1e3 * missed.aside,
        "speed_share": missed.speed,
    }


def _missed_parts(missed: MissedParts) -> tuple[str, Table]:
    intro = (
        "Of a time block only END is exact on a controller; the parts are met as well as can be. Blocks that grind, driven with "
        f"every part missed at random by up to {100 * missed.share:.0f} %: the largest differences to the plan. The force "
        "follows what lies off the way, the removal the feed."
    )
    rows = [
        ("an axis lags by", f"{np.degrees(missed.axes):.3f} deg"),
        ("the flange lags along its way by", f"{1e3 * missed.along:.3f} mm"),
        ("it leaves its way by", f"{1e6 * missed.aside:.1f} um"),
        ("its speed differs by", f"{100 * missed.speed:.1f} %"),
    ]
    return intro, table(("what", "at most"), rows, text=(0,))


def _parts_table(rehearsal: Rehearsal) -> Table:
    figures = rehearsal.figures
    mean = rehearsal.parts.mean(axis=0)
    rows = [(name, WORDS[name], f"{mean[k]:+.2f}", f"{figures[f'rms_{name}_N']:.2f}") for k, name in enumerate(PARTS)]
    error = rehearsal.force - rehearsal.goal
    rows.append(("together", "", f"{error.mean():+.2f}", f"{figures['rms_error_N']:.2f}"))
    return table(("part", "what it means", "mean, N", "rms, N"), rows, text=(0, 1))


def _worst_table(rehearsal: Rehearsal) -> Table:
    rows = []
    for p in rehearsal.worst:
        place = (str(p.line), f"{1e3 * p.s:.1f}", "{:.1f}, {:.1f}, {:.1f}".format(*(1e3 * p.p)))
        rows.append((*place, f"{p.force:.1f}", *(f"{p.parts[name]:+.1f}" for name in PARTS), p.cause))
    columns = ("line", "s, mm", "x, y, z of the blade, mm", "force, N", *(f"{name}, N" for name in PARTS), "mostly")
    return table(columns, rows, text=(2, 4 + len(PARTS)))


def _lines_plot(rehearsal: Rehearsal) -> Plot:
    """Force along every line, one panel each, on the same axes."""
    rows = -(-len(np.unique(rehearsal.run)) // COLUMNS)
    caption = (
        f"True force over the way along the line, in the order of the program. Shaded: within {WITHIN:g} N of what was planned "
        "(orange). All panels share their axes."
    )
    return Plot("lines", caption, 0.5 + 1.0 * rows, lambda canvas: _draw_lines(canvas, rehearsal, rows))


def _draw_lines(canvas: Canvas, r: Rehearsal, rows: int) -> None:
    axes = [ax for row in panels(canvas, rows, COLUMNS, across=0.22, down=0.3, sharex=True, sharey=True) for ax in row]
    runs = np.unique(r.run)
    low, high = float(min(r.force.min(), r.goal.min() - 1.5)), float(max(r.force.max(), r.goal.max() + 1.5))
    margin = 0.06 * (high - low)
    for k, ax in enumerate(axes):
        if k >= len(runs):
            ax.set_visible(False)
            continue
        mine = r.run == runs[k]
        s = 1e3 * r.s[mine]
        ax.fill_between(s, r.goal[mine] - WITHIN, r.goal[mine] + WITHIN, color=RULE, lw=0)
        ax.plot(s, r.goal[mine], color=TARGET, lw=0.7)
        ax.plot(s, r.force[mine], color=CURVE, lw=1.1)
        ax.set_ylim(low - margin, high + margin)
        last = k + COLUMNS >= len(runs)
        dressed(ax, f"line {int(r.line[mine][0])}", "mm" if last else "", "N" if k % COLUMNS == 0 else "")
        ax.tick_params(labelbottom=last)


def _draw_blade(canvas: Canvas, r: Rehearsal, blade: Blade) -> None:
    runs = [_places(r, int(k)) for k in np.unique(r.run)]
    side = ["one" if float((r.n[rows].mean(axis=0) * r.n[0]).sum()) > 0 else "other" for rows in runs]
    passes = [GroundPass(name, r.p[rows], r.n[rows], r.s[rows]) for name, rows in zip(side, runs, strict=True)]
    goal = float(r.goal.mean())
    half = max(float(np.abs(r.force - goal).max()), WITHIN)
    painted, toward = paint_blade(blade.vertices, blade.faces, passes), r.n[r.run == r.run[0]].mean(axis=0)
    draw_blade(canvas, painted, r.force[np.concatenate(runs)], (goal - half, goal + half), FORCE_MAP, toward, "N")


def _places(r: Rehearsal, run: int) -> NDArray[np.int64]:
    """Rows of a run that go forward, at most 200."""
    mine = np.flatnonzero(r.run == run)
    mine = mine[np.concatenate([[True], np.diff(r.s[mine]) > 1e-7])]
    return mine[np.unique(np.linspace(0, len(mine) - 1, min(len(mine), 200)).round().astype(int))]


def _draw_parts(canvas: Canvas, r: Rehearsal) -> None:
    ax = panels(canvas, 1, 1, top=0.3, bottom=0.35)[0][0]
    runs = np.unique(r.run)
    start = 0.0
    middles = []
    for k in runs:
        mine = np.flatnonzero(r.run == k)
        mine = mine[:: max(1, len(mine) // 120)]
        s = start + 1e3 * (r.s[mine] - r.s[mine[0]])
        for j, name in enumerate(PARTS):
            ax.plot(s, r.parts[mine, j], color=PART_COLOURS[name], lw=1.0)
        ax.axvline(s[-1], color=RULE, lw=0.5, zorder=0)
        middles.append(0.5 * (s[0] + s[-1]))
        start = float(s[-1])
    ax.axhline(0, color=SOFT, lw=0.5, zorder=0)
    ax.set_xlim(0, start)
    ax.set_xticks(middles, [str(int(r.line[r.run == k][0])) for k in runs])
    dressed(ax, "", "line", "N")
    keys(ax, [(name, PART_COLOURS[name]) for name in PARTS])
