"""Blades and wheels placed at random in the reachable zone: each plans, or is refused with its reason.

    PYTHONPATH=. python benchmarks/placements.py [--count 20] [--seed 5]

The bundled blade with three passes a side; postures, optimal control, collisions, travel and timing are the product's.
"""

import argparse
import time
from dataclasses import replace

import numpy as np

from ocp.data import CELL
from ocp.model.cell import Cell, read_cell
from ocp.model.prepare import ContactModel, prepare_contact
from ocp.model.theta import believed_theta
from ocp.plan.clearance import CollisionScene
from ocp.plan.motion import build_motion
from ocp.plan.passes.optimise import Ground, compiled_solver, solve_passes
from ocp.plan.passes.posture import find_seeds
from ocp.plan.passes.stage import ObjectiveWeights
from ocp.plan.passes.stretches import whole_lines
from ocp.plan.paths import LaidPaths, PlanOptions, lay_paths
from ocp.shell.progress import Phases
from robots.errors import Infeasible
from robots.pose import transform_from_xyzabc


def placed(cell: Cell, rng: np.random.Generator) -> Cell:
    """The wheel anywhere in front of the robot, turned by up to 30 deg; the blade 80 mm and 30 deg off, spun freely."""
    xyz = np.array([0.0, 0.0, 0.2]) + rng.uniform(-0.08, 0.08, 3)
    abc = np.array([rng.uniform(-np.pi, np.pi), 0.0, 0.0]) + rng.uniform(-0.5, 0.5, 3)
    centre = np.array([rng.uniform(1.2, 2.0), rng.uniform(-0.8, 0.8), rng.uniform(0.5, 1.5)])
    heading = np.arctan2(centre[1], centre[0]) + rng.uniform(-0.5, 0.5)
    axis = np.array([-np.sin(heading), np.cos(heading), 0.0])
    toward = -np.array([np.cos(heading), np.sin(heading), 0.0])
    workpiece = replace(cell.workpiece, T_flange_blade=transform_from_xyzabc(xyz, abc))
    return replace(cell, workpiece=workpiece, wheel=replace(cell.wheel, centre=centre, axis=axis, contact_direction=toward))


def plan(cell: Cell, laid: LaidPaths, contact: ContactModel) -> str:
    """One line on a placement: how long the program runs, or why there is none."""
    scene = CollisionScene(cell, laid.blade.vertices)
    try:
        seeds = find_seeds(cell, scene, contact.law, laid.paths)
        ground = Ground(
            cell,
            believed_theta(cell),
            ObjectiveWeights(),
            contact.law,
            contact.cover,
            laid.blade.vertices,
            laid.cloud,
            laid.beside,
        )
        stretches = whole_lines(laid.paths, list(contact.compliance.per_pass))[0]
        solver = compiled_solver(cell, ground.law, ground.theta, ground.weights, laid.paths)
        solved = solve_passes(ground, solver, stretches, seeds).passes
        return f"planned, program of {build_motion(cell, scene, solved).duration:.0f} s"
    except Infeasible as error:
        return f"refused: {error}"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--count", type=int, default=20)
    parser.add_argument("--seed", type=int, default=5)
    arguments = parser.parse_args()
    cell = read_cell(CELL)
    cell = replace(cell, process=replace(cell.process, pass_spacing=0.02))
    assert cell.workpiece.stl is not None
    laid = lay_paths(cell, cell.workpiece.stl, PlanOptions(step=2e-3, even=False))
    contact = prepare_contact(cell, laid.blade, laid.paths, Phases())
    rng = np.random.default_rng(arguments.seed)
    planned = 0
    for k in range(arguments.count):
        start = time.perf_counter()
        line = plan(placed(cell, rng), laid, contact)
        planned += line.startswith("planned")
        print(f"{k + 1:3d}  {time.perf_counter() - start:5.1f} s  {line}", flush=True)
    print(f"{planned} of {arguments.count} planned")


if __name__ == "__main__":
    main()
