"""Ours, pybotics, FIGAROH and plain scipy on the same simulated tracker readings: seconds and held-out error.

`python benchmarks/calibration_peers.py [--robots 3] [--peers DIR]` from the repository root. The peers are no dependencies
of the product and do not share one environment (pybotics wants numpy 1). Each has a folder of its own in DIR:

    python3.11 -m venv /tmp/peers/pybotics && /tmp/peers/pybotics/bin/pip install pybotics==3.1.2
    python3.11 -m venv /tmp/peers/figaroh && /tmp/peers/figaroh/bin/pip install figaroh==1.0.2
"""

import argparse
import os
import subprocess
import tempfile
import time
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np
from calibration_peer_runs import WAYS
from calibration_real import readings_of
from scipy.optimize import least_squares

from robots.calibration.fit import fit_campaign, located, predict_readings, robust_motion
from robots.calibration.layout import Choice, Priors, build_layout, moved, nominal_state
from robots.calibration.noise import Noise, reading_covariance
from robots.calibration.residuals import residuals
from robots.calibration.solver import Campaign
from robots.kinematics import forward
from robots.pose import Array, transform_from_xyzabc
from robots.robot import load_robot
from robots.tracker_readings import Instrument, Nest, Readings

POSES, FRESH = 50, 200
DEVIATION = 3e-4  # m and rad, sd of each of the 30 MD-H numbers and of the reflector's place
NEST = np.array([0.1, 0.05, 0.2])  # m in the flange frame, as believed
TRACKER = transform_from_xyzabc(np.array([4.0, 1.0, -1.0]), np.radians([90.0, 1.0, -2.0]))  # base as the tracker sees it
CHOICE = Choice(joints=())


class Case:
    """One simulated robot: campaign of POSES readings, FRESH readings without noise, start common to all."""

    def __init__(self, seed: int) -> None:
        rng = np.random.default_rng(seed)
        self.robot = load_robot("kr210_r2700_extra")
        true = replace(self.robot, mdh=self.robot.mdh + rng.normal(0.0, DEVIATION, (6, 5)))
        nest = NEST + rng.normal(0.0, DEVIATION, 3)

        def seen(count: int) -> Readings:
            q = rng.uniform(self.robot.q_min, self.robot.q_max, (count, 6))
            T = TRACKER @ forward(true, q)
            return readings_of(Path("simulated"), q, T[:, :3, :3] @ nest + T[:, :3, 3])

        exact, self.fresh = seen(POSES), seen(FRESH)
        self.instrument = Instrument(nests={"reflector": Nest(6, NEST)})
        covariance = reading_covariance(exact, self.instrument, Noise(0.0), np.zeros((POSES, 3, 6)))
        noise = (np.linalg.cholesky(covariance) @ rng.normal(size=(POSES, 3, 1)))[..., 0]
        self.campaign = Campaign(self.robot, replace(exact, point=exact.point + noise), {}, self.instrument)
        T = forward(self.robot, exact.q)
        believed = T[:, :3, :3] @ NEST + T[:, :3, 3]
        self.near_base = robust_motion(self.campaign.readings.point, believed)[0]  # tracker to nearly the base, for the peers

    def errors(self, predicted: Array, moved_to_base: bool = False) -> Array:
        """Distances (FRESH,) mm from the truth."""
        true = self.fresh.point
        if moved_to_base:
            true = true @ self.near_base[:3, :3].T + self.near_base[:3, 3]
        return np.asarray(1e3 * np.linalg.norm(predicted - true, axis=1))


Row = tuple[float, float, int, float, float, str]  # wall and processor s, unknowns, mean and largest error mm, note


def clock() -> Array:
    """Wall and processor seconds."""
    return np.array([time.perf_counter(), time.process_time()])


def ours(case: Case) -> Row:
    """The product: robust fit of 39 unknowns with priors, covariance, and no start given."""
    began = clock()
    fit = fit_campaign(case.campaign, CHOICE)
    wall, processor = clock() - began
    e = case.errors(predict_readings(fit, case.fresh)[0])
    return wall, processor, fit.layout.size, e.mean(), e.max(), f"{fit.steps} steps, covariance included"


def finite_differences(case: Case, method: str) -> Row:
    """The same unknowns without priors or weights: scipy's least_squares, numerical Jacobian, our vectorised kinematics."""
    c = case.campaign
    began = clock()
    start = located(c, nominal_state(c.robot, c.readings, c.payloads, c.instrument, CHOICE))
    layout = build_layout(c.robot, c.readings, c.instrument, CHOICE, Priors())

    def misfit(x: Array) -> Array:
        return residuals(c.robot, c.readings, c.instrument, moved(layout, start, layout.scale * x)).ravel()

    found = least_squares(misfit, np.zeros(layout.size), method=method)
    wall, processor = clock() - began
    e = 1e3 * np.linalg.norm(residuals(c.robot, case.fresh, c.instrument, moved(layout, start, layout.scale * found.x)), axis=1)
    return wall, processor, layout.size, e.mean(), e.max(), f"{found.nfev} evaluations without the Jacobian's"


def peer(case: Case, way: str, folder: Path) -> Row | str:
    """A peer in its own environment; a sentence where it cannot run."""
    name, _ = WAYS[way]
    python = folder / name / "bin" / "python"
    if not python.exists():
        return f"not installed ({python} is absent)"
    with tempfile.TemporaryDirectory() as place:
        source, target = Path(place) / "data.npz", Path(place) / "answer.npz"
        T, readings, robot = case.near_base, case.campaign.readings, case.robot
        np.savez(
            source,
            mdh=robot.mdh,
            joints=robot.sign * readings.q,
            point=readings.point @ T[:3, :3].T + T[:3, 3],
            nest=NEST,
            fresh=robot.sign * case.fresh.q,
        )
        script = Path(__file__).with_name("calibration_peer_runs.py")
        done = subprocess.run([python, script, way, source, target], capture_output=True, text=True)
        if done.returncode:
            return f"failed: {done.stderr.strip().splitlines()[-1]}"
        answer = np.load(target)
        e = case.errors(answer["predicted"], True)
        note = f"{answer['version']}: {answer['note']}"
        wall, processor = answer["seconds"].tolist()
        return wall, processor, int(answer["unknowns"]), e.mean(), e.max(), note


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--robots", type=int, default=3)
    parser.add_argument("--peers", type=Path, default=Path("/tmp/peers"))
    options = parser.parse_args()
    cases = [Case(seed) for seed in range(options.robots)]
    print(f"{POSES} poses, {FRESH} fresh ones, {len(cases)} robots; sd {DEVIATION:g} m and rad; load {os.getloadavg()[0]:.1f}")
    print(f"First fit of the process, functions compiled: {ours(cases[0])[0]:.2f} s. Medians of seconds, means of mean errors:")
    print("| way | wall s | processor s | unknowns | mean mm | largest mm | of the last robot |\n" + "|---" * 7 + "|")
    ways: dict[str, Callable[[Case], Row | str]] = {
        "ours": ours,
        "scipy lm, finite differences": lambda case: finite_differences(case, "lm"),
        "scipy trf, finite differences": lambda case: finite_differences(case, "trf"),
    }
    ways |= {way: partial(peer, way=way, folder=options.peers) for way in WAYS}
    for label, run in ways.items():
        found = [run(case) for case in cases]
        told = [r for r in found if isinstance(r, str)]
        if told:
            print(f"| {label} | {told[0]} |")
            continue
        wall, processor, unknowns, mean, largest, note = zip(*found, strict=True)
        seconds = f"{np.median(wall):.3f} | {np.median(processor):.3f}"
        print(f"| {label} | {seconds} | {unknowns[-1]} | {np.mean(mean):.4f} | {np.max(largest):.3f} | {note[-1]} |", flush=True)


if __name__ == "__main__":
    main()
