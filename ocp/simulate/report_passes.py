"""Sections of rehearsal.html on passes from the air to the air: force at entry and exit, losses of contact, what is taken off."""

from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
from matplotlib.colors import Colormap, LinearSegmentedColormap
from numpy.typing import NDArray

from ocp.model.cell import Cell
from ocp.plan.report.surface import GroundPass, draw_blade, paint_blade
from ocp.report.parts import Plot, Table, table
from ocp.report.plotting import Canvas, dressed, keys, panels
from ocp.report.section import Section
from ocp.report.style import CURVE, RULE, SOFT, TARGET
from ocp.simulate.twin.ground_depth import GroundDepth
from ocp.simulate.twin.touching import TouchFigures, Touching, touch_figures
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
        _shade(ax, time, t.windows.planned[shown])
        goal = np.where(t.windows.planned[shown], t.windows.plan.force[shown], np.nan)
        ax.plot(time, goal, color=TARGET, lw=0.9)
        ax.plot(time, t.still[shown], color=SOFT, lw=0.8)
        ax.plot(time, t.force[shown], color=CURVE, lw=1.1)
        dressed(ax, "entry" if j == 0 else "exit", "ms", "N" if j == 0 else "")
    keys(axes[1], [("force", CURVE), ("in balance", SOFT), ("planned", TARGET)])


def _shade(ax: Any, time: NDArray[np.float64], planned: NDArray[np.bool_]) -> None:
    if planned.any():
        ax.axvspan(time[planned][0], time[planned][-1], color=RULE, lw=0)


def _draw_depth(canvas: Canvas, whole: WholePasses, blade: Blade) -> None:
    t, of = whole.touched.windows, whole.touched.windows.plan
    rows = []
    for k in dict.fromkeys(t.run.tolist()):
        mine = np.flatnonzero((t.run == k) & t.planned)
        mine = mine[np.concatenate([[True], np.diff(of.s[mine]) > 1e-7])]
        rows.append(mine[np.unique(np.linspace(0, len(mine) - 1, min(len(mine), 200)).round().astype(int))])
    first = of.n[rows[0]].mean(axis=0)
    side = ["one" if float(of.n[mine].mean(axis=0) @ first) > 0 else "other" for mine in rows]
    passes = [GroundPass(name, of.p[mine], of.n[mine], of.s[mine]) for name, mine in zip(side, rows, strict=True)]
    values = whole.depth.at(np.concatenate([of.p[mine] for mine in rows]), np.concatenate([of.n[mine] for mine in rows]))
    draw_blade(canvas, paint_blade(blade.vertices, blade.faces, passes), values, DEPTHS, FORCE_MAP, first, "")
