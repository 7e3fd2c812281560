"""Chosen poses against random ones on simulated campaigns: how wrong a calibrated arm still is at the wheel.

    PYTHONPATH=. python benchmarks/poses.py [--cell cell.toml] [--robots 40] [--seed 1]

Every robot has errors in all 30 MD-H parameters (sd 0.3 mm, 0.3 mrad: about 1.2 mm at the tool), springs off by 20 %, nests off
by 1 mm, axes that repeat within 10 urad and a tracker with the cell's noise. Its readings, two a pose, are fitted by the product
(`robots/calibration/fit.py`). The error is that of the blade's contact point in the grinding zone, as noise-free readings of the
nests there carry it; told is its mean over postures and robots. Random poses are drawn anywhere among the free and visible, with
a random nest and payload each.
"""

import argparse
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from ocp.data import CELL
from ocp.poses.planning import Design, PoseOptions, PosePlan, make_poses
from ocp.shell.progress import Phases
from robots.calibration.fit import fit_campaign
from robots.calibration.layout import Choice, State, nominal_state
from robots.calibration.noise import Noise, reading_covariance
from robots.calibration.observability import carried_point
from robots.calibration.pose_choice import choose
from robots.calibration.residuals import residuals
from robots.calibration.solver import Campaign
from robots.kinematics import link_frames
from robots.pose import Array, apply, make_transform
from robots.tracker_readings import Readings, planned_readings

COUNTS = (12, 16, 20, 30, 40, 60, 80)
HIGHEST = 80
JOINTS = 1e-5  # rad


def drawn(plan: PosePlan, rng: np.random.Generator) -> State:
    """A robot of the kind described above, with its nests and a tracker set up by hand."""
    setup = plan.setup
    choice = Choice(joints=setup.compliant_joints)
    state = nominal_state(setup.robot, plan.design.readings, setup.payloads, setup.instrument, choice)
    arm = state.arm.copy()
    arm[:30] += rng.normal(0, 3e-4, 30)
    arm[30:] *= 1 + 0.2 * rng.uniform(-1, 1, 6)
    R = Rotation.from_rotvec(rng.normal(0, 0.3, 3)).as_matrix()
    station = make_transform(R, -R @ plan.tracker)
    nests = state.nests + rng.normal(0, 1e-3, state.nests.shape)
    return replace(state, arm=arm, nests=nests, stations=station[None])


def seen(plan: PosePlan, truth: State, readings: Readings) -> Readings:
    """Readings with the points that `truth` puts them at."""
    empty = replace(readings, point=np.zeros_like(readings.point))
    return replace(readings, point=-residuals(plan.setup.robot, empty, plan.setup.instrument, truth))


def measured(plan: PosePlan, truth: State, chosen: Array, rng: np.random.Generator) -> Readings:
    """Two noisy readings of every chosen candidate."""
    commanded = plan.design.readings.take(np.repeat(chosen, 2))
    wobbling = replace(commanded, q=commanded.q + rng.normal(0, JOINTS, commanded.q.shape))
    exact = seen(plan, truth, wobbling)
    covariance = reading_covariance(exact, plan.setup.instrument, Noise(0.0), np.zeros((len(exact), 3, 6)))
    noise = np.linalg.cholesky(covariance) @ rng.normal(0, 1, (len(exact), 3, 1))
    return replace(commanded, point=exact.point + noise[..., 0])


def held_out(plan: PosePlan, truth: State) -> Readings:
    """Noise-free readings of all nests in the grinding zone, with the grinding payload."""
    design, zone = plan.design, plan.zone
    k, n = len(design.readings.targets), len(zone.q)
    mounted = plan.setup.tables.workpiece.payload if plan.setup.tables.workpiece else None
    payload = design.readings.payloads.index(mounted) if mounted in design.readings.payloads else 0
    nests, like = np.repeat(np.arange(k), n), design.readings
    rows = planned_readings(np.tile(zone.q, (k, 1)), nests, like.targets, np.full(k * n, payload), like.payloads)
    return seen(plan, truth, rows)


def error(plan: PosePlan, truth: State, chosen: Array, rng: np.random.Generator) -> float:
    """Mean error (m) in the grinding zone after calibrating on the chosen candidates."""
    setup = plan.setup
    campaign = Campaign(setup.robot, measured(plan, truth, chosen, rng), setup.payloads, setup.instrument)
    fit = fit_campaign(campaign, Choice(joints=setup.compliant_joints), noise=Noise(JOINTS))
    return blade_error(plan, truth, fit.state)


def blade_error(plan: PosePlan, truth: State, found: State) -> float:
    """Mean distance (m) in the zone between the blade's contact point as `found` predicts it and as it is."""
    readings, setup = held_out(plan, truth), plan.setup
    k, n = len(readings.targets), len(plan.zone.q)
    off = residuals(setup.robot, readings, setup.instrument, found).reshape(k, n, 3).swapaxes(0, 1)
    places = readings.point.reshape(k, n, 3).swapaxes(0, 1)
    base = apply(link_frames(setup.robot, plan.zone.q)[:, 6], plan.zone.point)
    blade = apply(truth.stations[0], base)
    moved = [carried_point(p, b) @ o.ravel() for p, b, o in zip(places, blade, off, strict=True)]
    return float(np.linalg.norm(moved, axis=1).mean())


def uncalibrated(plan: PosePlan, truth: State) -> float:
    """Mean error (m) of the nominal arm in the zone, with nests and tracker known: what calibration starts from."""
    nominal = nominal_state(
        plan.setup.robot,
        plan.design.readings,
        plan.setup.payloads,
        plan.setup.instrument,
        Choice(joints=plan.setup.compliant_joints),
    )
    nominal = replace(nominal, nests=truth.nests, stations=truth.stations)
    return blade_error(plan, truth, nominal)


def at_random(design: Design, near: Array, count: int, rng: np.random.Generator) -> Array:
    """`count` candidates in different postures that were drawn anywhere."""
    anywhere = np.flatnonzero(~near[design.posture])
    postures = rng.choice(np.unique(design.posture[anywhere]), count, replace=False)
    return np.array([rng.choice(np.flatnonzero(design.posture == p)) for p in postures])


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--cell", type=Path, default=CELL)
    parser.add_argument("--robots", type=int, default=40)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--criteria", nargs="*", default=["zone", "O1"])
    arguments = parser.parse_args()
    plan = make_poses(arguments.cell, PoseOptions(count=HIGHEST), Phases())
    rng = np.random.default_rng(arguments.seed)
    truths = [drawn(plan, rng) for _ in range(arguments.robots)]
    start = np.mean([uncalibrated(plan, t) for t in truths])
    print(f"{arguments.robots} robots, {1e3 * start:.3f} mm off in the zone before calibration; mean error in um after it")
    names = ["random", *arguments.criteria]
    print("poses  " + "  ".join(f"{name:>14}" for name in names) + "   (predicted rms, calibration alone)")
    table = np.zeros((len(COUNTS), len(names)))
    for i, n in enumerate(COUNTS):
        begin, told = time.perf_counter(), []
        sets = {c: choose(plan.design.pool, n, c) for c in arguments.criteria}
        for j, name in enumerate(names):
            found = []
            for truth in truths:
                chosen = at_random(plan.design, plan.candidates.near, n, rng) if name == "random" else sets[name]
                found.append(error(plan, truth, chosen, rng))
            table[i, j] = np.mean(found)
            expected = plan.design.error(sets[name] if name != "random" else chosen)
            told.append(f"{1e6 * table[i, j]:6.1f} ({1e6 * expected:5.1f})")
        print(f"{n:5d}  " + "  ".join(f"{t:>14}" for t in told) + f"   {time.perf_counter() - begin:.0f} s", flush=True)
    for j, name in enumerate(names[1:], start=1):
        for n in (40, 80):
            goal = table[COUNTS.index(n), 0]
            enough = np.exp(np.interp(-np.log(goal), -np.log(table[:, j]), np.log(COUNTS)))
            print(f"{name}: {enough:.0f} poses are as good as {n} random ones ({1e6 * goal:.1f} um)")


if __name__ == "__main__":
    main()
