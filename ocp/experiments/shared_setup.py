"""What all virtual robots share: the cell with one kind of mount, passes for the ladder and for the test, what gives way.

The ladder's passes register wheel and blade, the test's hold the working points: no force is judged where it was fitted.
"""

from dataclasses import dataclass, replace

import numpy as np

from ocp.contact.wheel.cover import Cover
from ocp.contact.wheel.law import WheelLaw
from ocp.model.blade_gap import SurfaceCloud
from ocp.model.cell import Cell
from ocp.model.prepare import prepare_contact
from ocp.model.theta import registered
from ocp.plan.clearance.collision import CollisionScene
from ocp.plan.passes.optimise import Ground, PassWorker, SolvedPass
from ocp.plan.passes.posture import Seed, find_seeds
from ocp.plan.passes.stage import ObjectiveWeights
from ocp.plan.paths import lay_paths
from ocp.plan.planning import PlanOptions
from ocp.shell.progress import Phases
from robots.calibration.store import Calibration
from robots.errors import BadInput
from robots.pose import Array
from trajectories.blade import Blade
from trajectories.passes import BladePath

STEP = 4e-3  # m between waypoints: forces vary slowly along a pass, docs/experiments.md
POINTS = 20  # working points, PHYSICS 5
MOUNTS = ("flange", "rigid")


@dataclass(frozen=True)
class Course:
    """A cell with one mount and its passes: those of the ladder first (`ladder` of them), then those of the test.

    seeds and compliance (n, 3) m/N of every pass; law and cover of the wheel as believed.
    """

    cell: Cell
    blade: Blade
    cloud: SurfaceCloud
    law: WheelLaw
    cover: Cover
    paths: list[BladePath]
    seeds: list[list[Seed]]
    compliance: list[Array]
    ladder: int

    @property
    def tested(self) -> list[int]:
        """Passes that hold the working points."""
        return list(range(self.ladder, len(self.paths)))


def lay_course(cell: Cell, mount: str, phases: Phases) -> Course:
    """Passes of `cell` on its flange ("flange") or without one ("rigid"), the calibration of the cell left out.

    Raises BadInput: no blade, no flange for the flange's course; Infeasible: passes out of reach.
    """
    stl = cell.workpiece.stl
    if stl is None:
        raise BadInput(f"{cell.path}: no blade; name it as workpiece.stl")
    if mount == "flange" and cell.flange is None:
        raise BadInput(f"{cell.path}: no [force_flange]; the flange's experiment needs it, or run with --mount rigid")
    cell = replace(cell, calibration=None, flange=cell.flange if mount == "flange" else None)
    cell, _ = registered(cell)
    laid = lay_paths(cell, stl, PlanOptions(step=STEP))
    contact = prepare_contact(cell, laid.blade, laid.paths, phases)
    chosen = _spread(laid.paths)
    paths = [laid.paths[k] for k in chosen]
    with phases.phase(f"postures, {mount}"):
        seeds = find_seeds(cell, CollisionScene(cell, laid.blade.vertices), contact.law, paths)
    compliance = [np.asarray(contact.compliance.per_pass[k]) for k in chosen]
    return Course(cell, laid.blade, laid.cloud, contact.law, contact.cover, paths, seeds, compliance, len(chosen) // 2)


def _spread(paths: list[BladePath]) -> list[int]:
    """Of each side a pass in the first half for the ladder and one in the second for the test; ladder passes first."""
    sides = list(dict.fromkeys(path.side for path in paths))
    ladder, test = [], []
    for side in sides:
        of_side = [k for k, path in enumerate(paths) if path.side == side]
        ladder.append(of_side[len(of_side) // 4])
        test.append(of_side[(3 * len(of_side)) // 4])
    return ladder + test


def compensated(course: Course, calibration: Calibration | None, which: list[int]) -> list[SolvedPass]:
    """Joints that hold the process force on passes `which`, as the planner finds them with this calibration.

    The planner's preference for postures of less uncertain force is left out: it takes 4 s of building for every calibration.
    A calibrated stiffness scales forces of the wheel's law and of the cover exactly, so that neither is made anew.
    Raises Infeasible where a pass has no sound solution.
    """
    cell, theta = registered(replace(course.cell, calibration=calibration))
    softer = course.cover.softer(cell.wheel.cover_modulus)
    law = replace(course.law, geometry=replace(course.law.geometry, modulus=cell.wheel.cover_modulus))
    stiffer = cell.workpiece.youngs_modulus / course.cell.workpiece.youngs_modulus
    worker = PassWorker(Ground(cell, theta, ObjectiveWeights(), law, softer, course.blade.vertices, course.cloud))
    return [worker.solve(course.paths[k], course.seeds[k], course.compliance[k] / stiffer) for k in which]


def working_points(solved: list[SolvedPass]) -> list[Array]:
    """Waypoints (indices) of each pass: `POINTS` in all, evenly spread over the passes, their ends left out."""
    each = [len(part) for part in np.array_split(np.arange(POINTS), len(solved))]
    return [np.round(np.linspace(1, len(s.problem.path.s) - 2, n)).astype(int) for s, n in zip(solved, each, strict=True)]
