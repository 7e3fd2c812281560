"""`python benchmarks/force_sd_aim.py`: what it brings to aim at a small standard deviation of the force.

Plans a few lines of the bundled blade on its cell with a made-up calibration (2e-5 m and rad of every parameter of the arm), on a
rigid mount and on the force flange, with the aim and without; prints a table; what follows from it: docs/optimal_control.md.
"""

import sys
import tempfile
from dataclasses import replace
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).parents[1]))

import ocp.plan.planning as planning
from ocp.data import CELL
from ocp.plan.passes.stage import ObjectiveWeights
from ocp.plan.paths import PlanOptions
from ocp.shell.progress import Phases
from robots.calibration.parameters import MDH_NAMES
from robots.calibration.store import Calibration, write_calibration
from robots.robot import load_robot
from tests.support.small_plan import small_cell

FLANGE = CELL.read_text().split("[force_flange]")[1].split("\n[")[0]


def made_up(folder: Path, rigid: bool) -> Path:
    """The cell with its calibration."""
    robot = load_robot("kr210_r2700_extra")
    changes = {'model = "kr210_r2700_extra"': 'model = "kr210_r2700_extra"\ncalibration = "calibration.toml"'}
    cell = small_cell(folder, changes | ({f"[force_flange]{FLANGE}": ""} if rigid else {}))
    count = len(MDH_NAMES)
    known = Calibration(robot.name, tuple(MDH_NAMES), robot.mdh.ravel(), np.diag(np.full(count, 2e-5**2)), {})
    write_calibration(folder / "calibration.toml", known)
    return cell


def main() -> None:
    print("| mount | aim | sd of the force N, mean / most | motion s |\n|---|---|---|---|")
    for rigid in (True, False):
        cell = made_up(Path(tempfile.mkdtemp()), rigid)
        for weight in (0.0, planning.FORCE_SD_WEIGHT):
            planning.objective_weights = lambda _, weight=weight: replace(ObjectiveWeights(), force_sd=weight)
            plan = planning.make_plan(cell, None, PlanOptions(step=2e-3, even=False), Phases(None))
            sd = np.concatenate([one.evaluation.force_sd for one in plan.motion.passes])
            mount, aim = "rigid" if rigid else "flange", "yes" if weight else "no"
            print(f"| {mount} | {aim} | {sd.mean():.2f} / {sd.max():.2f} | {plan.motion.duration:.1f} |", flush=True)


if __name__ == "__main__":
    main()
