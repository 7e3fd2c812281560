"""Long campaigns of arms that are no KUKA through `ocp.calibrate`'s function: processor seconds, phase by phase.

    python benchmarks/calibration_odd_arms.py [ARMS] [READINGS] [OUT.npz]

Each arm is a UR5 or UR10 whose d and a are drawn 0.2 to 2 times as long, whose cell gives no joint a stiffness and whose joints 2
and 3, or 2, 3 and 4, give way all the same; off by 2 mm and 2 mrad with noise of 0.3 mm, or by 0.3 mm and 0.3 mrad with 0.01 mm;
the tracker stands anywhere and the nest is 5 mm from where the cell has it. Prints a line an arm. OUT keeps what came out (state,
covariance, held-out errors, terms) of each, so that two versions of the fit can be compared digit by digit.
"""

import sys
import time
import tomllib
from dataclasses import replace
from importlib import resources
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

from ocp.calibrate.tracker import TrackerCalibration, calibrate_tracker
from ocp.shell.progress import Phases
from robots.pose import make_transform, rotation_from_abc
from robots.robot import load_robot
from robots.toml_files import toml_text
from robots.tracker_readings import Hanging
from tests.support.diagnosis_folder import columns_of, write_csv
from tests.support.simulated_campaign import Truth, campaign_readings

LOAD = Hanging(4.0, np.array([0.0, 0.02, 0.1]))
NEST = np.array([0.05, -0.03, 0.12])
KINDS = [(model, springs, noise) for model in ("ur5", "ur10") for springs in ((2, 3), (2, 3, 4)) for noise in (3e-4, 1e-5)]
HEAD = """| arm | noise mm | springs | terms found | steps | held out mm | all s | readings | fit | terms | held out | methods |
|---|---|---|---|---|---|---|---|---|---|---|---|"""


def write_campaign(folder: Path, seed: int, n: int, model: str, springs: tuple[int, ...], noise: float) -> None:
    """cell.toml, arm.toml and tracker.csv of one arm."""
    rng = np.random.default_rng(seed)
    tables = tomllib.loads((resources.files("robots") / "catalogue" / f"{model}.toml").read_text(encoding="utf-8"))
    for key in ("d_mm", "a_mm"):
        tables["geometry"][key] = (np.array(tables["geometry"][key]) * rng.uniform(0.2, 2.0, 6)).tolist()
    del tables["stiffness"]
    (folder / "arm.toml").write_text(toml_text(tables | {"name": "odd_arm"}), encoding="utf-8")
    robot = load_robot(folder / "arm.toml")
    targets = {"T1": (1e3 * NEST).tolist()}
    hung = {"tool": {"mass_kg": LOAD.mass, "com_mm": (1e3 * LOAD.com).tolist()}}
    cell = {"name": "odd", "robot": {"model": "arm.toml"}, "payloads": hung, "tracker": {"targets": targets, "target_sd_mm": 5.0}}
    (folder / "cell.toml").write_text(toml_text(cell), encoding="utf-8")
    compliance = np.zeros(6)
    compliance[np.array(springs) - 1] = rng.uniform(2e-5, 8e-5, len(springs))
    off = 2e-3 if noise > 1e-4 else 3e-4
    place = make_transform(rotation_from_abc(rng.uniform(-3, 3, 3)), rng.uniform(-3, 3, 3))
    nest = {"T1": NEST + 5e-3 * rng.normal(size=3)}
    wrong = replace(robot, mdh=robot.mdh + off * rng.normal(size=(6, 5)))
    truth = Truth(wrong, compliance, nest, place, np.zeros((6, 3)), np.zeros(6), 1e-5)
    none = np.zeros(n, np.int64)
    q = rng.uniform(-2.5, 2.5, (n, 6))
    readings = replace(campaign_readings(rng, n), q=q, target=none, targets=("T1",), payload=none, payloads=("tool",))
    columns = columns_of(readings, truth.points(readings, rng, {"tool": LOAD}) + noise * rng.normal(size=(n, 3)))
    write_csv(folder / "tracker.csv", columns)


def _kept(c: TrackerCalibration, name: str) -> dict[str, np.ndarray]:
    """What came of an arm, by names."""
    figures = [list(h.figures().values()) for h in c.held_out]
    state = np.concatenate([c.fit.state.arm, c.fit.state.nests.ravel(), c.fit.state.stations.ravel()])
    return {
        f"{name} state": state,
        f"{name} sd": c.fit.sd,
        f"{name} held out": np.array(figures),
        f"{name} methods": np.array([e.mean() for e in c.methods.error.values()]),
        f"{name} terms": np.array([[t.gain, t.sigma, t.accepted] for t in sorted(c.terms, key=lambda t: t.name)]),
    }


def main() -> None:
    arms, n = (int(a) for a in (*sys.argv[1:3], *("4", "2000")[len(sys.argv[1:3]) :]))
    kept: dict[str, np.ndarray] = {}
    print(HEAD)
    for seed in range(arms):
        model, springs, noise = KINDS[seed % len(KINDS)]
        spent: dict[str, float] = {}
        with TemporaryDirectory() as name:
            write_campaign(Path(name), seed, n, model, springs, noise)
            begin = last = time.process_time()

            def show(phase: str, done: int, total: int | None, spent: dict[str, float] = spent) -> None:
                nonlocal last
                now = time.process_time()
                spent[phase] = spent.get(phase, 0.0) + (now - last if done else 0.0)
                last = now

            c = calibrate_tracker(Path(name) / "tracker.csv", Path(name) / "cell.toml", "full", Phases(show))
            whole = time.process_time() - begin
        rms = np.sqrt(np.mean(np.concatenate([h.error for h in c.held_out if h.fold.kind == "random"]) ** 2))
        found = ", ".join(t.name for t in c.terms if t.accepted) or "none"
        parts = " | ".join(f"{spent.get(p, 0.0):.1f}" for p in ("readings", "fit", "terms", "held out", "methods"))
        lead = f"| {model} {seed} | {1e3 * noise:g} | {', '.join(map(str, springs))} | {found} | {c.fit.steps}"
        print(f"{lead} | {1e3 * rms:.4f} | {whole:.1f} | {parts} |", flush=True)
        kept |= _kept(c, str(seed))
    if len(sys.argv) > 3:
        np.savez(sys.argv[3], **kept)


if __name__ == "__main__":
    main()
