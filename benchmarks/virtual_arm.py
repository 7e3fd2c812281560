"""Figures of docs/virtual_arm.md: speed, agreement, machines, what calibrations leave.

`python benchmarks/virtual_arm.py [cell.toml]`; without a cell the bundled one. About half a minute on one core.
"""

import csv
import sys
import tempfile
import time
from pathlib import Path

import numpy as np

from ocp.calibrate.tracker import as_in
from ocp.model.cell import Cell, read_cell, read_tracker_setup
from ocp.simulate.twin.arm import arm_moments, make_arm
from ocp.simulate.twin.tracker import TrackerLog, random_design, sealed_design, tracker_world, write_tracker_truth
from ocp.simulate.twin.truth import draw_truth
from robots.calibration.fit import fit_campaign, learned_priors, predict_readings
from robots.calibration.layout import Choice
from robots.calibration.reading_model import RowInputs, predict_points
from robots.calibration.solver import Campaign
from robots.tracker_readings import read_readings

BUNDLED = Path(__file__).resolve().parents[1] / "ocp" / "data" / "cell.toml"
LOW, HIGH = np.radians([-90, -120, -20, -170, -115, -170]), np.radians([90, -20, 140, 170, 115, 170])
WORLDS, MACHINES = 20, 100


def statics(cell: Cell) -> None:
    truth, n = draw_truth(cell, 1, mode="believed"), 20_000
    arm, q = make_arm(cell, truth), np.random.default_rng(0).uniform(LOW, HIGH, (n, 6))
    name = max(cell.tables.payloads, key=lambda k: cell.tables.payloads[k].mass_kg)
    for label, path in (("random", q), ("along a path", np.linspace(q[0], q[1], n))):
        start = time.perf_counter()
        settled = arm.settled(arm_moments(path, name, cell.tables.reference_temperature_C))
        seconds = time.perf_counter() - start
        print(f"{n} postures, {label}: {seconds:.2f} s, {settled.steps / n:.2f} steps each")
    mass, com = truth.payloads[name]
    believed = np.concatenate([truth.mdh.ravel(), np.divide(truth.bends, truth.stiffness)])
    rows = RowInputs(q, np.tile([mass, *com], (n, 1)), np.zeros((n, 6)), np.zeros((n, 3)), np.zeros((n, 3)))
    off = arm.links(arm_moments(q, name, 20.0))[:, 6, :3, 3] - predict_points(cell.robot, believed, rows)[0]
    print(f"{mass:g} kg, no errors, against the planner's model: at most {1e9 * np.abs(off).max():.0f} nm")


def machines(cell: Cell) -> None:
    q = np.random.default_rng(0).uniform(LOW, HIGH, (60, 6))
    m, tool = arm_moments(q, next(iter(cell.tables.payloads)), cell.tables.reference_temperature_C), np.array([0, 0, 0.2, 1.0])
    right = make_arm(cell, draw_truth(cell, 0, mode="believed")).flange(m) @ tool
    error = [
        1e3 * np.linalg.norm(make_arm(cell, draw_truth(cell, s)).flange(m) @ tool - right, axis=1).mean() for s in range(MACHINES)
    ]
    print(f"uncalibrated, {MACHINES} machines, mm: mean {np.mean(error):.2f}, {min(error):.2f} to {max(error):.2f}")


def calibrations(path: Path, folder: Path) -> None:
    for bends, joints in (("believed", (2, 3)), ("all", (2, 3, 4, 5, 6)), ("all", (2, 3))):
        means, worst, took = [], [], 0.0
        for seed in range(WORLDS):
            start = time.perf_counter()
            world(path, folder, 1000 + seed, bends)
            took += time.perf_counter() - start
            error = sealed_error(folder, joints)
            means.append(1e3 * error.mean())
            worst.append(1e3 * error.max())
        print(
            f"{WORLDS} worlds, weight bends {bends}, springs fitted {joints}: mean {np.mean(means):.4f} mm "
            f"({min(means):.4f} to {max(means):.4f}), worst point {max(worst):.3f}; a world is made in {took / WORLDS:.2f} s"
        )


def world(path: Path, folder: Path, seed: int, bends: str) -> None:
    cell, rng = read_cell(path), np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(102,)))
    truth = draw_truth(cell, seed, weight_bends=bends)
    log = TrackerLog(random_design(cell, rng), sealed_design(cell, rng))
    tracker_world(folder, cell, truth, log)
    write_tracker_truth(folder, cell, truth, make_arm(cell, truth), log.sealed)


def sealed_error(folder: Path, joints: tuple[int, ...]) -> np.ndarray:
    setup = read_tracker_setup(folder / "cell.toml")
    readings = read_readings(folder / "tracker.csv", setup.payloads, setup.instrument)
    sealed = as_in(read_readings(folder / "sealed_tracker.csv", setup.payloads, setup.instrument, sealed=True), readings)
    first = fit_campaign(Campaign(setup.robot, readings, setup.payloads, setup.instrument), Choice(joints=joints))
    fit = fit_campaign(first.campaign, first.choice, learned_priors(first), begin=first.state)
    with (folder / "labels" / "sealed_tracker_truth.csv").open(newline="") as file:
        exact = 1e-3 * np.array([[float(row[f"{c}_mm"]) for c in "xyz"] for row in csv.DictReader(file)])
    return np.linalg.norm(predict_readings(fit, sealed)[0] - exact, axis=1)


def main() -> None:
    path = Path(sys.argv[1]) if len(sys.argv) > 1 else BUNDLED
    cell = read_cell(path)
    statics(cell)
    machines(cell)
    with tempfile.TemporaryDirectory() as folder:
        calibrations(path, Path(folder))


if __name__ == "__main__":
    main()
