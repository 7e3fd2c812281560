"""The scorer of force worlds: the oracle's view of a world, and how far blind predictions of the force were right."""

import csv
import tempfile
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from ocp.blindtest.oracle import oracle
from ocp.blindtest.oracle.force_detectability import Sight, on_arm, sight_of
from ocp.blindtest.oracle.force_signatures import ForceFamily, force_families
from ocp.blindtest.oracle.signatures import families
from ocp.blindtest.scoring.realised import Realised, realised
from ocp.blindtest.worlds.force_drawing import kind_of
from ocp.blindtest.worlds.force_machines import GrindingMachine
from ocp.blindtest.worlds.force_outside import KINDS as OUTSIDE
from ocp.blindtest.worlds.force_world import log_noise, write_force_world
from ocp.calibrate.force.log import read_force_log
from ocp.diagnose.force.channel import predict_believed
from ocp.model.cell import read_cell
from ocp.simulate.twin.truth.planting import Planted
from robots.pose import Array

WILD, GROSS = 1.2, 5e-4  # N, m off beyond which a reading is wild, and left out by the oracle
MANY_SIZED = (
    "friction_windup", "tracker_drift", "gravity_compensator", "wheel_temperature", "wheel_relaxation", "tangential_force",
    "stock_profile", "belt_splice",
)  # fmt: skip
"""Effects with two sizes, or one that means nothing without its other keys: no smallest size is told."""


def library_of(sight: Sight) -> oracle.White:
    """All families, white and per upper end, of both signals where both were measured."""
    found = force_families(sight.machine, sight.slopes, sight.scene is not None)
    if sight.scene is None or sight.machine.arm is None:
        columns = tuple(sight.white.apply(f.columns * f.upper) for f in found)
        return _white([f.name for f in found], columns, [f.positive for f in found])
    return _joint_library(sight, found)


def _joint_library(sight: Sight, found: list[ForceFamily]) -> oracle.White:
    """Families of a tracker and a log: the same coefficients where both see an effect."""
    assert sight.scene is not None and sight.machine.arm is not None
    seen = {f.name: f for f in families(sight.machine.arm, sight.scene)}
    readings, n = len(sight.scene), len(sight.machine.rows.s)
    names, columns, positive = [], [], []
    for f in found:
        own = seen.pop(f.name, None)
        V, m = f.columns.shape[2:]
        points = np.zeros((readings, 3, V, m)) if own is None or own.columns.shape[2:] != (V, m) else own.columns
        names.append(f.name)
        positive.append(f.positive)
        columns.append(sight.white.apply(f.columns * f.upper, points * f.upper))
    for other in seen.values():
        force = np.zeros((2, n, *other.columns.shape[2:]))
        names.append(other.name)
        positive.append(other.positive)
        columns.append(sight.white.apply(force, other.columns * other.upper))
    return _white(names, tuple(columns), positive)


def _white(names: list[tuple[str, int]], columns: tuple[Array, ...], positive: list[bool]) -> oracle.White:
    return oracle.White(tuple(names), columns, tuple(np.einsum("nvi,nvj->vij", C, C) for C in columns), tuple(positive))


@dataclass(frozen=True, eq=False)
class ForceView:
    """The scorer's side of a force world: its machine, its folder, what was planted and withheld; key: stream of the oracle's
    machine."""

    machine: GrindingMachine
    folder: Path
    effects: tuple[Planted, ...]
    withheld: tuple[str, ...]
    key: tuple[int, ...]

    @property
    def signal(self) -> str:
        """That whose shrinkage counts: the tracker's where it sees everything that was planted, else the force."""
        arm = self.machine.arm is not None and bool(self.effects) and all(on_arm(p) for p in self.effects)
        return "tracker" if arm else "force"

    @cached_property
    def sight(self) -> Sight:
        """The exact view."""
        return sight_of(self.machine)

    def seen(self) -> oracle.Seen:
        """As the oracle sees it: the world's own noise, a machine drawn anew."""
        sight, effects = self.sight, self.effects
        library = library_of(sight).without(self.withheld)
        drawn = np.random.default_rng(self.key).normal(size=len(sight.white.take))
        y = sight.signature(effects) + world_noise(self.folder, sight, effects)
        y = y + sight.white.U @ (np.sqrt(1 - (1 - sight.white.take) ** 2) * drawn)
        alone = tuple(sight.signature(effects, [p for p in effects if p is not one]) for one in effects)
        return oracle.Seen(library, y, alone, tuple(smallest(sight, p, s) for p, s in zip(effects, alone, strict=True)))

    def realised(self, answer: dict[str, Any]) -> dict[str, Realised]:
        """Shrinkage at the sealed conditions, by signal; of the one that counts under "realised"."""
        found = {}
        if answer.get("predictions_force") is not None:
            found["force"] = predictions_judged(self.machine, self.effects, answer["predictions_force"])
        arm = self.machine.arm
        if arm is not None and answer["predictions"] is not None:
            planted = tuple(p for p in self.effects if on_arm(p))
            found["tracker"] = realised(self.machine.bench.cell.path, arm, planted, answer["predictions"])
        return {"realised" if s == self.signal else f"realised_{s}": r for s, r in found.items()}


def world_noise(folder: Path, sight: Sight, effects: tuple[Planted, ...]) -> Array:
    """White noise (N,) of a world's own readings, gross ones taken out."""
    machine = sight.machine
    noise = log_noise(machine, machine.bare)
    force = (noise * (np.abs(noise) < WILD))[..., None]
    if machine.arm is None:
        return np.asarray(sight.white.apply(force)[:, 0])
    with (folder / "tracker.csv").open(encoding="utf-8") as file:
        told = 1e-3 * np.array([[float(row[f"{c}_mm"]) for c in "xyz"] for row in csv.DictReader(file)])
    off = told - machine.arm.points([p for p in effects if on_arm(p)])
    points = off * (np.linalg.norm(off, axis=1) < GROSS)[:, None]
    return np.asarray(sight.white.apply(force, points[..., None])[:, 0])


def predictions_judged(machine: GrindingMachine, effects: tuple[Planted, ...], predictions: dict[str, Any]) -> Realised:
    """Blind predictions of the sealed force rows against the noise-free truth, N."""
    log = machine.log(effects, sealed=True)
    truth = log.fn
    told = (np.asarray(predictions[k]).reshape(len(truth), -1)[:, 0] for k in ("baseline", "corrected", "sigma"))
    baseline, corrected, sigma = told
    before = _rms(baseline - truth)
    floor = _effect_free(machine) if effects else before
    within = np.abs(corrected - truth) <= 1.6449 * np.maximum(sigma, 1e-9)
    return Realised(before, _rms(corrected - truth), floor, float(within.mean()))


def _effect_free(machine: GrindingMachine) -> float:
    """Rms error N of the believed cell, refitted to what the machine without effects would have read, noise and all."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        write_force_world(folder, machine, ())
        cell, log = read_cell(folder / "cell.toml"), read_force_log(folder / "force.csv")
        tracker = folder / "tracker.csv" if machine.arm is not None else None
        sealed = read_force_log(folder / "sealed_force.csv", sealed=True)
        predicted = predict_believed(cell, log, sealed, tracker)
    return _rms(predicted - machine.log((), sealed=True).fn)


def _rms(off: Array) -> float:
    return float(np.sqrt(np.mean(off**2)))


def smallest(sight: Sight, planted: Planted, white: Array) -> float | None:
    """Share of the usual upper end at which the effect would just be told from noise, its family's price paid."""
    if planted.effect in OUTSIDE or planted.effect in MANY_SIZED:
        return None
    keys = kind_of(planted.effect).keys
    key = keys[0]
    upper = max(abs(key.low), abs(key.high)) * (key.scale[(planted.joint or 1) - 1] if key.scale else 1.0)
    m = 2 if any(k.name == "phase_rad" for k in keys) else key.length
    size = float(np.linalg.norm(planted.vector(key.name))) / upper
    lam = float(white @ white)
    return size * float(np.sqrt((oracle.needed(m) + sight.price(planted.effect, planted.joint)) / lam)) if lam > 0 else None
