"""Friction between belt and blade differs from the cell's.

The tangential force is (friction + dmu) F, and the share `leak` of it shows in the normal reading. Grain, wear and lubrication
change the believed friction; the force along the belt bends blade and arm across and so changes the overlap. A leak is there
because no sensor stands quite square (DIAGNOSIS, catalogue); where the reading falls as ft_N rises it is negative. ft
readings show dmu directly, a reversed belt the leak.
"""

from collections.abc import Mapping, Sequence
from typing import Any

import casadi as ca
import numpy as np

from ocp.effects.effect import Effect, Parameter, Scanned, Surroundings
from ocp.effects.forms import row
from robots.pose import Array

FRICTION = 0.35  # of a cell that does not say
LEAST = 0.02  # friction below which no share of it can be told


def _scan(joint: int, seen: Surroundings) -> Sequence[Scanned]:
    """Not a scan: the friction that the cell believes, of which the leak is a share."""
    return ({"friction": float(seen.friction)},)


def _values(a: Array, scanned: Scanned) -> dict[str, Any]:
    leak = a[1] / max(scanned["friction"] + a[0], LEAST)
    return {"dmu": float(a[0]), "leak": float(leak), "friction": scanned["friction"]}


def _coefficients(values: Mapping[str, Any]) -> tuple[Array, dict[str, Any]]:
    friction = values.get("friction", FRICTION)
    return np.array([values["dmu"], values.get("leak", 0.0) * max(friction + values["dmu"], LEAST)]), {"friction": friction}


EFFECT = Effect(
    name="tangential_force",
    title="tangential force",
    subsystem="wheel",
    parameters=(
        Parameter("dmu", "1", 0.05, 0.35),
        Parameter("leak", "1", 0.0, 0.1),
        Parameter("friction", "1", 0.0, 1.0, signed=False),
    ),
    coefficients=("dmu", "leaking_friction"),
    prior_sd=(0.35, 0.035),
    values=_values,
    coefficients_of=_coefficients,
    scan=_scan,
    overlap=lambda x, j, scanned: row(-x.friction_deflection, 0.0),
    sensor=lambda x, j, scanned: row(0.0, x.F * ca.sign(x.belt)),
    shear=lambda x, j, scanned: row(x.F * ca.sign(x.belt), 0.0),
)
