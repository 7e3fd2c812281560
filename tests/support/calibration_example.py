"""A small campaign made up with the planner's own arm, calibrated: what the report's tests look at."""

import csv
from dataclasses import replace
from pathlib import Path

import numpy as np

from ocp.calibrate.tracker import TrackerCalibration, calibrate_tracker
from ocp.shell.progress import Phases
from robots.calibration.reading_model import RowInputs, predict_points
from robots.pose import Array, make_transform, rotation_from_abc
from robots.robot import load_robot

CELL = """name = "example"
[robot]
model = "kr210_r2700_extra"
stiffness_Nm_per_rad = [2.0e6, 3.3e6, 2.46e6, 0.5e6, 0.35e6, 0.30e6]
compliant_joints = [2, 3]
[payloads.bare]
mass_kg = 0.0
com_mm = [0, 0, 0]
[payloads.plate]
mass_kg = 90.0
com_mm = [0, 20, 200]
[payloads.blade]
mass_kg = 25.0
com_mm = [10, 0, 160]
[workpiece]
payload = "blade"
xyz_mm = [0, 0, 200]
clamp_axis = "z"
clamp_to_mm = 10.0
[tracker]
[tracker.targets]
T1 = [150, -50, 250]
T2 = [-160, 40, 210]
"""
PAYLOADS = {"bare": (0.0, 0.0, 0.0, 0.0), "plate": (90.0, 0.0, 0.02, 0.2)}
NESTS = {"T1": (0.15, -0.05, 0.25), "T2": (-0.16, 0.04, 0.21)}
SIGMA = 25e-6  # m


SPRINGS = np.array([0.0, 0.33e-6, 0.38e-6, 0.0, 0.0, 0.0])


def write_campaign(folder: Path, poses: int = 44, seed: int = 5, springs: Array = SPRINGS) -> Path:
    """tracker.csv and cell.toml: `poses` postures, the last one read three times, one reading 3 mm off; springs (6,) rad/(N m)
    of the arm."""
    rng = np.random.default_rng(seed)
    robot = load_robot("kr210_r2700_extra")
    q = rng.uniform(np.maximum(robot.q_min, -2.5) * 0.8, np.minimum(robot.q_max, 2.5) * 0.8, (poses, 6))
    q = np.vstack([q, q[-1:], q[-1:]])
    n = len(q)
    payload, nest = rng.integers(0, 2, n), rng.integers(0, 2, n)
    payload[-3:], nest[-3:] = 1, 0
    mdh = robot.mdh + rng.normal(0, 3e-4, robot.mdh.shape)
    inputs = RowInputs(
        q=q,
        payload=np.array([list(PAYLOADS.values())[k] for k in payload]),
        load=np.zeros((n, 6)),
        load_place=np.zeros((n, 3)),
        nest=np.array([list(NESTS.values())[k] for k in nest]),
    )
    station = make_transform(rotation_from_abc([0.3, -0.1, 0.2]), [4.0, -2.0, 1.0])
    base = predict_points(robot, np.concatenate([mdh.ravel(), springs]), inputs)[0]
    point = base @ station[:3, :3].T + station[:3, 3] + rng.normal(0, SIGMA, (n, 3))
    point[7] += [0.003, 0.0, 0.0]
    columns = ["time_s", "payload", "target", *(f"q{i}_deg" for i in range(1, 7)), "x_mm", "y_mm", "z_mm", "sigma_um"]
    with (folder / "tracker.csv").open("w", newline="") as file:
        writer = csv.writer(file)
        writer.writerow(columns)
        for k in range(n):
            names = (list(PAYLOADS)[payload[k]], list(NESTS)[nest[k]])
            writer.writerow([60.0 * k, *names, *np.degrees(q[k]).round(6), *(1e3 * point[k]).round(5), 1e6 * SIGMA])
    (folder / "cell.toml").write_text(CELL)
    return folder / "tracker.csv"


def example_calibration(folder: Path, method: str = "full") -> TrackerCalibration:
    """The campaign calibrated."""
    return calibrate_tracker(write_campaign(folder), folder / "cell.toml", method, Phases())


def with_names(c: TrackerCalibration, name: str) -> TrackerCalibration:
    """The calibration with `name` for everything that a user can name."""
    fit = c.fit
    r = fit.campaign.readings
    named = {kind: tuple(f"{name}{k}" for k in range(len(getattr(r, kind)))) for kind in ("payloads", "targets")}
    readings = replace(r, **named, stations=(name,), sessions=(name,), path=Path("x.csv").with_name(name.replace("/", "")))
    campaign = replace(fit.campaign, readings=readings, robot=replace(fit.campaign.robot, title=name))
    terms = [replace(t, name=name) for t in c.terms]
    held = [replace(h, fold=replace(h.fold, name=name)) for h in c.held_out]
    return replace(c, fit=replace(fit, campaign=campaign), terms=terms, held_out=held, notices=(name,))
