"""Tables of many trials: what stands beside the paper's Table 2 and Figures 11 to 13."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ocp.experiments.trial import STEPS, Trial

PAPER_POSITIONS = {"before": 1.186, "after": 0.154}  # mm, mean of Table 2
PAPER_FORCES = {"nothing calibrated": "11.4 .. 25.8", "robot only": "17.9 .. 20.8", "everything": "mean 20.4"}  # N
ORDER = ("before", "placed", "full", "geometry", "relative", "relative-literal", "oracle")


@dataclass(frozen=True)
class PositionRow:
    """Absolute error of fresh poses by one method, mm: mean over all, median, 90 % and largest of the robots' means, largest
    single error."""

    method: str
    mean: float
    median: float
    p90: float
    worst: float
    max: float


@dataclass(frozen=True)
class ForceRow:
    """True force at the working points after one step, N: smallest and largest over all robots, mean over all; robots whose
    mean lies within 0.4 N of the process force (share), median and 90 % of the standard deviation within a robot; robots that
    lost contact somewhere; robots planned."""

    mount: str
    step: str
    low: float
    high: float
    mean: float
    near: float
    sd: float
    sd90: float
    off: int
    robots: int


def position_rows(trials: Sequence[Trial]) -> list[PositionRow]:
    """One row a method, "before" first."""
    rows = []
    for method in ORDER:
        errors = [trial.positions[method] for trial in trials if method in trial.positions]
        if errors:
            means = np.array([e.mean() for e in errors])
            figures = means.mean(), np.median(means), np.quantile(means, 0.9), means.max(), max(e.max() for e in errors)
            rows.append(PositionRow(method, *map(float, figures)))
    return rows


def force_rows(trials: Sequence[Trial], wanted: float) -> list[ForceRow]:
    """One row a mount and step; `wanted` N is the process force."""
    rows = []
    for mount in dict.fromkeys(key.split("/")[0] for trial in trials for key in trial.force):
        for step in STEPS:
            forces = [trial.force[f"{mount}/{step}"] for trial in trials if f"{mount}/{step}" in trial.force]
            if not forces:
                continue
            means, sds = np.array([f.mean() for f in forces]), np.array([f.std() for f in forces])
            least, most, close = (
                min(f.min() for f in forces),
                max(f.max() for f in forces),
                np.mean(np.abs(means - wanted) <= 0.4),
            )
            low, high, mean, near, sd, sd90 = map(
                float, (least, most, means.mean(), close, np.median(sds), np.quantile(sds, 0.9))
            )
            lost = sum(bool((f <= 0).any()) for f in forces)
            rows.append(ForceRow(mount, step, low, high, mean, near, sd, sd90, lost, len(forces)))
    return rows


def last_line(trials: Sequence[Trial], wanted: float) -> str:
    """The result in a sentence."""
    position = {row.method: row for row in position_rows(trials)}
    words = (
        f"{len(trials)} virtual robots; fresh poses off by {position['before'].mean:.3f} mm before and "
        f"{position['full'].mean:.3f} mm after calibration (oracle {position['oracle'].mean:.3f}; paper 1.186 and 0.154)"
    )
    for row in force_rows(trials, wanted):
        if row.step == "everything":
            words += (
                f"; {row.mount}: force {row.low:.1f} .. {row.high:.1f} N, mean {row.mean:.2f}, {100 * row.near:.0f} % of robots "
                f"within 0.4 N, {row.sd:.2f} N standard deviation within a robot"
            )
    failed = sum(len(trial.failed) for trial in trials)
    return words + (f"; {failed} plans refused" if failed else "")
