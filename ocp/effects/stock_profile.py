"""The blade's surface differs from its drawing, smoothly along the passes.

Stock over the drawing: a constant and the sum of profile_m[k] sqrt(2) cos(k pi (s - from_m) / length_m), k = 1 to 6, together m
rms; one for all, or for each of `lines`. s is negative where the wheel comes on. Forged or cast stock stands over it by a smooth
function of s that repeats with the blade, positive where there is more material; seven numbers each, neighbouring lines share
one where there are more than five. m is the rms size without the constants (DIAGNOSIS, catalogue).
"""

from collections.abc import Mapping, Sequence
from typing import Any

import casadi as ca
import numpy as np

from ocp.effects.context import ContactContext
from ocp.effects.effect import Effect, Parameter, Scanned, Surroundings
from ocp.effects.forms import row
from robots.pose import Array

WAVES = 7  # a constant and up to six half waves along the longest pass
GROUPS = 5  # lines, or groups of neighbouring lines, with a profile of their own
SPAN = (0.0, 0.2)  # m, begin and length, where a log has no s
LARGEST = 2e-4  # m rms, and of the constant
_SMOOTH = 1.0 / np.sqrt(np.arange(1.0, WAVES))  # the shorter the wave the smaller
SD = np.concatenate([[LARGEST], LARGEST * _SMOOTH / np.linalg.norm(_SMOOTH)])  # m; waves of these sizes are LARGEST rms


def _groups(lines: Sequence[float]) -> list[list[float]]:
    """Lines in at most GROUPS groups of neighbours; without lines one group that holds all."""
    return [list(part) for part in np.array_split(np.asarray(lines), min(GROUPS, len(lines)))] if len(lines) else [[]]


def _scan(joint: int, seen: Surroundings) -> Sequence[Scanned]:
    start, length = seen.span if seen.span[1] > 0 else SPAN
    one_or_each: tuple[list[float], ...] = ([], [float(k) for k in seen.lines])
    return [{"from_m": start, "length_m": length, "lines": lines} for lines in one_or_each if len(lines) != 1]


def _profile(x: ContactContext, j: int, scanned: Scanned) -> ca.SX:
    share = (x.s - scanned["from_m"]) / scanned["length_m"]
    waves = [ca.SX(1.0)] + [np.sqrt(2.0) * ca.cos(k * np.pi * share) for k in range(1, WAVES)]
    groups = _groups(scanned["lines"])
    columns: list[ca.SX] = []
    for g in range(GROUPS):
        here = ca.SX(0)
        if g < len(groups):
            here = sum((ca.if_else(x.line == k, 1.0, 0.0) for k in groups[g]), ca.SX(0)) if groups[g] else ca.SX(1)
        columns += [here * wave for wave in waves]
    return row(*columns)


def _values(a: Array, scanned: Scanned) -> dict[str, Any]:
    used = np.reshape(a, (GROUPS, WAVES))[: len(_groups(scanned["lines"])), 1:]
    size = float(np.sqrt(np.mean(np.sum(used**2, axis=1))))
    return {"m": size, "profile_m": [float(v) for v in a], **scanned, "lines": list(scanned["lines"])}


def _coefficients(values: Mapping[str, Any]) -> tuple[Array, dict[str, Any]]:
    span = {key: values.get(key, usual) for key, usual in zip(("from_m", "length_m"), SPAN, strict=True)}
    scanned = span | {"lines": list(values.get("lines", []))}
    return np.asarray(values["profile_m"], float).reshape(GROUPS * WAVES), scanned


EFFECT = Effect(
    name="stock_profile",
    title="stock of the blade",
    subsystem="blade",
    parameters=(
        Parameter("m", "m", 5e-5, LARGEST, signed=False),
        Parameter("profile_m", "m", 0.0, LARGEST, length=GROUPS * WAVES),
        Parameter("from_m", "m", 0.0, 1.0),
        Parameter("length_m", "m", 0.05, 1.0, signed=False),
        Parameter("lines", "1", 1, 100, length=0),
    ),
    coefficients=tuple(f"group_{g + 1}_wave_{k}" for g in range(GROUPS) for k in range(WAVES)),
    prior_sd=tuple(np.tile(SD, GROUPS).tolist()),
    values=_values,
    coefficients_of=_coefficients,
    needs=("s_mm",),
    scan=_scan,
    overlap=_profile,
)
