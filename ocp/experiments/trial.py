"""One virtual robot through the experiments: positions by each method, force at the working points after each step."""

import tempfile
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from ocp.experiments.course import Course, compensated
from ocp.experiments.forces import Machine, registered_by_ladder, working_forces
from ocp.experiments.positions import measured_positions
from ocp.plan.passes.optimise import SolvedPass
from ocp.simulate.twin.arm.arm import make_arm
from ocp.simulate.twin.contact import make_grinder
from ocp.simulate.twin.truth.truth import draw_truth
from robots.errors import Infeasible
from robots.pose import Array

STEPS = ("nothing calibrated", "robot only", "everything", "oracle")


@dataclass(frozen=True)
class Trial:
    """What one robot gave. positions mm: distance at each fresh pose, by method ("before" among them; "oracle": the full model
    fitted to 400 readings without noise). force N: true force at the working points by "mount/step", read: what the sensor
    shows. failed: steps without a sound plan, "mount/step" to the reason."""

    seed: int
    positions: dict[str, Array]
    force: dict[str, Array]
    read: dict[str, Array]
    failed: dict[str, str] = field(default_factory=dict)


def run_trial(courses: dict[str, Course], nominal: dict[str, list[SolvedPass]], seed: int, poses: int) -> Trial:
    """Robot number `seed` on every course (by mount); `nominal`: joints of the tested passes without any calibration."""
    course = next(iter(courses.values()))
    rng = np.random.default_rng([seed, 2])
    truth = draw_truth(course.cell, seed)
    arm = make_arm(course.cell, truth)
    with tempfile.TemporaryDirectory() as folder:
        found = measured_positions(course.cell, truth, arm, poses, Path(folder))
    force: dict[str, Array] = {}
    read: dict[str, Array] = {}
    failed: dict[str, str] = {}
    for mount, on in courses.items():
        machine = Machine(truth, arm, make_grinder(on.cell, truth, on.blade))
        force[f"{mount}/{STEPS[0]}"], read[f"{mount}/{STEPS[0]}"] = working_forces(on, machine, nominal[mount], rng)
        for step in STEPS[1:]:
            calibration = found.oracle if step == "oracle" else found.calibration
            try:
                if step != "robot only":
                    calibration = registered_by_ladder(on, machine, calibration, mount, rng, noise=step != "oracle")
                solved = compensated(on, calibration, on.tested)
            except Infeasible as error:
                failed[f"{mount}/{step}"] = str(error)
                continue
            force[f"{mount}/{step}"], read[f"{mount}/{step}"] = working_forces(on, machine, solved, rng)
    return Trial(seed, found.errors, force, read, failed)
