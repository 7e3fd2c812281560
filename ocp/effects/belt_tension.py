"""A tight belt presses on edges and strongly curved places."""

from collections.abc import Mapping, Sequence
from typing import Any

import casadi as ca
import numpy as np

from ocp.effects.context import ContactContext
from ocp.effects.effect import Effect, Parameter, Scanned, Surroundings
from ocp.effects.forms import row
from robots.pose import Array

HALF = (10.0, 50.0, 250.0)  # 1/m of blade curvature at which half of the force acts


def _scan(joint: int, seen: Surroundings) -> Sequence[Scanned]:
    return [{"half_per_m": k} for k in HALF]


def _extra(x: ContactContext, j: int, scanned: Scanned) -> ca.SX:
    blade = ca.fmax(x.curvature[0] - 1.0 / x.radius, 0.0) + ca.fmax(x.curvature[1], 0.0)
    return row(blade / (blade + scanned["half_per_m"]) * ca.if_else(x.F > 0, 1.0, 0.0))


def _coefficients(values: Mapping[str, Any]) -> tuple[Array, dict[str, Any]]:
    return np.array([values["N"]]), {"half_per_m": values.get("half_per_m", HALF[1])}


EFFECT = Effect(
    name="belt_tension",
    title="tension of the belt",
    subsystem="wheel",
    physics="A belt under tension that is bent over a convex blade presses on it as a rope on a pulley, more the more it is "
    "curved: extra normal force N k / (k + half_per_m), k the blade's convex curvature along and across the belt, so that N is "
    "what a sharp edge feels (DIAGNOSIS, catalogue: extra force at high curvature and edges).",
    parameters=(Parameter("N", "N", 1.0, 10.0, signed=False), Parameter("half_per_m", "1/m", 10.0, 250.0, signed=False)),
    coefficients=("N",),
    prior_sd=(10.0,),
    values=lambda a, scanned: {"N": float(a[0]), "half_per_m": scanned["half_per_m"]},
    coefficients_of=_coefficients,
    scan=_scan,
    symbolic=("half_per_m",),
    push=_extra,
)
