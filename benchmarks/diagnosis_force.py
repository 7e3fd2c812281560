"""Many force logs of one world with effects of random size planted, each diagnosed alone:
`python benchmarks/diagnosis_force.py FOLDER COUNT`. A line a log on stdout; the world is kept in
FOLDER. Figures: docs/diagnosis_force.md."""

import pickle
import sys
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from ocp.calibrate.force.log import read_force_log
from ocp.diagnose.force.channel import ForceChannel, force_channel
from ocp.diagnose.force.fit import fit_effects
from ocp.diagnose.verdict.diagnosis import diagnose_channels
from ocp.effects.catalogue import library
from tests.support.diagnosis_force_world import HEADER, Base, Pass, Planted, believed_world, log_of, moved_joints, record
from tests.support.force_world import arm_posterior, write_log

PLAN = (
    Pass(0),
    Pass(0, travel=-1),
    Pass(1),
    Pass(1, travel=-1),
    Pass(0, contact=False),
    Pass(1, feed=0.02),
    Pass(0, feed=0.08),
    Pass(0, setpoint=12.0),
    Pass(1, setpoint=30.0),
    Pass(1, belt=-20.0),
    Pass(0, pause=1200.0),
    Pass(1, contact=False),
)
Maker = Callable[[np.random.Generator], tuple[Planted, float]]  # the effect and its size


def _between(rng: np.random.Generator, low: float, high: float) -> float:
    return float(np.exp(rng.uniform(np.log(low), np.log(high))))


def _sign(columns: dict[str, np.ndarray]) -> np.ndarray:
    return np.sign(columns["belt"])


def _wear(rng):
    a = _between(rng, 2e-8, 3e-7)
    return Planted(overlap=lambda b: -a * b.columns["clock"]), a


def _removal(rng):
    a = _between(rng, 5e-6, 6e-5)
    return Planted(overlap=lambda b: -a * b.columns["ground_before"] * 0.04 / b.columns["feed"]), a


def _slip(rng):
    a, at = _between(rng, 2e-5, 1.3e-4) * rng.choice([-1, 1]), rng.uniform(60.0, 300.0)
    return Planted(overlap=lambda b: -a * (b.columns["clock"] > at)), a


def _runout(rng):
    a, phase = _between(rng, 1e-5, 1e-4), rng.uniform(-3, 3)
    return Planted(overlap=lambda b: a * np.cos(b.columns["belt"] / b.world.truth.wheel.radius * b.columns["clock"] + phase)), a


def _stock(rng):
    a, k = _between(rng, 5e-5, 1.3e-4), rng.integers(2, 6)
    return Planted(overlap=lambda b: a * np.cos(k * np.pi * (b.columns["s"] - b.columns["s"].min()) / 0.07)), a


def _bias(rng):
    a = _between(rng, 0.1, 2.0) * rng.choice([-1, 1])
    return Planted(reading=lambda c, F: a + 0.0 * F), a


def _drift(rng):
    a = _between(rng, 0.1, 3.0) * rng.choice([-1, 1])
    return Planted(reading=lambda c, F: a * c["clock"] / 3600.0), a


def _gain(rng):
    a = _between(rng, 0.005, 0.06) * rng.choice([-1, 1])
    return Planted(reading=lambda c, F: a * F), a


def _crosstalk(rng):
    a = _between(rng, 0.01, 0.1)
    return Planted(reading=lambda c, F: a * 0.35 * F * _sign(c)), a


def _splice(rng):
    a, hz, phase = _between(rng, 1.0, 10.0), rng.uniform(5, 15), rng.uniform()
    return Planted(reading=lambda c, F: a * (F > 0) * np.exp(-0.5 * (((c["time"] * hz - phase) % 1.0 - 0.5) / 0.05) ** 2)), a


def _backlash(joint: int) -> Maker:
    def make(rng):
        a = _between(rng, 2e-5, 2e-4)

        def reversal(b: Base) -> np.ndarray:
            sign = np.zeros(len(b))
            for r in np.unique(b.columns["run"]):
                at = np.flatnonzero(b.columns["run"] == r)
                sign[at] = np.sign(np.gradient(b.columns["q"][at, joint - 1]))
            return moved_joints(b, a * np.eye(6)[joint - 1] * sign[:, None])

        return Planted(overlap=reversal), a

    return make


MAKERS: dict[str, Maker] = {
    "wheel_wear": _wear,
    "material_removal": _removal,
    "clamp_slip": _slip,
    "wheel_runout": _runout,
    "stock_profile": _stock,
    "sensor_bias": _bias,
    "sensor_drift": _drift,
    "sensor_gain": _gain,
    "sensor_crosstalk": _crosstalk,
    "belt_splice": _splice,
    "backlash:3": _backlash(3),
}


def world(folder: Path) -> tuple[Base, ForceChannel]:
    """The campaign without effects and its channel, made once."""
    kept = folder / "base.pkl"
    if not kept.is_file():
        rng = np.random.default_rng(5)
        folder.mkdir(parents=True, exist_ok=True)
        kept.write_bytes(pickle.dumps(record(believed_world(folder, rng), PLAN, rng)))
    base: Base = pickle.loads(kept.read_bytes())
    log = read_force_log(write_log(folder / "force.csv", log_of(base)[0], HEADER))
    return base, force_channel(base.world.cell, log, arm=arm_posterior(base.world.cell))


def main(folder: Path, count: int) -> None:
    """Every second log without an effect; one reading in a hundred is wild in half of them."""
    base, channel = world(folder)
    names = list(MAKERS)
    for k in range(count):
        rng = base.rng
        rng.bit_generator.state = np.random.default_rng(1000 + k).bit_generator.state
        name = "" if k % 2 == 0 else names[(k // 2) % len(names)]
        planted, size = MAKERS[name](rng) if name else (Planted(), 0.0)
        rows, truth = log_of(base, (planted,), 0.01 * (k % 4 < 2))
        log = read_force_log(write_log(folder / f"force_{count}.csv", rows, HEADER))
        start = time.process_time()
        problem = replace(channel.problem, log=log)
        fitted = ForceChannel(problem, fit_effects(problem, (), channel.fit), channel.effects)
        gap = np.sqrt(np.mean((fitted.fit.at.fn - truth)[log.contact] ** 2))
        found = diagnose_channels([fitted], library())
        best = found.explanations[0] if found.explanations else None
        said = "+".join(map(str, best.names)) if best is not None and found.p_none < best.probability else "none"
        right = [r for r in found.ranking if str(r.name) == name]
        value = next(iter(right[0].active.parameters.items())) if right else ("", 0.0)
        sd = float(np.sqrt(right[0].active.covariance[0, 0])) if right else 0.0
        power = right[0].detectability if right else 0.0
        mark = "=" if said == (name or "none") else "#"
        told = value[1] if not isinstance(value[1], list) else "-"
        sys.stdout.write(
            f"{mark} {name or 'none':18s} {size:9.2g} gap {gap:.3f} N lambda {power:7.1f} said {said} {found.verdict} p_none "
            f"{found.p_none:.3f} unknown {found.p_unknown:.3f} value {told} sd {sd:.2g} classes "
            f"{[sorted(map(str, c)) for c in found.classes]} {time.process_time() - start:.1f} s\n"
        )
        sys.stdout.flush()


if __name__ == "__main__":
    main(Path(sys.argv[1]), int(sys.argv[2]))
