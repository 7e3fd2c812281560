"""The Python interface: plan, plan_night, choose_poses, calibrate, simulate, diagnose, judge_measurement, update, blindtest.

Here: the functions that the commands call, under one roof, with what they return. Not here: anything of a command line, and
anything that is not in the rooms of these names. Lengths are metres, angles radians, forces newtons; `progress` is called
with phase, steps done, steps in all. docs/examples has one numbered example for each.
"""

from ocp.blindtest.interface import BlindtestResult, blindtest
from ocp.calibrate.files import CalibrationResult
from ocp.calibrate.interface import calibrate
from ocp.diagnose.answering import DiagnosisResult
from ocp.diagnose.interface import diagnose, judge_measurement
from ocp.plan.files import PlanResult
from ocp.plan.interface import plan
from ocp.plan.night import NightResult, plan_night
from ocp.poses.files import PosesResult
from ocp.poses.interface import choose_poses
from ocp.shell.progress import Progress
from ocp.simulate.interface import SimulationResult, simulate
from ocp.update.files import UpdateResult
from ocp.update.interface import update
from robots.errors import BadInput, Infeasible

__all__ = [
    "BadInput",
    "BlindtestResult",
    "CalibrationResult",
    "DiagnosisResult",
    "Infeasible",
    "NightResult",
    "PlanResult",
    "PosesResult",
    "Progress",
    "SimulationResult",
    "UpdateResult",
    "blindtest",
    "calibrate",
    "choose_poses",
    "diagnose",
    "judge_measurement",
    "plan",
    "plan_night",
    "simulate",
    "update",
]
