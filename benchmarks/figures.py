"""docs/figures/NAME.svg: `python -m benchmarks.figures [data|chain|contact|passes|blindtest]..`; all without a name.

data: the way of the data from files to files (docs/architecture.md). chain: what gives way between commanded
joints and force (docs/model.md). contact: pressure under the large wheel of
benchmarks/wheel_table.py. passes: lines on the bundled blade, as they are laid. blindtest: the shares in the table of
docs/blindtest.md.
"""

import re
import sys
from pathlib import Path

import matplotlib as mpl
import numpy as np
import trimesh
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from benchmarks.wheel_table import LARGE, SHAPES
from ocp.contact.wheel.cover import build_cover, default_cell
from ocp.contact.wheel.signorini import solve_force
from ocp.data import BLADE, CELL
from ocp.model.cell import read_cell
from ocp.plan.paths import PlanOptions, lay_paths

DOCS = Path(__file__).resolve().parents[1] / "docs"
BLUE, GREY, ORANGE = "#0072b2", "#999999", "#d55e00"  # told apart by everybody (Okabe and Ito)


WAYS = {
    "a plan": (
        "cell.toml, blade.stl",
        ("trajectories/blade, passes.py", "smooth surface, contact frames"),
        ("ocp/model, ocp/contact", "one function of joints and force:\nbent arm, wheel's law, blade's compliance"),
        ("ocp/plan/removal", "lines and feeds"),
        ("ocp/plan/passes", "one nonlinear program a pass"),
        ("ocp/plan/motion.py", "order, travel, collisions, timing"),
        ("trajectories/program, krl", "the program's text"),
        ("ocp/plan/readback.py, second_route.py", "text read back, force predicted again"),
        "plan/",
    ),
    "a calibration": (
        "tracker.csv, force.csv, cell.toml",
        ("robots/tracker_readings.py,\nocp/calibrate/force/log.py", "readings"),
        ("robots/calibration", "priors, least squares, outliers,\nwhat can be identified"),
        ("robots/calibration/validation.py", "errors held out"),
        ("ocp/calibrate/force", "wheel, blade, stiffness from the log:\nthe model's Jacobian in its parameters"),
        ("ocp/calibrate", "report, values with covariance"),
        "calibration/",
    ),
    "a diagnosis": (
        "tracker.csv, force.csv, joints.csv, cell.toml",
        ("ocp/diagnose/tracker, force, joints", "a channel a signal: residuals, columns\nof every effect (ocp/effects)"),
        ("ocp/diagnose/engine", "evidence of sets of effects and kernels"),
        ("ocp/diagnose/verdict", "names, place, patch, what remains"),
        ("ocp/diagnose/foresee", "promises, blind predictions,\nnext experiment"),
        ("ocp/diagnose/report", "page, corrected cell"),
        "diagnosis/",
    ),
}


def data(figure: Figure) -> None:
    figure.set_size_inches(10, 7)
    for axes, (name, (begin, *steps, end)) in zip(figure.subplots(1, 3), WAYS.items(), strict=True):
        places = np.linspace(1.0, 0.0, len(steps) + 2)
        for low, high in zip(places[1:], places[:-1], strict=True):
            arrow = {"arrowstyle": "-|>", "color": GREY, "shrinkA": 18, "shrinkB": 20}
            axes.annotate("", (0.5, low), (0.5, high), arrowprops=arrow)
        for y, file in ((places[0], begin), (places[-1], end)):
            axes.text(0.5, y, file, ha="center", va="center", weight="bold", color=BLUE)
        for y, (room, does) in zip(places[1:-1], steps, strict=True):
            box = {"boxstyle": "round,pad=0.5", "facecolor": "#eeeeee", "edgecolor": BLUE}
            axes.text(0.5, y, f"{room}\n{does}", ha="center", va="center", bbox=box, fontsize=8)
        axes.set(title=name, xlim=(0, 1), ylim=(-0.05, 1.05))
        axes.axis("off")


def spring(axes: Axes, x: float, name: str, symbol: str) -> float:
    """A spring from x on with its words; where it ends."""
    zigzag = x + np.array([0.0, 0.15, *(0.15 + 0.1 * (np.arange(6) + 0.5)), 0.85, 1.0])
    axes.plot(zigzag, [0, 0, 0.12, -0.12, 0.12, -0.12, 0.12, -0.12, 0, 0], color=BLUE)
    axes.text(x + 0.5, 0.24, name, ha="center")
    axes.text(x + 0.5, -0.34, symbol, ha="center", color=GREY, fontsize=8)
    return x + 1.0


def body(axes: Axes, x: float, name: str) -> float:
    """A rigid body from x on; where it ends."""
    axes.plot([x, x + 0.84], [0, 0], color=BLUE, zorder=0)
    axes.text(x + 0.42, 0, name, ha="center", va="center", bbox={"boxstyle": "round,pad=0.4", "facecolor": "#eeeeee"}, fontsize=9)
    return x + 0.84


def chain(figure: Figure) -> None:
    axes = figure.subplots()
    figure.set_size_inches(9, 1.6)
    x = body(axes, 0.0, "commanded\njoints q")
    for name, symbol, then in (
        ("joints", "J K⁻¹ Jᵀ f, weight", "flange"),
        ("force flange", "stroke, ± stop", "holder"),
        ("clamp, blade", "F/k, C_blade f", "contact"),
        ("cover", "d_wheel(F)", "wheel's\ncentre"),
    ):
        x = body(axes, spring(axes, x, name, symbol), then)
    axes.set(xlim=(-0.2, x + 0.2), ylim=(-0.6, 0.5))
    axes.axis("off")


def contact(figure: Figure) -> None:
    cover = build_cover(LARGE, default_cell(LARGE, 20.0))
    figure.set_size_inches(8, 3.2)
    names = ("convex 60 mm", "convex, turned", "hollow -4/m")
    solved = [solve_force(cover, 20.0, SHAPES[name]) for name in names]
    most = max(c.pressure.max() for c in solved) * 1e-3
    for axes, name, c in zip(figure.subplots(1, 3, sharey=True), names, solved, strict=True):
        picture = axes.pcolormesh(c.x * 1e3, c.y * 1e3, c.pressure * 1e-3, cmap="viridis", vmin=0, vmax=most, rasterized=True)
        axes.set(title=name, xlabel="along the belt, mm", xlim=(-12, 12), aspect="equal")
        axes.set_facecolor(mpl.colormaps["viridis"](0.0))
    figure.axes[0].set_ylabel("over the width, mm")
    figure.colorbar(picture, ax=figure.axes, label="kPa at 20 N")


def passes(figure: Figure) -> None:
    mesh = trimesh.load(BLADE)
    figure.set_size_inches(6, 4)
    paths = lay_paths(read_cell(CELL), BLADE, PlanOptions()).paths
    for axes, side in zip(figure.subplots(1, 2, sharey=True), ("convex", "concave"), strict=True):
        lines = [path for path in paths if path.side == side]
        normal = np.concatenate([path.n for path in lines]).mean(axis=0)
        across = int(np.argmin(abs(normal[:2])))
        toward = np.sign(normal[1 - across])
        seen = mesh.face_normals[:, 1 - across] * toward > 0
        x, z = mesh.vertices[:, across], mesh.vertices[:, 2]  # mm, as the file has them
        shade = np.abs(mesh.face_normals[seen, 1 - across])
        axes.tripcolor(x, z, mesh.faces[seen], facecolors=shade, cmap="Greys", vmin=0, vmax=4, rasterized=True)
        for path in lines:
            axes.plot(path.p[:, across] * 1e3, path.p[:, 2] * 1e3, color=BLUE, linewidth=0.8)
        axes.set(title=f"{side}: {len(lines)} lines", aspect="equal", xlabel="mm")
    figure.axes[0].set_ylabel("span, mm")


def blindtest(figure: Figure) -> None:
    figure.set_size_inches(8, 4.2)
    cells = r"\| ([^|]*) \| ([^|]*) \| " + r" \| ".join([r"([\d.]+) % \((\d+)-(\d+)\), (\d+)"] * 3) + r" \|"
    rows = re.findall(cells, (DOCS / "blindtest.md").read_text(encoding="utf-8"))
    for axes, kind, name in zip(figure.subplots(1, 3, sharey=True), range(3), ("tracker", "force log", "both"), strict=True):
        for k, row in enumerate(rows):
            share, low, high = (float(v) for v in row[2 + 4 * kind : 5 + 4 * kind])
            axes.plot([low, high], [k, k], color=GREY)
            axes.plot(share, k, "o", color=BLUE)
            for target in re.findall(r"[\d.]+", row[1]):
                axes.plot(float(target), k, "|", color=ORANGE, markersize=12)
        axes.set(title=name, xlim=(-2, 102), xlabel="%")
        axes.grid(axis="x", color="#dddddd")
    figure.axes[0].set_yticks(range(len(rows)), [f"{row[0]} ({row[1]})" for row in rows])
    figure.axes[0].invert_yaxis()


DRAWN = {"data": data, "chain": chain, "contact": contact, "passes": passes, "blindtest": blindtest}

if __name__ == "__main__":
    mpl.rcParams.update({"svg.hashsalt": "grindplan", "svg.fonttype": "path", "font.size": 9})
    (DOCS / "figures").mkdir(exist_ok=True)
    for wanted in sys.argv[1:] or DRAWN:
        figure = Figure(layout="constrained")
        DRAWN[wanted](figure)
        figure.savefig(DOCS / "figures" / f"{wanted}.svg", metadata={"Date": None}, dpi=110)
