"""Data set folders made with the elementary arm (no part of the product's models): tracker readings, link-side encoders."""

import csv
from dataclasses import replace
from pathlib import Path

import numpy as np

from robots.gravity import GRAVITY
from tests.support.reference_arm import elementary_weight_torques
from tests.support.simulated_campaign import EXTRA, PAYLOADS, Truth, campaign_readings, measured, random_truth

CELL = """name = "elementary"
reference_temperature_C = 20.0
[robot]
model = "kr210_r2700_extra"
stiffness_Nm_per_rad = [{stiffness}]
compliant_joints = [2, 3]
[payloads.bare]
mass_kg = 0.0
[payloads.grinder]
mass_kg = 25.0
com_mm = [10, 0, 160]
[payloads.weight]
mass_kg = 90.0
com_mm = [0, 20, 200]
[tracker]
[tracker.targets]
T1 = [150, -50, 250]
T2 = [-160, 40, 210]
T3 = [20, 170, 330]
"""
SPRINGS = "2.0e6, 3.3e6, 2.46e6, 0, 0, 0"


def write_csv(path: Path, columns: dict) -> None:
    with path.open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(columns)
        writer.writerows(zip(*columns.values(), strict=True))


def columns_of(readings, truth_points=None) -> dict:
    """Columns of tracker.csv; without points those of sealed_tracker.csv."""
    r = readings
    out: dict = {"payload": [r.payloads[k] for k in r.payload], "target": [r.targets[k] for k in r.target]}
    out |= {f"q{j + 1}_deg": np.round(np.degrees(r.q[:, j]), 7) for j in range(6)}
    out |= {f"approach{j + 1}": r.approach[:, j].astype(int) for j in range(6)}
    if truth_points is not None:
        out |= {f"{c}_mm": np.round(1e3 * truth_points[:, k], 4) for k, c in enumerate("xyz")}
    return out


def write_tracker_folder(folder: Path, seed: int, backlash: float = 0.0, joint: int = 3, n: int = 90, sealed: int = 40):
    """cell.toml, tracker.csv, sealed_tracker.csv of a new arm with play in one joint; the noise-free sealed points (m)."""
    rng = np.random.default_rng(seed)
    truth: Truth = random_truth(rng, joint_noise=4e-6)
    play = np.zeros(6)
    play[joint - 1] = backlash
    truth = replace(truth, backlash=play)
    readings = measured(truth, campaign_readings(rng, n), rng)
    asked = campaign_readings(rng, sealed)
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "cell.toml").write_text(CELL.format(stiffness=SPRINGS))
    write_csv(folder / "tracker.csv", columns_of(readings, readings.point))
    write_csv(folder / "sealed_tracker.csv", columns_of(asked))
    return truth.points(asked)


def joint_columns(seed: int, delay: float = 0.0, compliance: float = 0.0, joint: int = 2, sign: float = 1.0) -> dict:
    """joints.csv of a slow motion of joints 1 to 3: the link is `delay` late and gives under the weight of the arm; torques of
    the motor times `sign`."""
    rng = np.random.default_rng(seed)
    time = np.arange(0, 12.0, 0.01)
    rate, phase = 2 * np.pi * np.array([0.11, 0.17, 0.23, 0.05, 0.07, 0.04]), rng.uniform(0, 6, 6)
    swing, centre = np.radians([40, 25, 30, 5, 5, 5]), np.radians([0, -70, 60, 0, 30, 0])

    def motor(t):
        return centre + swing * np.sin(np.outer(t, rate) + phase)

    q, late = motor(time), motor(time - delay)
    hung = PAYLOADS["grinder"]
    tau = elementary_weight_torques(EXTRA, q, GRAVITY, hung.mass, hung.com)
    c = np.divide(1.0, [2.0e6, 3.3e6, 2.46e6, np.inf, np.inf, np.inf])
    c[joint - 1] += compliance
    link = late + c * tau + rng.normal(size=q.shape) * 5e-6 + 1e-3
    out: dict = {"run": ["a"] * len(time), "time_s": np.round(time, 4)}
    out |= {f"q{j + 1}_deg": np.round(np.degrees(q[:, j]), 7) for j in range(6)}
    out |= {f"link{j + 1}_deg": np.round(np.degrees(link[:, j]), 7) for j in range(3)}
    return out | {f"tau{j + 1}_Nm": np.round(-sign * tau[:, j] + rng.normal(size=len(time)) * 3.0, 3) for j in range(3)}


def write_joint_folder(folder: Path, seed: int, stiffness: str = SPRINGS, **options) -> None:
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "cell.toml").write_text(CELL.format(stiffness=stiffness))
    write_csv(folder / "joints.csv", joint_columns(seed, **options))
