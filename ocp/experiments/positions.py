"""Positions: a tracker campaign on a virtual robot, the four methods, and how far fresh poses are from what each predicts."""

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from ocp.calibrate.files import tracker_calibration
from ocp.calibrate.tracker import TrackerCalibration, calibrate_tracker
from ocp.model.cell import Cell
from ocp.shell.progress import Phases
from ocp.simulate.twin.arm.arm import Arm
from ocp.simulate.twin.designs import Campaign, random_design
from ocp.simulate.twin.tracker import true_points
from ocp.simulate.twin.truth.truth import Truth
from ocp.simulate.twin.worlds import tracker_world
from robots.calibration.fit import Fit, fit_campaign, predict_readings
from robots.calibration.layout import Choice
from robots.calibration.methods import METHODS, calibrate_by
from robots.calibration.residuals import residuals
from robots.calibration.store import Calibration
from robots.pose import Array
from robots.tracker_readings import read_readings

FRESH = 20  # poses, as in the paper's Table 2
ORACLE = 400  # readings
_DESIGN = 7  # stream of the random postures beside the truth's


@dataclass(frozen=True)
class Positions:
    """Errors (20,) mm of fresh poses by method; "before": the believed arm in its own base, "placed": with the tracker's frame
    and nests fitted, which hides a part; "oracle". The calibration of method full and the oracle's."""

    errors: dict[str, Array]
    calibration: Calibration
    oracle: Calibration


def measured_positions(cell: Cell, truth: Truth, arm: Arm, poses: int, folder: Path) -> Positions:
    """Measure `poses` random postures of the virtual robot, calibrate by each method, judge on fresh postures.

    Data pass through files in `folder`, as a user's do. Raises BadInput, Infeasible of the calibration.
    """
    rng = np.random.default_rng(np.random.SeedSequence(truth.seed, spawn_key=(_DESIGN,)))
    fresh = random_design(cell, rng, FRESH, repeats=0, warm_up=0.0)
    points = true_points(truth, cell, arm, fresh.moments, fresh.targets)
    campaign = random_design(cell, rng, poses, repeats=0, warm_up=0.0)
    tracker_world(cell.path, folder, truth, campaign, sealed=fresh, label=False)
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
    return Positions(errors, tracker_calibration(made, []), tracker_calibration(best, []))


def _oracle(cell: Cell, truth: Truth, campaign: Campaign, made: TrackerCalibration, folder: Path) -> TrackerCalibration:
    """`made` with a fit to `ORACLE` readings without outliers, all six springs in it."""
    tracker_world(cell.path, folder, replace(truth, outliers=0.0), campaign, label=False)
    readings = read_readings(folder / "tracker.csv", made.setup.payloads, made.setup.instrument)
    fit = fit_campaign(replace(made.fit.campaign, readings=readings), Choice(joints=(1, 2, 3, 4, 5, 6)), made.fit.priors)
    return replace(made, fit=fit)


def _error(fit: Fit, made: TrackerCalibration, points: Array) -> Array:
    assert made.sealed is not None
    predicted = predict_readings(fit, made.sealed)[0]
    return np.asarray(1e3 * np.linalg.norm(predicted - points, axis=1))
