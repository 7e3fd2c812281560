"""The whole answer to a data set, as the command writes it and the report shows it."""

from dataclasses import dataclass

import numpy as np

from ocp.diagnose.dataset import DataSet
from ocp.diagnose.engine.channel_system import Channel
from ocp.diagnose.engine.findings import Diagnosis, Experiment
from ocp.diagnose.verdict.shrinkage import Shrinkage
from robots.pose import Array

SCALE = {"mm": 1e3, "N": 1.0, "arcsec": float(np.degrees(1.0) * 3600.0)}
"""Units in which a gap is told, per SI unit."""


@dataclass(frozen=True)
class SignalGap:
    """The gap of one signal: channel before and after, sizes (n,) of the readings' errors in `unit`, outliers apart, noise
    floor; shrinkage to expect on new data, and by what was withheld (None: no gap there to speak of)."""

    name: str
    unit: str
    noise_floor: float
    before: Array
    after: Array
    shrinkage: Shrinkage | None
    extrapolation: tuple[tuple[str, float | None], ...]
    baseline: Channel
    corrected: Channel


@dataclass(frozen=True)
class Answer:
    """Diagnosis of a data set with the gap of every signal, what to measure next, what cannot be seen, seconds by phase."""

    data: DataSet
    diagnosis: Diagnosis
    gaps: tuple[SignalGap, ...]
    next: tuple[Experiment, ...]
    blind: tuple[str, ...]
    notices: tuple[str, ...]
    seconds: dict[str, float]


def figures(sizes: Array) -> dict[str, float]:
    """rms, mean and maximum of sizes (n,)."""
    return {"rms": float(np.sqrt(np.mean(sizes**2))), "mean": float(sizes.mean()), "max": float(sizes.max())}
