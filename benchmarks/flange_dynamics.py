"""Plans on machines whose force flange moves in time, over friction and carried mass:
`python benchmarks/flange_dynamics.py --plan FOLDER [--plan FOLDER].. [--cell cell.toml] [--machine believed|drawn] [--seed 0]
[--bandwidth 10] [--delay 10] [--friction 0,0.3,0.75,1.5] [--mass 2,5,10]`.

FOLDER is what `python -m ocp.plan` writes. The first row of a plan is its flange in balance at every instant. One line a machine:
highest force anywhere; most above and below the plan inside passes; seconds of contact outside of them a pass; losses of contact
in all; share of the core's area within 5 and 10 % of the wanted depth, of all asked within 10 %; the core's median, least
and most depth, and the most beside what is asked.
"""

import argparse
import time
from dataclasses import replace
from itertools import product
from pathlib import Path

import numpy as np

from ocp.data import CELL
from ocp.model.cell import Cell, read_cell
from ocp.simulate.twin.contact.flange_motion import move
from ocp.simulate.twin.contact.grinder import ContactPatches, moving_device
from ocp.simulate.twin.controller import drive
from ocp.simulate.twin.krl_text import read_program
from ocp.simulate.twin.plan_knowledge import cell_of_plan, match, read_plan_table, read_summary, recorded_input, with_hash
from ocp.simulate.twin.rehearsal import ground_depth
from ocp.simulate.twin.run import GrindingConditions, VirtualMachine, approach, make_machine, refuse_crash
from ocp.simulate.twin.touching import Touching, carried_acceleration, in_time, touch_figures
from ocp.simulate.twin.truth import draw_truth
from trajectories.blade import read_blade

HEAD = "   kg     N |  peak   over  under | outside s  losses | core 5  core 10  all 10  median  least  most  beside"


def row(machine: VirtualMachine, patches: ContactPatches, t: Touching, mass: str, friction: str) -> str:
    passes = touch_figures(t)
    depth = ground_depth(machine.blade, patches, t, machine.cell.process)
    of = depth.figures(depth.made)
    shares = "  ".join("  none" if (v := of[k]) is None else f"{100 * v:5.1f}%" for k in ("core_within_5", "core_within_10"))
    peak, over, under = (max(getattr(p, name) for p in passes) for name in ("peak", "over", "under"))
    outside, losses = np.mean([p.outside for p in passes]), sum(p.losses for p in passes)
    forces = f"{peak:5.1f} {over:6.1f} {under:6.1f} | {outside:9.2f} {losses:7d}"
    extremes = f"{of['core_median'] or np.nan:6.2f} {of['least']:6.2f} {of['most']:5.2f}  {of['most_beside'] or np.nan:5.2f}"
    depths = f"{shares}  {100 * (of['all_within_10'] or 0.0):5.1f}%  {extremes}"
    return f"{mass:>5} {friction:>5} | {forces} | {depths}"


def table(folder: Path, cell: Cell, asked: argparse.Namespace) -> None:
    """All machines on one plan."""
    begun = time.process_time()
    own = replace(cell.flange, bandwidth=None, delay=0.0, friction=0.0)
    cell, blade = replace(cell, flange=own), read_blade(cell.workpiece.stl, cell.workpiece.stl_unit)
    track = drive(read_program(folder, planned=True), cell.robot)
    plan = match(track, read_plan_table(folder))
    machine = make_machine(cell, draw_truth(cell, asked.seed, mode=asked.machine), blade, asked.seed)
    travel = refuse_crash(machine, track, plan)
    runs = np.unique(plan.run[plan.run >= 0])
    conditions = GrindingConditions(own.setpoint, cell.wheel.belt_speed)
    balanced, _, still = approach(machine, track, plan, conditions, runs)
    patches = machine.grinder.patches(balanced.moments)
    print(
        f"{folder}: {len(runs)} passes, {track.duration:.1f} s, in travel {travel:.2f} s of contact; {asked.bandwidth:g} Hz, ",
        end="",
    )
    print(f"{asked.delay:g} ms, {own.stiffness / 1e3:g} N/mm, machine {asked.machine} {asked.seed}\n{HEAD}")
    print(row(machine, patches, balanced, "in", "bal."))
    paths = machine.grinder.closing(balanced.moments, carried_acceleration(cell, track, balanced.windows), still)
    variants = list(product(asked.mass, asked.friction))
    count = len(paths)
    device = moving_device(
        machine.truth, replace(own, bandwidth=asked.bandwidth, delay=1e-3 * asked.delay), count * len(variants)
    )
    mass, friction = (np.repeat([v[k] for v in variants], count) for k in (0, 1))
    lanes = move(paths, np.tile(np.arange(count), len(variants)), replace(device, mass=mass, friction=friction))
    for k, (kg, newton) in enumerate(variants):
        t = in_time(balanced.windows, balanced.moments, still, lanes[k * count : (k + 1) * count])
        print(row(machine, patches, t, f"{kg:g}", f"{newton:g}"))
    print(f"{time.process_time() - begun:.0f} s of one core\n")


def numbers(text: str) -> list[float]:
    return [float(part) for part in text.split(",")]


def main() -> None:
    parser = argparse.ArgumentParser()
    parser.add_argument("--plan", type=Path, action="append", required=True)
    parser.add_argument("--cell", type=Path)
    parser.add_argument("--machine", choices=("believed", "drawn"), default="believed")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--bandwidth", type=float, default=10.0)
    parser.add_argument("--delay", type=float, default=10.0)
    parser.add_argument("--friction", type=numbers, default=[0.0, 0.3, 0.75, 1.5])
    parser.add_argument("--mass", type=numbers, default=[2.0, 5.0, 10.0])
    asked = parser.parse_args()
    for folder in asked.plan:
        summary, places = read_summary(folder), (folder, folder.resolve().parent, Path.cwd())
        file, known = asked.cell or cell_of_plan(summary, folder, places, CELL), recorded_input(summary, "blade")
        table(folder, read_cell(file, with_hash([place / known[0] for place in places], known[1]) if known else None), asked)


if __name__ == "__main__":
    main()
