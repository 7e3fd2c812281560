"""The blade slips in its clamp.

From at_s on the blade stands m further back along its normal; with `normal` (3) by the part along that side's. The time is on
the campaign's clock; grinding pushes the blade back, a negative m is into the wheel (DIAGNOSIS, catalogue). A blade that is
ground on both sides comes nearer to the wheel with the other one: with `normal`, blade frame, that of the side that was ground
then, the step is m times the contact's normal along it; 0, 0, 0: the same everywhere. Both are tried.
"""

from collections.abc import Mapping, Sequence
from typing import Any

import casadi as ca
import numpy as np

from ocp.effects.context import ContactContext
from ocp.effects.effect import Effect, Parameter, Scanned, Surroundings
from ocp.effects.forms import AT_S, INSTANTS, after, row, steps
from robots.pose import Array

NOWHERE = (0.0, 0.0, 0.0)


def _scan(joint: int, seen: Surroundings) -> Sequence[Scanned]:
    sides = [NOWHERE, *(seen.sides[:1] if len(seen.sides) > 1 else ())]
    # A log of many short runs stands still between them for most of its time.
    between = [{"at_s": float(t)} for t in seen.breaks][: 4 * INSTANTS]
    return [{"at_s": s["at_s"], "side": side} for side in sides for s in (*steps(joint, seen), *between)]


def _slip(x: ContactContext, j: int, scanned: Scanned) -> ca.SX:
    side = scanned.get("side", NOWHERE)
    along = ca.dot(ca.DM(list(side)), x.n) if any(side) else 1.0
    return row(-after(x.clock, scanned["at_s"]) * along)


def _values(a: Array, scanned: Scanned) -> dict[str, Any]:
    side = np.asarray(scanned.get("side", NOWHERE), float)
    # With a side positive is away from the wheel, where the blade was ground then.
    sign = -1.0 if side.any() and a[0] < 0 else 1.0
    return {"m": float(sign * a[0]), "at_s": scanned["at_s"], "normal": [float(sign * v) for v in side]}


def _coefficients(values: Mapping[str, Any]) -> tuple[Array, dict[str, Any]]:
    side = tuple(float(v) for v in values.get("normal", NOWHERE))
    return np.array([float(values["m"])]), {"at_s": values["at_s"], "side": side}


EFFECT = Effect(
    name="clamp_slip",
    title="slip in the clamp",
    subsystem="blade",
    parameters=(Parameter("m", "m", 2e-5, 3e-4), AT_S, Parameter("normal", "1", 0.0, 1.0, length=3)),
    coefficients=("m",),
    prior_sd=(3e-4,),
    values=_values,
    coefficients_of=_coefficients,
    needs=("clock_s",),
    scan=_scan,
    symbolic=("at_s",),
    overlap=_slip,
)
