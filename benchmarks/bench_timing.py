"""Time and quality of the time parameterisation on passes like those of a blade.

`python -m benchmarks.bench_timing` prints the numbers quoted in docs/timing.md.
"""

import time
from functools import partial

import numpy as np
from scipy.interpolate import CubicSpline

from robots.rigid_body import inverse_dynamics
from robots.robot import load_robot
from trajectories.joint_trajectory import Limits, ramps, sample_times
from trajectories.krl.values import FILE_LIMITS
from trajectories.program.interpolation import emit, largest_axis_difference, rest_to_rest_spline
from trajectories.timing import _cleaned, _rows, _Tightening, time_contact_path
from trajectories.toppra_law import squared_speeds, time_law


def main() -> None:
    robot = load_robot("kr210_r2700_extra")
    limits = Limits.of(robot, partial(inverse_dynamics, robot, 25.0, np.array([0.01, 0.0, 0.16])))
    start = np.radians([5.0, -70, 100, 10, -40, 20])

    def path(n: int, length: float, seed: int) -> tuple[np.ndarray, np.ndarray]:
        rng = np.random.default_rng(seed)
        knots = CubicSpline(np.linspace(0, length, 6), start + np.cumsum(rng.normal(size=(6, 6)) * 0.02, axis=0))
        s = np.linspace(0, length, n)
        return knots(s), s

    time_contact_path(*path(200, 0.1, 0), 0.04, limits)
    for n, length in ((200, 0.1), (3000, 1.5)):
        clock = time.process_time()
        one = time_contact_path(*path(n, length, 1), 0.04, limits)
        seconds = time.process_time() - clock
        print(f"{n} waypoints, {length} m: {seconds:.2f} s CPU, motion {one.duration:.2f} s, {one.worst}, ramps {ramps(one)} m")
    clock = time.process_time()
    for seed in range(15):
        time_contact_path(*path(200, 0.1, seed), 0.04, limits)
    print(f"15 passes of 200: {time.process_time() - clock:.2f} s CPU")
    excess = []
    for seed in range(20):
        rng = np.random.default_rng(seed)
        q, s = start + np.cumsum(rng.normal(size=(20, 6)) * 0.03, axis=0), np.linspace(0, 0.2, 20)
        cleaned = _cleaned(q, s, None, limits, "pass")
        rows = _rows(cleaned, np.linspace(0, 0.2, 501), _Tightening(s, np.ones(20), np.ones(20)))
        raw = time_law(rows.grid, squared_speeds(rows, 0.05), 0.0)
        good = time_contact_path(q, s, None, limits, window=0.0)
        t = np.arange(0, raw.x[-1], 2.5e-4)
        unchecked = np.nan_to_num(replace_law(good, raw).limit_ratio(t))
        checked = good.limit_ratio(np.arange(0, good.duration, 2.5e-4))
        smooth = time_contact_path(q, s, None, limits)
        excess.append((unchecked.max() / 0.9, checked.max() / 0.9, good.duration / raw.x[-1], smooth.duration / raw.x[-1]))
    worst, median = np.max(excess, axis=0), np.median(excess, axis=0)
    print(
        f"20 random paths, ratio to the allowed limit at 0.25 ms: toppra on 501 points {worst[0]:.3f}, checked {worst[1]:.4f}; "
        f"time over toppra's, median: {median[2]:.3f} without, {median[3]:.3f} with the running mean"
    )
    q, s = path(200, 0.1, 1)
    for window in (0.0, 0.05, 0.1):
        one = time_contact_path(q, s, 0.04, limits, window=window)
        for step in (0.05, 0.025, 0.0125):
            e = emit(one, FILE_LIMITS, lambda t: np.ones(len(t)), largest_axis_difference, step)
            t = sample_times(one)
            qdd = rest_to_rest_spline(e.points, e.times)(t, nu=2)
            ratio = np.abs(qdd / limits.qdd).max()
            print(
                f"window {window} s, step {step} s: {len(e.times)} points, deviation {e.deviation:.2e} rad, "
                f"acceleration of the driven curve {ratio:.3f} of the limit"
            )


def replace_law(trajectory, law):  # type: ignore[no-untyped-def]
    from dataclasses import replace

    return replace(trajectory, law=law)


if __name__ == "__main__":
    main()
