"""How far the gap shrank at conditions that nobody had measured, against what could have been reached.

The truth is free of noise, as in the sealed truths of FORMATS' worlds: noise^2 = 0 in G^2 = max(0, mean square - noise^2) and G
is the rms itself. Repeatability is noise; ripple and play, the same whenever an axis comes back, are not.
"""

import tempfile
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from ocp.blindtest.worlds.machines import Machine
from ocp.blindtest.worlds.sealing import write_world
from ocp.diagnose.channels import channels_of
from ocp.diagnose.dataset import read_data_set, read_sealed_tracker
from ocp.shell.progress import Phases
from ocp.simulate.twin.truth.planting import Planted
from robots.pose import Array


@dataclass(frozen=True)
class Realised:
    """Rms errors m at the sealed conditions against the noise-free truth: baseline, corrected, and what is left where nothing
    was planted on the same machine; share of coordinates within 1.645 told standard deviations."""

    before: float
    after: float
    floor: float
    covered: float

    @property
    def shrinkage(self) -> float:
        """1 - after / before."""
        return 1.0 - self.after / self.before

    @property
    def possible(self) -> float:
        """The same for one who knew the effects."""
        return 1.0 - self.floor / self.before


def realised(cell: Path, machine: Machine, effects: tuple[Planted, ...], predictions: dict[str, Any]) -> Realised:
    """Judge blind predictions of the sealed conditions."""
    truth = machine.points(effects, sealed=True)
    baseline, corrected, sigma = (np.asarray(predictions[k]) for k in ("baseline", "corrected", "sigma"))
    before = rms(baseline - truth)
    floor = effect_free(cell, machine) if effects else before
    within = np.abs(corrected - truth) <= 1.6449 * np.maximum(sigma, 1e-9)
    return Realised(before, rms(corrected - truth), floor, float(within.mean()))


def effect_free(cell: Path, machine: Machine) -> float:
    """Rms error m of the believed cell, refitted to what the machine without effects would have read, noise and all."""
    with tempfile.TemporaryDirectory() as folder:
        write_world(Path(folder), cell, machine, ())
        data = read_data_set(folder)
        channel = channels_of(data, Phases())[0]
        predicted = channel.predict(read_sealed_tracker(data), ())
    return rms(predicted.baseline - machine.points((), sealed=True))


def rms(off: Array) -> float:
    """Of 3D errors (n, 3)."""
    return float(np.sqrt((off**2).sum(axis=1).mean()))
