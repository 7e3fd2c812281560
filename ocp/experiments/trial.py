"""Virtual robots through the experiments, on many cores: positions by each method, force after each step.

Each robot that is done is kept, so that a broken run goes on where it stopped.
"""

import json
import tempfile
from collections.abc import Sequence
from contextlib import nullcontext
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from ocp.calibrate.interface import tracker_calibration
from ocp.calibrate.tracker import TrackerCalibration, calibrate_tracker
from ocp.experiments.grinding import (
    Course,
    VirtualContact,
    VirtualRobot,
    compensated,
    lay_course,
    registered_by_ladder,
    virtual_contact,
    working_forces,
)
from ocp.model.cell import Cell
from ocp.plan.passes.optimise import FILES, SolvedPass
from ocp.shell.cache import code_hash, content_key, flattened, keep, rebuilt, recall
from ocp.shell.executor import Hands, carried_out
from ocp.shell.processes import cores, nothing, workers
from ocp.shell.progress import Phases
from ocp.simulate.twin.arm import VirtualArm, make_arm
from ocp.simulate.twin.contact.grinder import make_grinder
from ocp.simulate.twin.tracker import TrackerCampaign, TrackerLog, random_design, tracker_world, true_points
from ocp.simulate.twin.truth import Truth, draw_truth
from robots.calibration.fit import Fit, fit_campaign, predict_readings
from robots.calibration.layout import Choice
from robots.calibration.methods import METHODS, calibrate_by
from robots.calibration.residuals import residuals
from robots.calibration.store import Calibration
from robots.errors import Infeasible
from robots.pose import Array
from robots.tracker_readings import read_readings

FRESH = 20  # poses, as in the paper's Table 2
ORACLE = 400  # readings
_DESIGN = 7  # stream of the random postures beside the truth's


def measured_positions(
    cell: Cell, truth: Truth, arm: VirtualArm, poses: int, folder: Path
) -> tuple[dict[str, Array], Calibration, Calibration]:
    """Measure `poses` random postures of the virtual robot, calibrate by each method, judge on fresh postures.

    Errors (20,) mm of fresh poses by method; "before": the believed arm in its own base, "placed": with the tracker's frame and
    nests fitted, which hides a part; "oracle". Then the calibration of method full and the oracle's.

    Data pass through files in `folder`, as a user's do. Raises BadInput, Infeasible of the calibration.
    """
    rng = np.random.default_rng(np.random.SeedSequence(truth.seed, spawn_key=(_DESIGN,)))
    fresh = random_design(cell, rng, FRESH, repeats=0, warm_up=0.0)
    points = true_points(truth, cell, arm, fresh.moments, fresh.targets)
    campaign = random_design(cell, rng, poses, repeats=0, warm_up=0.0)
    tracker_world(folder, cell, truth, TrackerLog(campaign, fresh))
    made = calibrate_tracker(folder / "tracker.csv", folder / "cell.toml", "full", Phases())
    best = _oracle(cell, truth, random_design(cell, rng, ORACLE, repeats=0, warm_up=0.0), made, folder / "oracle")
    assert made.sealed is not None
    measured, setup = replace(made.sealed, point=points), made.setup
    errors = {}
    places = np.array([truth.nests[name] for name in measured.targets])
    known = replace(made.believed, stations=truth.T_tracker_base[None], nests=places)
    for name, state in (("before", known), ("placed", made.believed)):
        off = residuals(setup.robot, measured, setup.instrument, state)
        errors[name] = 1e3 * np.linalg.norm(off[:, :3], axis=1)
    for method in METHODS:
        fit = made.fit if method == "full" else calibrate_by(method, made.fit.campaign, made.fit.choice, made.fit.priors)
        errors[method] = _error(fit, made, points)
    errors["oracle"] = _error(best.fit, best, points)
    return errors, tracker_calibration(made, []), tracker_calibration(best, [])


def _oracle(cell: Cell, truth: Truth, campaign: TrackerCampaign, made: TrackerCalibration, folder: Path) -> TrackerCalibration:
    """`made` with a fit to `ORACLE` readings without outliers, all six springs in it."""
    tracker_world(folder, cell, replace(truth, outliers=0.0), TrackerLog(campaign, None))
    readings = read_readings(folder / "tracker.csv", made.setup.payloads, made.setup.instrument)
    fit = fit_campaign(replace(made.fit.campaign, readings=readings), Choice(joints=(1, 2, 3, 4, 5, 6)), made.fit.priors)
    return replace(made, fit=fit)


def _error(fit: Fit, made: TrackerCalibration, points: Array) -> Array:
    assert made.sealed is not None
    predicted = predict_readings(fit, made.sealed)[0]
    return np.asarray(1e3 * np.linalg.norm(predicted - points, axis=1))


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


def run_trial(
    courses: dict[str, Course], nominal: dict[str, list[SolvedPass]], poses: int, contact: VirtualContact, seed: int
) -> Trial:
    """Robot number `seed` on every course (by mount); `nominal`: joints of the tested passes without any calibration; `contact`:
    of wheel and blade."""
    course = next(iter(courses.values()))
    rng = np.random.default_rng([seed, 2])
    truth = draw_truth(course.cell, seed)
    arm = make_arm(course.cell, truth)
    with tempfile.TemporaryDirectory() as folder:
        errors, full, oracle = measured_positions(course.cell, truth, arm, poses, Path(folder))
    force: dict[str, Array] = {}
    read: dict[str, Array] = {}
    failed: dict[str, str] = {}
    for mount, on in courses.items():
        machine = VirtualRobot(truth, arm, make_grinder(on.cell, truth, on.blade, contact.tables, contact.lines))
        force[f"{mount}/{STEPS[0]}"], read[f"{mount}/{STEPS[0]}"] = working_forces(on, machine, nominal[mount], rng)
        for step in STEPS[1:]:
            calibration = oracle if step == "oracle" else full
            try:
                if step != "robot only":
                    calibration = registered_by_ladder(on, machine, calibration, mount, rng, noise=step != "oracle")
                solved = compensated(on, calibration, on.tested)
            except Infeasible as error:
                failed[f"{mount}/{step}"] = str(error)
                continue
            force[f"{mount}/{step}"], read[f"{mount}/{step}"] = working_forces(on, machine, solved, rng)
    return Trial(seed, errors, force, read, failed)


def run_trials(cell: Cell, mounts: Sequence[str], seeds: Sequence[int], poses: int, hands: Hands, phases: Phases) -> list[Trial]:
    """The trials of `seeds`, in their order; those kept from before are not run again.

    Raises BadInput and Infeasible where the cell cannot be ground at all.
    """
    courses = {mount: lay_course(cell, mount, phases) for mount in mounts}
    content = {name: a for name, a in sorted(flattened(list(courses.values())).items()) if not name.endswith(FILES)}
    ground = content_key(code_hash(), poses, *(part for name, array in content.items() for part in (name, array)))
    keys = {seed: content_key(ground, seed) for seed in seeds}
    done = {seed: trial for seed, key in keys.items() if (trial := _recalled(key)) is not None}
    missing = [seed for seed in seeds if seed not in done]
    courses = {mount: replace(course, compiled=len(missing) > 1) for mount, course in courses.items()}
    state: tuple[Any, ...] = ()
    if missing:
        nominal, contact = _for_all(courses)
        state = courses, nominal, poses, contact
    with phases.phase("robots", len(seeds)) as advance:
        for _ in done:
            advance()

        hands = replace(hands, jobs=min(hands.jobs, len(missing)))
        for _, future in carried_out(run_trial, [(seed,) for seed in missing], hands, state):
            trial = future.result()
            done[trial.seed] = trial
            keep("experiment", keys[trial.seed], flattened(trial))
            advance()
    return [done[seed] for seed in seeds]


def _for_all(courses: dict[str, Course]) -> tuple[dict[str, list[SolvedPass]], VirtualContact]:
    """What all robots start from: the passes as the believed cell has them, and the contact; in two processes unless there is
    one core."""
    first = next(iter(courses.values()))
    with workers(1, nothing) if cores() > 1 else nullcontext() as pool:
        waiting = None if pool is None else pool.submit(virtual_contact, first)
        nominal = {mount: compensated(course, None, course.tested) for mount, course in courses.items()}
        return nominal, virtual_contact(first) if waiting is None else waiting.result()


def _recalled(key: str) -> Trial | None:
    entry = recall("experiment", key)
    return None if entry is None else rebuilt(Trial, entry)


def trials_json(trials: Sequence[Trial], options: dict[str, object]) -> str:
    """All numbers, for other programs."""
    known = {"options": options, "robots": [asdict(trial) for trial in trials]}
    return json.dumps(known, indent=1, default=lambda value: np.asarray(value).tolist()) + "\n"
