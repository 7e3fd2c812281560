"""The splice of the belt knocks once per turn of the belt."""

from collections.abc import Mapping, Sequence
from typing import Any

import casadi as ca
import numpy as np

from ocp.effects._forms import row
from ocp.effects.context import ContactContext
from ocp.effects.effect import Effect, Parameter, Scanned, Surroundings
from robots.pose import Array

RATES = (5.0, 15.0)  # 1/s, turns of the belt
WAVES = 3  # harmonics of a knock
LENGTH = 0.1  # of a turn: how long a knock is taken to last
STEP = (0.02, 0.25)  # 1/s, bounds on the step of the rates tried
DRIFT = 0.2  # turns that a knock may leave its place over the longest run
TONE = 0.35  # of the largest harmonic: where all others are surely below it nothing knocks
# Amplitude of the first harmonics of knocks of height one and that length, 2 sin(pi m L) / (pi m).
_SHARES = 2 * np.sin(np.pi * np.arange(1, WAVES + 1) * LENGTH) / (np.pi * np.arange(1, WAVES + 1))


def _scan(joint: int, seen: Surroundings) -> Sequence[Scanned]:
    step = float(np.clip(DRIFT / max(seen.run_length, 1e-6), *STEP))
    return [{"hz": round(float(hz), 4)} for hz in np.arange(RATES[0], RATES[1] + 0.5 * step, step)]


def _knock(x: ContactContext, j: int, scanned: Scanned) -> ca.SX:
    turn = 2 * np.pi * scanned["hz"] * x.time
    touching = ca.if_else(x.F > 0, 1.0, 0.0)
    return row(*(touching * wave(m * turn) for m in range(1, WAVES + 1) for wave in (ca.cos, ca.sin)))


def _values(a: Array, scanned: Scanned) -> dict[str, Any]:
    amplitudes = np.hypot(a[0::2], a[1::2])
    return {"N": float(amplitudes @ _SHARES / (_SHARES @ _SHARES)), "hz": scanned["hz"], "waves_N": [float(v) for v in a]}


def _coefficients(values: Mapping[str, Any]) -> tuple[Array, dict[str, Any]]:
    return np.asarray(values["waves_N"], float).reshape(2 * WAVES), {"hz": values["hz"]}


def _doubt(a: Array, sd: Array, scanned: Scanned) -> str:
    """A knock that lasts up to a third of a turn has a second harmonic of at least half the first."""
    sizes = np.hypot(a[0::2], a[1::2])
    bounds = sizes + 2 * np.maximum(sd[0::2], sd[1::2])
    others = np.delete(bounds, np.argmax(sizes))
    alone = bool((others < TONE * sizes.max()).all())
    return "it is a single wave, which no knock is" if alone else ""


EFFECT = Effect(
    name="belt_splice",
    title="splice of the belt",
    subsystem="wheel",
    physics="The splice is thicker than the belt and adds an impulse once per belt revolution, hz times a second (DIAGNOSIS, "
    "catalogue). Its first three harmonics are fitted, cosine and sine in waves_N against the time of the run; N is the height "
    "of a knock that lasts a tenth of a turn and has these harmonics.",
    parameters=(
        Parameter("N", "N", 1.0, 10.0, signed=False),
        Parameter("hz", "1/s", 5.0, 15.0, signed=False),
        Parameter("waves_N", "N", 0.0, 2.0, length=2 * WAVES),
    ),
    coefficients=tuple(f"{part}_{m}" for m in range(1, WAVES + 1) for part in ("cos", "sin")),
    prior_sd=(2.0,) * (2 * WAVES),
    values=_values,
    coefficients_of=_coefficients,
    needs=("time_s",),
    scan=_scan,
    symbolic=("hz",),
    sensor=_knock,
    doubt=_doubt,
)
