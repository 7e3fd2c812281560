"""Sealed predictions of the worlds beside this checkout, by each method: `python benchmarks/calibration_worlds.py [folder]`."""

import csv
import sys
from pathlib import Path

import numpy as np

from ocp.calibrate.tracker import as_in
from ocp.model.cell import read_tracker_setup
from robots.calibration.evidence import choose_terms
from robots.calibration.fit import fit_campaign, learned_priors, predict_readings, predictive_covariance
from robots.calibration.layout import Choice
from robots.calibration.methods import METHODS, calibrate_by
from robots.calibration.solver import Campaign
from robots.tracker_readings import read_readings

FOLDER = Path(__file__).resolve().parents[2] / "shared" / "data" / "worlds"


def main() -> None:
    folder = Path(sys.argv[1]) if len(sys.argv) > 1 else FOLDER
    print(f"| world | {' | '.join(METHODS)} | full, max | error over predicted |")
    print("|---" * (len(METHODS) + 3) + "|")
    for world in sorted(folder.glob("tracker_*")):
        setup = read_tracker_setup(world / "cell.toml")
        readings = read_readings(world / "tracker.csv", setup.payloads, setup.instrument)
        sealed = as_in(read_readings(world / "sealed_tracker.csv", setup.payloads, setup.instrument, sealed=True), readings)
        with (world / "labels" / "sealed_tracker_truth.csv").open(newline="") as file:
            truth = 1e-3 * np.array([[float(row[f"{c}_mm"]) for c in "xyz"] for row in csv.DictReader(file)])
        campaign = Campaign(setup.robot, readings, setup.payloads, setup.instrument)
        first = fit_campaign(campaign, Choice(joints=setup.compliant_joints))
        priors = learned_priors(first)
        choice, _ = choose_terms(fit_campaign(campaign, first.choice, priors, begin=first.state))
        cells, ratio, worst = [], 0.0, 0.0
        for method in METHODS:
            fit = calibrate_by(method, campaign, choice, priors)
            points, covariance = predict_readings(fit, sealed)[0], predictive_covariance(fit, sealed)
            off = points - truth
            error = np.linalg.norm(off, axis=1)
            cells.append(f"{1e3 * error.mean():.4f}")
            if method == "full":
                squared = np.einsum("ni,ni->n", off, np.linalg.solve(covariance, off[..., None])[..., 0])
                worst, ratio = 1e3 * error.max(), float(np.sqrt(squared.mean() / 3))
        print(f"| {world.name} | {' | '.join(cells)} | {worst:.3f} | {ratio:.2f} |", flush=True)


if __name__ == "__main__":
    main()
