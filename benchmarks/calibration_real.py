"""Held-out accuracy on measured robots: a UR5 and a UR10 under laser trackers (../shared/data/real).

`python benchmarks/calibration_real.py` from the repository root; `ur5`, `ur10` or `time` alone; `--splits N`; `--data DIR`.
"""

import argparse
import csv
import resource
import time
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from robots.calibration.fit import WEAK, fit_campaign, located, predict_readings
from robots.calibration.layout import Choice, State, build_layout, moved, nominal_state
from robots.calibration.residuals import linearise, residuals
from robots.calibration.solver import Campaign
from robots.calibration.validation import folds
from robots.pose import Array
from robots.robot import load_robot
from robots.tracker_readings import Index, Instrument, Nest, Readings

DATA = Path(__file__).parents[1].parent / "shared" / "data" / "real"
SIGMA = 3e-5  # m, isotropic: GTS3800 at 15 um + 6 um/m (ur5_tracker/SOURCE.txt) and about 2.5 m away
TURN_SIGMA = np.radians(0.02)  # of the T-Mac's turns, our guess; the file gives none
GROSS, GROSS_SHARE = 5e-3, 0.02  # m and share of planted gross errors
VARIANTS = {
    "rigid: frames only": Choice(geometry=False, joints=()),
    "offsets only": None,
    "geometry": Choice(joints=()),
    "geometry + gravity, joints 2 3": Choice(joints=(2, 3)),
    "geometry + gravity, joints 1 2 3": Choice(joints=(1, 2, 3)),
    "geometry + gravity, all joints": Choice(joints=(1, 2, 3, 4, 5, 6)),
}
BEST = "geometry + gravity, joints 2 3"


def readings_of(path: Path, q: Array, point: Array, sigma: Array | None = None, turn: Array | None = None) -> Readings:
    """Readings (n) of one nest, payload, station and session."""
    n = len(q)
    same = np.zeros(n, np.int64)
    return Readings(
        path=path,
        q=q,
        point=point,
        target=same,
        targets=("reflector",),
        payload=same,
        payloads=("bare",),
        station=same,
        stations=("tracker",),
        session=same,
        sessions=("all",),
        load=np.zeros((n, 6)),
        load_link=same + 6,
        load_place=np.zeros((n, 3)),
        sigma=sigma,
        turn=turn,
        sigma_turn=None if turn is None else np.full(n, TURN_SIGMA),
        line=np.arange(n) + 2,
    )


def ur5(data: Path) -> Campaign:
    """1000 poses; positions in the base frame, so the tracker's place is unknown and the noise isotropic."""
    path = data / "ur5_tracker" / "3D_UR5_uncalibrated_grid_cleaned.csv"
    with path.open() as file:
        rows = np.array(list(csv.reader(file))[1:], float)
    point = 1e-3 * (rows[:, 1:4] - rows[:, 4:7])  # target less (target less achieved)
    readings = readings_of(path, np.radians(rows[:, 7:13]), point, np.full(len(rows), SIGMA))
    return Campaign(load_robot("ur5"), readings, {}, Instrument(nests={"reflector": Nest(6, np.array([0.0, 0.0, 0.031]))}))


def ur10(data: Path, six: bool = False) -> Campaign:
    """11 911 poses of a T-Mac in the tracker's frame, with its turns where `six`."""
    path = data / "ur10_tracker" / "measurements_grid.csv"
    with path.open() as file:
        rows = np.array([[float(x.replace(",", ".")) for x in row] for row in list(csv.reader(file, delimiter=";"))[1:]])
    turn = Rotation.from_euler("XYZ", rows[:, 17:20], degrees=True).as_matrix() if six else None
    flange = np.loadtxt(data / "ur10_tracker" / "Trafo_TM_F_init.txt")[:3, :3].T
    nest = Nest(6, np.array([0.0, 0.0, 0.109]), flange)
    readings = readings_of(path, rows[:, 7:13], 1e-3 * rows[:, 14:17], turn=turn)
    return Campaign(load_robot("ur10"), readings, {}, Instrument(nests={"reflector": nest}))


def least_squares_fit(campaign: Campaign, choice: Choice, only: str = "") -> State:
    """The same model and priors with Gaussian errors, all readings alike: plain Gauss-Newton on positions.

    `only`: of the geometry just the numbers whose name starts with it.
    """
    c = campaign
    state = located(c, nominal_state(c.robot, c.readings, c.payloads, c.instrument, choice))
    layout = build_layout(c.robot, c.readings, c.instrument, choice, WEAK)
    geometry = set(layout.arm[:30].tolist())
    free = np.array([i not in geometry or name.startswith(only) for i, name in enumerate(layout.names)])
    precision = (1e-4 * layout.scale / layout.prior_sd) ** 2  # residuals of about 0.1 mm against the priors
    moves = np.zeros(layout.size)
    for _ in range(10):
        linear = linearise(c.robot, c.readings, c.instrument, layout, state)
        J = (linear.J * layout.scale).reshape(-1, layout.size)[:, free]
        rhs = J.T @ linear.residual.ravel() - (precision * moves)[free]
        step = np.zeros(layout.size)
        step[free] = np.linalg.solve(J.T @ J + np.diag(precision[free]) + 1e-14 * np.eye(J.shape[1]), rhs)
        moves += step
        state = moved(layout, state, layout.scale * step)
    return state


def held_out(campaign: Campaign, name: str, held: Index, gaussian: bool = False) -> tuple[float, Array]:
    """Seconds of the fit without the readings `held`, and the errors (m,) m at them."""
    keep = np.setdiff1d(np.arange(len(campaign.readings)), held)
    left, seen = replace(campaign, readings=campaign.readings.take(keep)), replace(campaign.readings.take(held), turn=None)
    choice = VARIANTS[name]
    began = time.perf_counter()
    if choice is None or gaussian:
        state = least_squares_fit(left, choice or Choice(joints=()), "" if choice else "th")
        return time.perf_counter() - began, np.linalg.norm(residuals(left.robot, seen, left.instrument, state), axis=1)
    fit = fit_campaign(left, choice)
    seconds = time.perf_counter() - began
    return seconds, np.linalg.norm(seen.point - predict_readings(fit, seen)[0], axis=1)


def splits(n: int, count: int) -> Iterator[Index]:
    """Held-out fifths of `count` seeded random splits."""
    for seed in range(count):
        yield np.sort(np.random.default_rng(seed).permutation(n)[: n // 5])


def spoiled(campaign: Campaign, held: Index) -> Campaign:
    """A share of the readings outside `held` moved by GROSS in random directions."""
    rng = np.random.default_rng(1)
    readings = campaign.readings
    keep = np.setdiff1d(np.arange(len(readings)), held)
    rows = rng.choice(keep, round(GROSS_SHARE * len(keep)), replace=False)
    point = readings.point.copy()
    away = rng.normal(size=(len(rows), 3))
    point[rows] += GROSS * away / np.linalg.norm(away, axis=1, keepdims=True)
    return replace(campaign, readings=replace(readings, point=point))


def row(label: str, found: list[tuple[float, Array]]) -> str:
    """Mean and sd over the splits of the rms in mm, largest error, mean seconds."""
    rms = np.array([1e3 * np.sqrt(np.mean(e**2)) for _, e in found])
    worst, seconds = 1e3 * max(e.max() for _, e in found), np.mean([s for s, _ in found])
    return f"| {label} | {rms.mean():.4f} | {rms.std():.4f} | {rms.max():.4f} | {worst:.2f} | {seconds:.2f} |"


HEADER = "| model | rms 3D mm | sd over splits | worst split | largest error | s a fit |\n|---|---|---|---|---|---|"


def accuracy(title: str, campaign: Campaign, count: int) -> None:
    """The table of random splits, then the blocked ones."""
    n = len(campaign.readings)
    held = list(splits(n, count))
    print(f"\n{title}: {count} random splits, {n - n // 5} fitted, {n // 5} held out\n{HEADER}")
    for name in VARIANTS:
        print(row(name, [held_out(campaign, name, h) for h in held]), flush=True)
    print(row(f"{BEST}, Gaussian", [held_out(campaign, BEST, h, True) for h in held]))
    few = held[: max(count // 4, 1)]
    dirty = [spoiled(campaign, h) for h in few]
    what = f"{GROSS_SHARE:.0%} of the fitted readings {1e3 * GROSS:.0f} mm off"
    for label, plain in (("robust", False), ("Gaussian", True)):
        print(row(f"{what}, {label}", [held_out(c, BEST, h, plain) for c, h in zip(dirty, few, strict=True)]), flush=True)
    blocks = [f for f in folds(campaign) if f.kind in ("region", "joint range")]
    print(f"\n{title}, blocked\n| held out | readings | " + " | ".join(VARIANTS) + " |\n" + "|---" * (2 + len(VARIANTS)) + "|")
    for fold in blocks:
        errors = [held_out(campaign, name, fold.held)[1] for name in VARIANTS]
        cells = " | ".join(f"{1e3 * np.sqrt(np.mean(e**2)):.3f}" for e in errors)
        print(f"| {fold.kind} {fold.name} | {len(fold.held)} | {cells} |", flush=True)


def timing(data: Path) -> None:
    """All readings of the UR10 fitted in one go: wall clock, processor time, peak memory."""
    print("\nUR10, all poses fitted\n| model | poses | unknowns | steps | wall s | processor s | peak MB |\n" + "|---" * 7 + "|")
    for six in (False, True):
        campaign = ur10(data, six)
        for name in ("geometry", BEST, "geometry + gravity, all joints"):
            wall, cpu = time.perf_counter(), time.process_time()
            fit = fit_campaign(campaign, VARIANTS[name] or Choice())
            wall, cpu = time.perf_counter() - wall, time.process_time() - cpu
            peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
            label, n = name + (", 6D" if six else ""), len(campaign.readings)
            print(f"| {label} | {n} | {fit.layout.size} | {fit.steps} | {wall:.1f} | {cpu:.1f} | {peak:.0f} |", flush=True)


def six_axes(data: Path, count: int) -> None:
    """Whether the T-Mac's turns help to predict its positions."""
    print(f"\nUR10, position of the T-Mac predicted from 6D readings, {count} random splits\n{HEADER}")
    campaign = ur10(data, True)
    for name in ("geometry", BEST):
        print(row(name, [held_out(campaign, name, h) for h in splits(len(campaign.readings), count)]), flush=True)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("parts", nargs="*", default=["time", "ur5", "ur10"])
    parser.add_argument("--splits", type=int, default=20)
    parser.add_argument("--data", type=Path, default=DATA)
    options = parser.parse_args()
    if not options.data.is_dir():
        raise SystemExit(f"{options.data} is absent; give the folder of the measured robots with --data")
    if "time" in options.parts:
        timing(options.data)
    if "ur5" in options.parts:
        accuracy("UR5", ur5(options.data), options.splits)
    if "ur10" in options.parts:
        accuracy("UR10", ur10(options.data), max(options.splits // 4, 1))
        six_axes(options.data, max(options.splits // 4, 1))


if __name__ == "__main__":
    main()
