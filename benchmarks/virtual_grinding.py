"""The figures of docs/virtual_grinding.md: `python benchmarks/virtual_grinding.py PLAN_FOLDER [cover|curves|plan]`, default all.

PLAN_FOLDER is what `python -m ocp.plan` writes for the bundled cell. Times are processor seconds of one core.
"""

import sys
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
from scipy.interpolate import CubicSpline

from ocp.contact.wheel.signorini import LocalShape, solve_force
from ocp.data import CELL
from ocp.model.cell import Cell, read_cell
from ocp.model.prepare import wheel_cover
from ocp.simulate.twin.arm import arm_moments, make_arm
from ocp.simulate.twin.contact import ContactMoments
from ocp.simulate.twin.contact.grinder import make_grinder
from ocp.simulate.twin.contact.rubber import make_rubber, press
from ocp.simulate.twin.contact.surface import gap, near, postures, wheel_on_blade
from ocp.simulate.twin.contact.table import LEVELS, Tables, depth_curves, make_tables, place_stations
from ocp.simulate.twin.contact.wheel_and_blade import blade_poses, wheel_frames
from ocp.simulate.twin.truth import Truth, draw_truth
from robots.csv_table import read_csv_table
from robots.pose import Array
from trajectories.blade import Blade, read_blade

RATE = 250.0
VECTORS = ("px_mm", "py_mm", "pz_mm", "nx", "ny", "nz", "tx", "ty", "tz", "s_mm", "feed_mm_s")
AXES = tuple(f"q{i}_deg" for i in range(1, 7))


def paraboloid(x: Array, y: Array, kxx: float, kyy: float, size: tuple[float, float]) -> Array:
    return 0.5 * (kxx * (x[:, None] ** 2 + size[0] ** 2 / 12) + kyy * (y[None, :] ** 2 + size[1] ** 2 / 12))


def cover(cell: Cell, blade: Blade) -> None:
    """Indentation, um, under 5, 20, 60 N: own cover, finer, the planner's, an endless ring, an endless flat layer."""
    wheel, own = cell.wheel, make_tables(cell, blade).rubber
    size = own.grid.dx
    shape = (wheel.cover_thickness, wheel.cover_poisson, size, own.grid.x[-1] + size / 2)
    finer = make_rubber(wheel.radius, wheel.width, *shape[:2], size / 2, shape[3])
    ring = make_rubber(wheel.radius, 4 * wheel.width, *shape)
    flat = make_rubber(100 * wheel.radius, 4 * wheel.width, *shape)
    planner = wheel_cover(cell)
    force = np.array([5.0, 20.0, 60.0])
    print(f"cell {1e3 * size:.3f} mm, {len(own.grid.x)} x {len(own.grid.y)} cells")
    print("kyy 1/m, then own | finer | planner | ring | flat layer")
    for kyy in (-8.0, 0.0, 20.0, 45.0):
        row = []
        for rubber in (own, finer, None, ring, flat):
            if rubber is None:
                row.append([1e6 * solve_force(planner, F, LocalShape(27.0, kyy)).indentation for F in force])
                continue
            grid = rubber.grid
            here = paraboloid(grid.x, grid.y, 27.0, kyy, (grid.dx, grid.dy))
            here[:, np.abs(grid.y) > wheel.width / 2] = np.inf
            row.append(1e6 * press(rubber, np.repeat(here[:, :, None], 3, axis=2), force / wheel.cover_modulus).approach)
        print(f"{kyy:6.0f}  " + " | ".join(" ".join(f"{v:7.1f}" for v in part) for part in row))


def planned(cell: Cell, truth: Truth, folder: Path) -> tuple[ContactMoments, float]:
    """The plan's passes at 250 Hz on the arm of `truth`, and the program's duration s."""
    table = read_csv_table(folder / "plan.csv", ("time_s", "line", "contact", *AXES, *VECTORS), gaps=VECTORS)
    of = table.numbers
    touching = of["contact"] > 0.5
    parts, lines, times, run = [], [], [], []
    for number, line in enumerate(dict.fromkeys(of["line"][touching])):
        rows = touching & (of["line"] == line)
        t = np.arange(of["time_s"][rows][0], of["time_s"][rows][-1], 1 / RATE)
        columns = np.column_stack([of[name][rows] for name in (*AXES, *VECTORS)])
        parts.append(CubicSpline(of["time_s"][rows], columns)(t))
        times.append(t - t[0])
        lines.append(np.full(len(t), int(line)))
        run.append(np.full(len(t), number))
    v = np.vstack(parts)
    n = len(v)
    arm = make_arm(cell, truth)
    piece = cell.tables.workpiece
    at = arm_moments(np.radians(v[:, :6]), piece.payload or "", cell.tables.reference_temperature_C)

    def unit(vector: Array) -> Array:
        return vector / np.linalg.norm(vector, axis=1, keepdims=True)

    nan = np.full(n, np.nan)
    made = ContactMoments(
        arm.flange(at),
        arm.compliance(at),
        1e-3 * v[:, 6:9],
        unit(v[:, 9:12]),
        unit(v[:, 12:15]),
        1e-3 * v[:, 15],
        np.concatenate(lines),
        nan,
        1e-3 * v[:, 16],
        np.full(n, cell.wheel.belt_speed),
        np.ones(n, bool),
        nan,
        np.concatenate(times),
        np.concatenate(run),
        np.zeros(n),
        nan,
        nan,
    )
    return made, float(of["time_s"][-1])


def curves(cell: Cell, blade: Blade, folder: Path) -> None:
    """Depth curves of a machine with registration errors against direct solutions at its own postures, um."""
    truth = draw_truth(cell, 3)
    c, _ = planned(cell, draw_truth(cell, 1, mode="believed"), folder)
    rows = np.arange(len(c.s))
    centre, axis = wheel_frames(truth, cell, c)
    at = postures(blade_poses(truth, cell, c), c.p, c.n, c.t, centre, axis, np.full(len(rows), cell.wheel.radius))
    tables = make_tables(cell, blade)
    depth, _ = depth_curves(tables, place_stations(c, rows, c.s), at.shape)
    some = np.random.default_rng(1).choice(rows, 200, replace=False)
    off = np.array([depth[k, 1:] - direct(tables, c, k, at.shape[k]) for k in some])
    print("loads, process forces:", LEVELS[1:])
    print("error um rms:", (1e6 * np.sqrt(np.mean(off**2, axis=0))).round(2), "max:", (1e6 * np.abs(off).max(axis=0)).round(1))


def direct(tables: Tables, c: ContactMoments, k: int, shape: Array) -> Array:
    frame, middle = wheel_on_blade(c.p[k], c.n[k], c.t[k], shape, tables.rubber.radius)
    grid = tables.rubber.grid
    here = gap(near(tables.surface, c.p[k], 0.03), frame, middle, tables.rubber.radius, grid.x, grid.y, grid.dx, grid.dy)
    return press(tables.rubber, np.repeat(here[:, :, None], len(LEVELS) - 1, axis=2), LEVELS[1:] * tables.load).approach


def plan(cell: Cell, blade: Blade, folder: Path) -> None:
    """Force of a plan on a machine without errors, on a flange and rigid, and what it costs; then on five drawn machines."""
    truth = draw_truth(cell, 1, mode="believed")
    c, duration = planned(cell, truth, folder)
    print(f"program {duration:.1f} s, in contact {len(c.s) / RATE:.1f} s, {len(c.s)} instants")
    for name, mounted in (("flange", cell), ("rigid", replace(cell, flange=None))):
        for again in ("first", "again"):
            grinder = make_grinder(mounted, truth, blade)
            before, start = len(grinder.tables.nodes), time.process_time()
            force = grinder.force(c).force
            spent, nodes = time.process_time() - start, len(grinder.tables.nodes) - before
            print(
                f"{name}, {again}: {spent:.2f} s ({duration / spent:.0f} x), {nodes} nodes, "
                f"F {force.min():.3f} .. {force.max():.3f}, mean {force.mean():.3f} N"
            )
    for seed in range(11, 16):
        drawn = draw_truth(cell, seed)
        own, _ = planned(cell, drawn, folder)
        grinder = make_grinder(cell, drawn, blade)
        before, start = len(grinder.tables.nodes), time.process_time()
        force = grinder.force(own).force
        print(
            f"drawn {seed}: {time.process_time() - start:.2f} s, {len(grinder.tables.nodes) - before} new nodes, "
            f"F {force.min():.2f} .. {force.max():.2f} N"
        )


def main(folder: Path, wanted: list[str]) -> None:
    cell = read_cell(CELL)
    blade = read_blade(cell.workpiece.stl, cell.workpiece.stl_unit)
    if not wanted or "cover" in wanted:
        cover(cell, blade)
    if not wanted or "plan" in wanted:
        plan(cell, blade, folder)
    if not wanted or "curves" in wanted:
        curves(cell, blade, folder)


if __name__ == "__main__":
    main(Path(sys.argv[1]), sys.argv[2:])
