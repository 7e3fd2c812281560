"""The same passes as programs of axes, of timed poses and of blended lines, on a machine whose force flange moves in time:
`python -m benchmarks.program_kinds [--keep FOLDER] [--plan FOLDER]..`.

Plans the tests' small cell (a few short lines of the bundled blade) in every kind, then rehearses these plans and those named
beside. Machine as believed but for its flange: 5 kg, 10 Hz, 10 ms, 0.3 N of friction. One line a plan: seconds of the whole; of
the way of the longest pass; highest force; seconds of contact outside of the passes proper, for each; losses of contact; the
integral of force over time along any 5 mm of a line over that of the first plan, least and most; share of the area within 10 % of
the wanted depth, least and most depth. Then force over time in the first pass, from its first newton on and back from its last.
"""

import argparse
import tempfile
from dataclasses import replace
from pathlib import Path

import numpy as np

from ocp.api import plan
from ocp.model.cell import Cell, read_cell
from ocp.simulate.twin.controller import drive
from ocp.simulate.twin.krl_text import read_program
from ocp.simulate.twin.plan_knowledge import match, read_plan_table
from ocp.simulate.twin.rehearsal import ground_depth
from ocp.simulate.twin.run import GrindingConditions, approach, make_machine
from ocp.simulate.twin.touching import Touching, touch_figures
from ocp.simulate.twin.truth import draw_truth
from robots.pose import Array
from tests.support.small_plan import small_cell
from trajectories.blade import read_blade
from trajectories.program.program import KINDS

AFTER = (25, 50, 100, 150, 200, 250, 300, 400)  # ms
WINDOW = 5e-3  # m of a line
HEAD = "plan                  s  pass s |  peak  outside  losses | along 5 mm  | all 10  least  most"


def along(t: Touching, run: int) -> tuple[Array, Array]:
    """Arc lengths m of a pass, and the integral N s of force over time from its begin to there."""
    rows = np.flatnonzero(t.windows.run == run)
    s, last = np.unique(t.windows.plan.s[rows][::-1], return_index=True)  # the plan's contact point rests where it names none
    return s, np.cumsum(t.mean[rows] * t.dt)[len(rows) - 1 - last]


def over_first(one: list[tuple[Array, Array]], first: list[tuple[Array, Array]]) -> Array:
    """Of all passes force over time along WINDOW of a line, from every place of it, over that of the first plan there."""
    found = []
    for (s, total), (own, reference) in zip(one, first, strict=True):
        begins = np.linspace(own[0], own[-1] - WINDOW, 300)
        doses = (
            np.interp(begins + WINDOW, at, sums) - np.interp(begins, at, sums) for at, sums in ((s, total), (own, reference))
        )
        found.append(np.divide(*doses))
    return np.concatenate(found)


def course(t: Touching, run: int) -> tuple[Array, Array]:
    """Force N at AFTER its first newton and before its last."""
    rows = t.windows.run == run
    force, clock = t.force[rows], t.dt * np.arange(rows.sum())
    on = np.flatnonzero(force > 1.0)
    k, m = on[0], on[-1]
    first = np.interp(1.0, force[k - 1 : k + 1], clock[k - 1 : k + 1])
    last = np.interp(-1.0, -force[m : m + 2], clock[m : m + 2])
    after = 1e-3 * np.array(AFTER)
    return np.interp(first + after, clock, force), np.interp(last - after, clock, force)


def rehearsed(folder: Path, cell: Cell, ours: bool) -> tuple[list[str], list[tuple[Array, Array]], tuple[Array, Array]]:
    """What stands left and right of the third column, what `along` says of every pass, the `course` of the first."""
    assert cell.flange is not None
    own = replace(cell.flange, bandwidth=10.0, delay=0.010, friction=0.3, carried_mass=5.0)
    cell, blade = replace(cell, flange=own), read_blade(cell.workpiece.stl, cell.workpiece.stl_unit)
    track = drive(read_program(folder, planned=ours), cell.robot)
    seen = match(track, read_plan_table(folder))
    machine = make_machine(cell, draw_truth(cell, 0, mode="believed"), blade, 0)
    runs = np.unique(seen.run[seen.run >= 0])
    t, asked, _ = approach(machine, track, seen, GrindingConditions(own.setpoint, cell.wheel.belt_speed), runs)
    passes, depth = touch_figures(t), ground_depth(blade, machine.grinder.patches(asked), t, cell.process)
    of = depth.figures(depth.made)
    longest = max(np.ptp(track.time[(seen.run == k)]) for k in runs)
    peak, outside, losses = max(p.peak for p in passes), np.mean([p.outside for p in passes]), sum(p.losses for p in passes)
    line = [
        f"{folder.name:<16} {track.duration:6.2f} {longest:7.3f} | {peak:5.2f} {outside:8.3f} {losses:7d} | ",
        f" | {100 * (of['all_within_10'] or 0.0):5.1f}% {of['least']:6.2f} {of['most']:5.2f}",
    ]
    return line, [along(t, int(k)) for k in runs], course(t, int(runs[0]))


def main() -> None:
    parser = argparse.ArgumentParser()
    parser.add_argument("--keep", type=Path)
    parser.add_argument("--plan", type=Path, action="append", default=[])
    asked = parser.parse_args()
    root = asked.keep or Path(tempfile.mkdtemp())
    file = small_cell(root)
    for kind in KINDS:
        plan(cell=file, step=2e-3, kind=kind, out=root / kind, overwrite=True)
    cell, courses, first = read_cell(file), [], []
    print(HEAD)
    for folder in [*(root / kind for kind in KINDS), *asked.plan]:
        (left, right), sums, one = rehearsed(
            folder, cell, folder not in asked.plan
        )  # those of an older version are read as anybody's
        courses.append((folder.name, one))
        first = first or sums
        doses = over_first(sums, first)
        print(f"{left}{doses.min():5.2f} {doses.max():5.2f}{right}")
    for k, words in enumerate(("after the first newton", "before the last newton")):
        print(f"\nms {words:<24}" + "".join(f"{ms:7d}" for ms in AFTER))
        for name, both in courses:
            print(f"{name:<27}" + "".join(f"{force:7.2f}" for force in both[k]))


if __name__ == "__main__":
    main()
