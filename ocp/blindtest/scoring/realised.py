"""How far the gap shrank at conditions that nobody had measured, against what could have been reached.

The truth is free of noise, as in the sealed truths of FORMATS' worlds: noise^2 = 0 in G^2 = max(0, mean square - noise^2) and G
is the rms itself. Repeatability is noise; ripple and play, the same whenever an axis comes back, are not.
"""

import tempfile
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from ocp.blindtest.worlds.files import write_world
from ocp.blindtest.worlds.machines import BlindMachine, GrindingMachine, TrackerMachine
from ocp.blindtest.worlds.pools import of_arm
from ocp.calibrate.force.log import read_force_log
from ocp.diagnose.channels import channels_of
from ocp.diagnose.dataset import read_data_set, read_sealed_tracker
from ocp.diagnose.force.channel import predict_believed
from ocp.model.cell import read_cell
from ocp.shell.progress import Phases
from ocp.simulate.twin.truth.planting import Planted
from robots.pose import Array


@dataclass(frozen=True)
class Realised:
    """Rms errors (m of points, N of forces) at the sealed conditions against the noise-free truth: baseline, corrected, and what
    is left where nothing was planted on the same machine; share of values within 1.645 predicted standard deviations."""

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


def counted_signal(machine: BlindMachine, effects: tuple[Planted, ...]) -> str:
    """The signal whose shrinkage counts: the tracker's where it sees everything that was planted, else the force."""
    if isinstance(machine, TrackerMachine):
        return "tracker"
    return "tracker" if machine.arm is not None and effects and of_arm(effects) == effects else "force"


def realised_shrinkage(machine: BlindMachine, effects: tuple[Planted, ...], answer: dict[str, Any]) -> dict[str, Realised]:
    """Blind predictions of the sealed conditions judged, by signal: under "realised" the one that counts."""
    found: dict[str, Realised] = {}
    if isinstance(machine, TrackerMachine):
        arm: TrackerMachine | None = machine
        on_arm = effects
    else:
        arm, on_arm = machine.arm, of_arm(effects)
        if answer.get("predictions_force") is not None:
            truth = machine.log(effects, sealed=True).fn[:, None]
            found["force"] = _judged(answer["predictions_force"], truth, lambda: _force_floor(machine) if effects else None)
    if arm is not None and answer["predictions"] is not None:
        truth = arm.points(on_arm, sealed=True)
        found["tracker"] = _judged(answer["predictions"], truth, lambda: _tracker_floor(arm) if on_arm else None)
    counted = counted_signal(machine, effects)
    return {"realised" if signal == counted else f"realised_{signal}": one for signal, one in found.items()}


def _judged(predictions: dict[str, Any], truth: Array, floor: Callable[[], float | None]) -> Realised:
    """Predictions of conditions of which `truth` (n, k) are the readings without noise; floor: None where nothing was planted."""
    baseline, corrected, sigma = (
        np.asarray(predictions[k]).reshape(len(truth), -1)[:, : truth.shape[1]] for k in ("baseline", "corrected", "sigma")
    )
    before, left = rms(baseline - truth), floor()
    within = np.abs(corrected - truth) <= 1.6449 * np.maximum(sigma, 1e-9)
    return Realised(before, rms(corrected - truth), before if left is None else left, float(within.mean()))


def _tracker_floor(machine: TrackerMachine) -> float:
    """Rms error m of the believed cell, refitted to what the machine without effects would have read, noise and all."""
    with tempfile.TemporaryDirectory() as folder:
        write_world(Path(folder), machine, ())
        data = read_data_set(folder)
        channel = channels_of(data, Phases())[0]
        predicted = channel.predict(read_sealed_tracker(data), ())
    return rms(predicted.baseline - machine.points((), sealed=True))


def _force_floor(machine: GrindingMachine) -> float:
    """The same of the log, N."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        write_world(folder, machine, ())
        cell, log = read_cell(folder / "cell.toml"), read_force_log(folder / "force.csv")
        tracker = folder / "tracker.csv" if machine.arm is not None else None
        sealed = read_force_log(folder / "sealed_force.csv", sealed=True)
        predicted = predict_believed(cell, log, sealed, tracker)
    return rms((predicted - machine.log((), sealed=True).fn)[:, None])


def rms(off: Array) -> float:
    """Of errors (n, k), k coordinates each."""
    return float(np.sqrt((off**2).sum(axis=1).mean()))
