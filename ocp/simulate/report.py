"""rehearsal.html: what force a program would make on the virtual cell, where it is worst, and what brings the errors; then passes
from the air to the air: force at entry and exit, losses of contact, what is taken off."""

from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
from matplotlib.colors import Colormap, LinearSegmentedColormap
from numpy.typing import NDArray

from ocp.model.cell import Cell
from ocp.plan.report.plan_report import GroundPass
from ocp.plan.report.surface import draw_blade, paint_blade
from ocp.report.parts import Plot, Table, table
from ocp.report.plotting import Canvas, dressed, keys, panels
from ocp.report.section import Headline, Section
from ocp.report.style import CURVE, RULE, SIDE_COLOURS, SOFT, TARGET
from ocp.simulate.twin.controller import MissedParts
from ocp.simulate.twin.plan_knowledge import Matched
from ocp.simulate.twin.rehearsal import PARTS, WITHIN, GroundDepth, Rehearsal
from ocp.simulate.twin.touching import TouchFigures, Touching, touch_figures
from robots.pose import Array
from trajectories.blade import Blade

SHOWN = 0.45, 0.1  # s inside and outside of the first and the last touch that are shown
NAMES = {
    "ground_share": "asked surface with at least half of the depth",
    "core_within_5": "core within 5 %",
    "core_within_10": "core within 10 %",
    "all_within_10": "asked surface within 10 %",
    "core_median": "median depth of the core",
    "least": "least depth",
    "most": "most depth",
    "most_beside": "most depth beside the asked surface",
}
DEPTHS = 0.5, 1.5  # range of the map's colours
ENTRY = (
    "Force between blade and wheel from the air to the air: lead-in, pass and lead-out are followed whatever the plan calls "
    "them. Outside is the time in contact that the plan does not count to the pass; there the wheel grinds as well."
)
REMOVAL = (
    "Depth by the time integral of the pressure, with the virtual cell's own patch, summed over all passes, entries and exits; 1 "
    "is what even lines take at the cell's force, feed and spacing. The asked surface reaches half a line's spacing to both "
    "sides of the lines; its core lies between lines, a patch inside their ends."
)
MAP = "Depth that this machine takes along the lines, entries and exits included, over what is wanted (white)."

# Too little is blue, too much is orange, as planned is nearly white: the two differ in lightness from it alike.
FORCE_MAP: Colormap = LinearSegmentedColormap.from_list("force", ["#1f4e79", "#6fa3cf", "#f5f3ee", "#e2924e", "#8c3a06"])


@dataclass(frozen=True)
class WholePasses:
    """What the sections show: the contact of all passes, the depth, seconds of travel in which the wheel may be touched, and what
    the flange does in words."""

    touched: Touching
    depth: GroundDepth
    travel: float
    flange: str


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
    low, high = float(rehearsal.goal.min()), float(rehearsal.goal.max())
    planned = f"{f['goal_N']:.3g} N" if high - low < WITHIN else f"{low:.3g} to {high:.3g} N"
    sentence = (
        f"On {machine} the force would be {f['mean_N']:.2f} N on average with a standard deviation of {f['sd_N']:.2f} N, from "
        f"{f['min_N']:.1f} to {f['max_N']:.1f} N, where {planned} were planned; "
        f"{int(100 * f['within_1_N'])} % of the time within 1 N of that."
    )
    if f["lost"] > 0:
        sentence += f" For {100 * f['lost']:.1f} % of the time the blade does not touch the wheel."
    return Headline(good, "As planned." if good else "Not as planned.", f"{sentence} {ends_in_words(whole)}")


def rehearsal_sections(rehearsal: Rehearsal, missed: MissedParts | None, whole: WholePasses, blade: Blade) -> tuple[Section, ...]:
    """Force, entries and exits, removal, where errors come from; equal rehearsals give equal bytes."""
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
    runs = [_forward(r.s, np.flatnonzero(r.run == k)) for k in np.unique(r.run)]
    goal = float(r.goal.mean())
    half = max(float(np.abs(r.force - goal).max()), WITHIN)
    toward, force = r.n[r.run == r.run[0]].mean(axis=0), r.force[np.concatenate(runs)]
    _on_blade(canvas, blade, r, runs, toward, force, (goal - half, goal + half), "N")


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


def flange_in_words(cell: Cell) -> str:
    """How the mount of a cell was taken to move."""
    own = cell.flange
    if own is None:
        return "The mount is rigid."
    if not own.moves_in_time:
        return (
            "The cell says nothing of the force flange's own motion: it is in balance at every instant here, and nothing "
            "bounces. Give force_flange.bandwidth_hz, delay_ms and friction_N to see it move."
        )
    speed = "at once" if own.bandwidth is None else f"with {own.bandwidth:g} Hz"
    return (
        f"The force flange carries {own.carried_mass:g} kg between its stops, sets its force {speed} and {1e3 * own.delay:g} ms "
        f"late, and {own.friction:g} N of friction hold its stroke; the wheel may bounce off and be lost."
    )


def contact_figures(t: Touching, travel: float) -> dict[str, Any]:
    """The figures by the names of rehearsal.json: the worst of all passes, seconds of travel in contact, and every pass."""
    passes = touch_figures(t)
    names = {"peak": "peak_N", "outside": "outside_s", "losses": "losses", "lost": "lost_s", "over": "over_N", "under": "under_N"}
    worst = {key: max(getattr(p, name) for p in passes) for name, key in names.items()}
    rows = [{"line": p.line} | {key: asdict(p)[name] for name, key in names.items()} for p in passes]
    return worst | {"contact_in_travel_s": travel, "passes": rows}


def ends_in_words(whole: WholePasses) -> str:
    """What entries and exits make of the depth, in one sentence for the head of the page."""
    figures = whole.depth.figures(whole.depth.made)
    outside, even = max(p.outside for p in touch_figures(whole.touched)), int(100 * (figures["all_within_10"] or 0.0))
    return (
        f"Outside of the passes the wheel grinds for up to {outside:.2f} s each; {even} % of the surface about the lines lies "
        f"within 10 % of the wanted depth, its deepest place has {figures['most']:.2g} times that depth."
    )


def whole_pass_sections(whole: WholePasses, blade: Blade) -> tuple[Section, ...]:
    """Entry and exit; removal."""
    t, passes = whole.touched, touch_figures(whole.touched)
    k = max(range(len(passes)), key=lambda i: passes[i].peak)
    caption = (
        f"Line {passes[k].line}, which has the highest peak: force over time from first and to last touch. Shaded: the pass."
    )
    worst = Plot("entry", caption, 2.2, lambda canvas: _draw_ends(canvas, t, k))
    travel = f"In travel the wheel may be touched for {whole.travel:.2f} s." if whole.travel > 0 else "Nothing touches in travel."
    shown = Plot("removal", MAP, 3.9, lambda canvas: _draw_depth(canvas, whole, blade))
    return (
        Section("Entry and exit", (ENTRY, f"{whole.flange} {travel}", worst, _passes_table(passes))),
        Section("Removal", (REMOVAL, shown, _depth_table(whole.depth))),
    )


def _passes_table(passes: list[TouchFigures]) -> Table:
    rows = [
        (
            str(p.line),
            f"{p.peak:.1f}",
            f"{p.over:.1f}",
            f"{p.under:.1f}",
            f"{p.outside:.2f}",
            str(p.losses),
            f"{1e3 * p.lost:.0f}",
        )
        for p in passes
    ]
    heads = ("line", "peak, N", "over plan in the pass, N", "under, N", "contact outside, s", "losses", "for, ms")
    return table(heads, rows, text=())


def _depth_table(depth: GroundDepth) -> Table:
    plan, made = depth.figures(depth.planned), depth.figures(depth.made)

    def told(name: str, value: float | None) -> str:
        whole = name in ("core_median", "least", "most", "most_beside")
        return "none" if value is None else f"{value:.2f}" if whole else f"{100 * value:.0f} %"

    rows = [(words, told(name, plan[name]), told(name, made[name])) for name, words in NAMES.items()]
    return table(("what", "plan's forces", "this machine"), rows, text=(0,))


def _draw_ends(canvas: Canvas, t: Touching, k: int) -> None:
    """Force over time at both ends of the k-th pass."""
    run = list(dict.fromkeys(t.windows.run.tolist()))[k]
    rows = np.flatnonzero(t.windows.run == run)
    met = rows[t.touching[rows] > 0]
    axes = panels(canvas, 1, 2, across=0.3, top=0.35, bottom=0.45, sharey=True)[0]
    inside, outside = SHOWN
    for j, ax in enumerate(axes):
        at = t.time[(met if len(met) else rows)[-j]]
        low, high = (at - outside, at + inside) if j == 0 else (at - inside, at + outside)
        shown = rows[(t.time[rows] >= low) & (t.time[rows] <= high)]
        time = 1e3 * (t.time[shown] - at)
        planned = t.windows.planned[shown]
        if planned.any():
            ax.axvspan(time[planned][0], time[planned][-1], color=RULE, lw=0)
        goal = np.where(planned, t.windows.plan.force[shown], np.nan)
        ax.plot(time, goal, color=TARGET, lw=0.9)
        ax.plot(time, t.still[shown], color=SOFT, lw=0.8)
        ax.plot(time, t.force[shown], color=CURVE, lw=1.1)
        dressed(ax, "entry" if j == 0 else "exit", "ms", "N" if j == 0 else "")
    keys(axes[1], [("force", CURVE), ("in balance", SOFT), ("planned", TARGET)])


def _draw_depth(canvas: Canvas, whole: WholePasses, blade: Blade) -> None:
    t, of = whole.touched.windows, whole.touched.windows.plan
    runs = [_forward(of.s, np.flatnonzero((t.run == k) & t.planned)) for k in dict.fromkeys(t.run.tolist())]
    rows = np.concatenate(runs)
    values = whole.depth.at(of.p[rows], of.n[rows])
    _on_blade(canvas, blade, of, runs, of.n[runs[0]].mean(axis=0), values, DEPTHS, "")


def _forward(s: Array, rows: NDArray[np.int64]) -> NDArray[np.int64]:
    """Those rows of a run that go forward along s (n,) m, at most 200."""
    rows = rows[np.concatenate([[True], np.diff(s[rows]) > 1e-7])]
    return rows[np.unique(np.linspace(0, len(rows) - 1, min(len(rows), 200)).round().astype(int))]


def _on_blade(
    canvas: Canvas,
    blade: Blade,
    at: Rehearsal | Matched,
    runs: list[NDArray[np.int64]],
    toward: Array,
    values: Array,
    limits: tuple[float, float],
    unit: str,
) -> None:
    """The blade coloured by values at the rows of all runs, its side `toward` (3,) first."""
    sides = ["one" if float(at.n[rows].mean(axis=0) @ toward) > 0 else "other" for rows in runs]
    passes = [GroundPass(side, at.p[rows], at.n[rows], at.s[rows]) for side, rows in zip(sides, runs, strict=True)]
    draw_blade(canvas, paint_blade(blade.vertices, blade.faces, passes), values, limits, FORCE_MAP, toward, unit)
