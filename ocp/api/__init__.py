"""The Python interface.

Here: the functions that the commands call, under one roof, with what they return. Not here: anything of a command line, and
anything that is not in the rooms of these names. Lengths are metres, angles radians, forces newtons; `progress` is called
with phase, steps done, steps in all. docs/examples has one numbered example for each. A command's room is imported when its
function is first asked for.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

from ocp.shell.progress import Progress
from robots.errors import BadInput, Infeasible

if TYPE_CHECKING:
    from ocp.blindtest.interface import BlindtestResult, blindtest
    from ocp.calibrate.interface import CalibrationResult, calibrate
    from ocp.cell.interface import CellResult, check_cell, new_cell, show_cell
    from ocp.diagnose.answering import DiagnosisResult
    from ocp.diagnose.interface import diagnose, judge_measurement
    from ocp.plan.files import PlanResult
    from ocp.plan.interface import plan
    from ocp.plan.night import NightResult, plan_night
    from ocp.poses.interface import PosesResult, choose_poses
    from ocp.robot.interface import RobotResult, import_robot, new_robot
    from ocp.simulate.interface import SimulationResult, simulate
    from ocp.update.interface import UpdateResult, update

_PLACES = {
    "ocp.blindtest.interface": ("BlindtestResult", "blindtest"),
    "ocp.calibrate.interface": ("CalibrationResult", "calibrate"),
    "ocp.cell.interface": ("CellResult", "check_cell", "new_cell", "show_cell"),
    "ocp.diagnose.answering": ("DiagnosisResult",),
    "ocp.diagnose.interface": ("diagnose", "judge_measurement"),
    "ocp.plan.files": ("PlanResult",),
    "ocp.plan.interface": ("plan",),
    "ocp.plan.night": ("NightResult", "plan_night"),
    "ocp.poses.interface": ("PosesResult", "choose_poses"),
    "ocp.robot.interface": ("RobotResult", "import_robot", "new_robot"),
    "ocp.simulate.interface": ("SimulationResult", "simulate"),
    "ocp.update.interface": ("UpdateResult", "update"),
}
_PLACE = {name: place for place, names in _PLACES.items() for name in names}


def __getattr__(name: str) -> Any:
    """A name of `__all__`, its room imported now."""
    if name not in _PLACE:
        raise AttributeError(f"ocp.api has no {name}")
    return globals().setdefault(name, getattr(import_module(_PLACE[name]), name))


__all__ = sorted([*_PLACE, "BadInput", "Infeasible", "Progress"])
