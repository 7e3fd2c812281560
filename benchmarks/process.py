"""Evenness of the lines that are laid, before anything moves: `PYTHONPATH=. python benchmarks/process.py [blade.stl ..]`.

Bundled cell; the bundled blade, twisted.stl and rotor37.stl, spanwise and chordwise. Every line is summed at its feed and force,
going on straight for a patch's half-length at both ends as a lead-in at the same F/v would, on the patch of the wheel's middle.
First as `pass_spacing_mm` has them, then as they are laid. Last, what a turn of the wheel does to the sum of lines that are like
the middle one of twisted.stl's concave side. docs/process.md has the tables.
"""

import sys
import time
from dataclasses import replace
from pathlib import Path

import numpy as np

from ocp.data import BLADE, CELL
from ocp.model.cell import Cell, read_cell
from ocp.model.prepare import wheel_cover
from ocp.plan.paths import LaidPaths, PlanOptions, lay_paths
from ocp.plan.removal.footprint import LinePatches, Pressing, planned_patches
from ocp.plan.removal.result import Figures, SideRemoval, figures_of
from ocp.plan.removal.surface import ContactRows, core_cells, work_done
from ocp.plan.removal.wanted import programmed_work
from robots.errors import BadInput
from trajectories.passes import BladePath

BLADES = Path(__file__).resolve().parents[2] / "shared" / "data" / "blades"
ROW = 5e-4  # m


def driven(cell: Cell, place: int, path: BladePath, patches: LinePatches) -> ContactRows:
    """A path at its feed and force with what leads in and out."""
    beyond = patches.half_axes[:, 0].max()
    s = np.arange(-beyond, path.s[-1] + beyond, ROW)
    at = np.clip(s, 0.0, path.s[-1])
    p, n, t = (np.column_stack([np.interp(at, path.s, of[:, i]) for i in range(3)]) for of in (path.p, path.n, path.t))
    slide = ROW / np.interp(at, path.s, path.feed) * abs(cell.wheel.belt_speed)
    return ContactRows(np.full(len(s), place), p + (s - at)[:, None] * t, n, t, at, np.interp(at, path.s, path.force), slide)


def judged(cell: Cell, laid: LaidPaths) -> Figures:
    """The shares of plan.json for the lines as they are laid."""
    cover = wheel_cover(cell)
    known = [(path, one) for path in laid.paths if (one := planned_patches(Pressing.of(cell), cover, path)) is not None]
    parts = [driven(cell, k, *both) for k, both in enumerate(known)]
    rows = ContactRows(*(np.concatenate([getattr(one, name) for one in parts]) for name in ContactRows.__dataclass_fields__))
    paths, patches = (list(column) for column in zip(*known, strict=True))
    half, sides = [float(one.half_axes[:, 0].max()) for one in patches], []
    for one in laid.flanks:
        work = work_done(one.points.reshape(-1, 3), one.normals.reshape(-1, 3), rows, patches).reshape(one.area.shape)
        sides.append(SideRemoval(one, core_cells(one, paths, half), work / programmed_work(cell)))
    return figures_of(sides)


def main(blades: list[Path]) -> None:
    """Print the table."""
    print("| blade | lines | number | feeds mm/s | ground | core 5 % | core 10 % | all 10 % | most | laid in s |")
    print("|---|---|---|---|---|---|---|---|---|---|")
    for blade in blades:
        for direction in ("spanwise", "chordwise"):
            cell = read_cell(CELL, blade)
            cell = replace(cell, process=replace(cell.process, passes=direction))
            for even in (False, True):
                clock = time.perf_counter()
                try:
                    laid = lay_paths(cell, blade, PlanOptions(step=1e-3, even=even))
                except BadInput as error:
                    print(f"| {blade.stem} {direction} | {error} |")
                    break
                seconds, found = time.perf_counter() - clock, judged(cell, laid)
                feed = 1e3 * np.concatenate([path.feed for path in laid.paths])
                shares = (found.ground_share, found.core_within_5 or 0.0, found.core_within_10 or 0.0, found.all_within_10)
                print(
                    f"| {blade.stem} {direction} | {'as laid' if even else 'pass_spacing_mm'} | {len(laid.paths)} | "
                    f"{feed.min():.0f} to {feed.max():.0f} | {' | '.join(f'{100 * share:.0f} %' for share in shares)} | "
                    f"{found.most:.2f} | {seconds:.1f} |"
                )


def askew(blade: Path) -> None:
    """Print the unevenness, up or down, of lines alike at distances and turns."""
    cell, spacings = read_cell(CELL, blade), 1e-3 * np.array([2.0, 2.5, 3.0, 3.5, 4.0])
    lines = [path for path in lay_paths(cell, blade, PlanOptions(step=1e-3, even=False)).paths if path.side == "concave"]
    line = lines[len(lines) // 2]
    print(f"\n| {blade.stem} line {line.line}, turn deg | b mm | " + " | ".join(f"h {1e3 * h:g} mm" for h in spacings) + " |")
    print("|---|---" + len(spacings) * "|---" + "|")
    for turn in np.radians([0.0, 10.0, 20.0, 28.0]):
        patches = planned_patches(Pressing.of(cell), wheel_cover(cell), replace(line, turn=float(turn)))
        assert patches is not None
        k = len(patches.at) // 2
        told = (f"{100 * patches.unevenness(h)[k]:.1f} %" for h in spacings)
        print(f"| {np.degrees(turn):.0f} | {1e3 * patches.half_axes[k, 1]:.1f} | {' | '.join(told)} |")


if __name__ == "__main__":
    main([Path(name) for name in sys.argv[1:]] or [BLADE, BLADES / "twisted.stl", BLADES / "rotor37.stl"])
    askew(BLADES / "twisted.stl")
