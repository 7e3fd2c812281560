"""joints.csv of a virtual robot: motor side, link side and torques along a path, with a recorder that may lag.

The gap between motor and link side is what gears, heat and springs do; a link-side encoder sees it without any tracker, and
without the geometry. Its own errors here are noise alone: scale and mounting of a good encoder are below that.
"""

import csv
from pathlib import Path

import numpy as np

from ocp.simulate.twin.arm.arm import Arm, Moments
from ocp.simulate.twin.arm.joint_errors import AxisState, motor_side
from ocp.simulate.twin.truth.machine import Truth
from robots.pose import Array

# One sigma: a good link-side encoder (1 arcsec), a motor current as torque.
LINK_SIGMA, TORQUE_SIGMA = 4.8e-6, 4.0  # rad, N m


def joint_log(arm: Arm, truth: Truth, m: Moments, run: Array, time_s: Array, rng: np.random.Generator) -> dict[str, Array]:
    """Columns of joints.csv (FORMATS) for instants in time order inside each run: run (n,), time_s (n,) s since its start.

    q: motor side through the ratio, as commanded; link: what the axis does, with gear errors, heat, play and the spring's
    give; tau: motor torque on the link side. A planted channel_delay records the link side later: of its joint, or of all.
    """
    settled = arm.settled(m)
    warmth = m.temperature_C - arm.reference_C
    link = motor_side(truth, AxisState(m.q, m.approach, warmth, arm.robot)) + settled.bent[:, :6]
    tau = settled.motor_torque
    for planted in truth.planted("channel_delay"):
        late = range(6) if planted.joint is None else [planted.joint - 1]
        for j in late:
            link[:, j] = delayed(link[:, j], run, time_s, planted.number("s"))
    link = link + rng.normal(size=link.shape) * LINK_SIGMA
    tau = tau + rng.normal(size=tau.shape) * TORQUE_SIGMA
    columns = {"run": np.asarray(run, float), "time_s": np.asarray(time_s, float)}
    for name, values, factor in (("q{}_deg", m.q, 180 / np.pi), ("link{}_deg", link, 180 / np.pi), ("tau{}_Nm", tau, 1.0)):
        columns |= {name.format(j + 1): factor * values[:, j] for j in range(6)}
    return columns


def delayed(values: Array, run: Array, time_s: Array, delay: float) -> Array:
    """A channel (n,) that is recorded `delay` s late, each run for itself; before its first value it holds that value."""
    late = np.array(values, float)
    for label in np.unique(run):
        rows = np.flatnonzero(run == label)
        late[rows] = np.interp(time_s[rows] - delay, time_s[rows], values[rows])
    return late


def write_joint_log(path: Path, columns: dict[str, Array]) -> None:
    """Write columns (n,) as joints.csv: angles to 1e-7 deg, torques to 0.01 N m, times to 0.1 ms."""
    digits = {"run": 0, "time_s": 4}
    forms = [digits.get(name, 2 if name.startswith("tau") else 7) for name in columns]
    with path.open("w", newline="", encoding="ascii") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(columns)
        for row in zip(*columns.values(), strict=True):
            writer.writerow([f"{value:.{form}f}" for value, form in zip(row, forms, strict=True)])
