"""Pictures of a rehearsal: force along each line, the blade coloured by force, what the parts of the cell bring."""

import numpy as np
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.collections import PolyCollection
from matplotlib.colors import Colormap, LinearSegmentedColormap, Normalize
from numpy.typing import NDArray

from ocp.plan.report.data import PassReport
from ocp.plan.report.surface import paint_blade
from ocp.report.colours import NOT_GROUND, SIDE_COLOURS
from ocp.report.panels import dressed, keys, panels
from ocp.report.section import WIDTH, Canvas, Plot
from ocp.report.style import CURVE, RULE, SOFT, TARGET
from ocp.simulate.twin.rehearsal import PARTS, WITHIN, Rehearsal
from robots.pose import Array
from trajectories.blade import Blade

PART_COLOURS = dict(zip(PARTS, (*SIDE_COLOURS[:2], "#2f8559", "#7a5195"), strict=True))
COLUMNS = 3
# Too little is blue, too much is orange, as planned is nearly white: the two differ in lightness from it alike.
FORCE_MAP: Colormap = LinearSegmentedColormap.from_list("force", ["#1f4e79", "#6fa3cf", "#f5f3ee", "#e2924e", "#8c3a06"])
_LIGHT = np.array([0.35, 0.35, 0.87])


def lines_plot(rehearsal: Rehearsal) -> Plot:
    """Force along every line, one panel each, on the same axes."""
    count = len(np.unique(rehearsal.run))
    rows = -(-count // COLUMNS)
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


def blade_plot(rehearsal: Rehearsal, blade: Blade) -> Plot:
    """The blade from its two sides."""
    caption = "Blade from both sides, coloured by the force pressing on it; grey is not ground. White is what was planned."
    return Plot("blade", caption, 3.9, lambda canvas: _draw_blade(canvas, rehearsal, blade))


def _draw_blade(canvas: Canvas, r: Rehearsal, blade: Blade) -> None:
    passes = tuple(_pass(r, int(k)) for k in np.unique(r.run))
    painted = paint_blade(blade.vertices, blade.faces, passes)
    force = np.concatenate([p.force for p in passes])
    weight = painted.weight.sum(axis=1)
    value = (painted.weight * force[painted.waypoint]).sum(axis=1) / np.maximum(weight, 1e-12)
    goal = float(r.goal.mean())
    half = max(float(np.abs(r.force - goal).max()), WITHIN)
    norm = Normalize(goal - half, goal + half)
    axes = list(canvas.subplots(1, 2, left=0.05, right=0.75, top=0.1, bottom=0.1, across=0.2))
    axis = int(np.argmax(np.ptp(blade.vertices, axis=0)))
    toward = _facing(r, axis)
    for ax, sign in zip(axes, (1.0, -1.0), strict=True):
        _draw_side(ax, painted.vertices, painted.faces, value, weight, norm, sign * toward, axis)
    beside = axes[-1].get_position()
    bar = axes[0].figure.add_axes((1 - 0.55 / WIDTH, beside.y0 + 0.1 * beside.height, 0.012, 0.8 * beside.height))
    axes[0].figure.colorbar(ScalarMappable(norm, FORCE_MAP), cax=bar)
    bar.tick_params(length=2, labelsize=6.5)
    bar.set_title("N", fontsize=7, color=SOFT, loc="left")


def _pass(r: Rehearsal, run: int) -> PassReport:
    """A pass as the painter of the blade knows it."""
    mine = np.flatnonzero(r.run == run)
    mine = mine[np.concatenate([[True], np.diff(r.s[mine]) > 1e-7])]
    mine = mine[np.unique(np.linspace(0, len(mine) - 1, min(len(mine), 200)).round().astype(int))]
    none = np.full(len(mine), np.nan)
    side = "one" if float((r.n[mine].mean(axis=0) * r.n[0]).sum()) > 0 else "other"
    return PassReport(
        line=int(r.line[mine[0]]), side=side, p=r.p[mine], n=r.n[mine], t=r.t[mine], s=r.s[mine], force=r.force[mine],
        force_sd=none, interference=none, compliance_nn=none, removal=none, limit_ratio=none, arc=none, lateral=none, turn=none,
        tilt=np.full((len(mine), 2), np.nan), feed=none,
    )  # fmt: skip


def _facing(r: Rehearsal, axis: int) -> Array:
    """Direction (3,) square to the blade's longest axis from which most of the first pass is seen."""
    mine = r.run == r.run[0]
    toward = r.n[mine].mean(axis=0)
    toward[axis] = 0.0
    return np.asarray(toward / np.linalg.norm(toward))


def _draw_side(
    ax: Axes, vertices: Array, faces: NDArray[np.int64], value: Array, weight: Array, norm: Normalize, toward: Array, axis: int
) -> None:
    """Faces that look toward the viewer, the far ones first, shaded a little by their slope."""
    up = np.eye(3)[axis]
    right = np.cross(up, toward)
    corners = vertices[faces]
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    size = np.linalg.norm(normal, axis=1)
    normal = normal / np.maximum(size, 1e-30)[:, None]
    seen = np.flatnonzero((normal @ toward > 0) & (size > 0))
    seen = seen[np.argsort((corners[seen].mean(axis=1)) @ toward, kind="stable")]
    flat = 1e3 * np.stack([corners[seen] @ right, corners[seen] @ up], axis=-1)
    ground = weight[faces[seen]].mean(axis=1) >= 0.5
    colours = FORCE_MAP(norm(value[faces[seen]].mean(axis=1)))[:, :3]
    grey = np.array([int(NOT_GROUND[i : i + 2], 16) / 255 for i in (1, 3, 5)])
    colours = np.where(ground[:, None], colours, grey)
    light = _LIGHT[0] * right + _LIGHT[1] * up + _LIGHT[2] * toward
    shade = 0.78 + 0.22 * np.clip(normal[seen] @ light, 0, 1)
    faces_ = PolyCollection(list(flat), facecolors=colours * shade[:, None], edgecolors="face", linewidths=0.15, rasterized=True)
    ax.add_collection(faces_)
    ax.set_xlim(flat[..., 0].min(), flat[..., 0].max())
    ax.set_ylim(flat[..., 1].min(), flat[..., 1].max())
    ax.set_aspect("equal")
    ax.set_axis_off()


def parts_plot(rehearsal: Rehearsal) -> Plot:
    """What each part of the cell brings, pass after pass."""
    caption = (
        "What each part of the cell brings to the force, over the whole program in its order; numbers are lines of the blade."
    )
    return Plot("parts", caption, 2.3, lambda canvas: _draw_parts(canvas, rehearsal))


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
