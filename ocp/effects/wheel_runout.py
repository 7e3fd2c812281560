"""The wheel runs out of true."""

from collections.abc import Mapping, Sequence
from typing import Any

import casadi as ca

from ocp.effects.context import ContactContext
from ocp.effects.effect import Effect, Parameter, Scanned, Surroundings
from ocp.effects.forms import row, wave
from robots.pose import Array

_WAVE = wave("m")


def _scan(joint: int, seen: Surroundings) -> Sequence[Scanned]:
    return [{"clocked": clocked} for clocked in (0.0, 1.0)]


def _runout(x: ContactContext, j: int, scanned: Scanned) -> ca.SX:
    time = ca.if_else(scanned["clocked"] > 0.5, x.clock, x.time)
    angle = x.belt / x.radius * time
    return row(ca.cos(angle), ca.sin(angle))


def _values(a: Array, scanned: Scanned) -> dict[str, Any]:
    return _WAVE["values"](a, {}) | {"clocked": scanned["clocked"]}


def _coefficients(values: Mapping[str, Any]) -> tuple[Array, dict[str, Any]]:
    return _WAVE["coefficients_of"](values)[0], {"clocked": values.get("clocked", 1.0)}


EFFECT = Effect(
    name="wheel_runout",
    title="runout of the wheel",
    subsystem="wheel",
    physics="Once per revolution the radius is m larger: overlap = m cos(w t + phase), w = belt speed / radius. t is the "
    "campaign's clock (clocked 1: the wheel keeps turning between runs) or the time of the run (clocked 0: each run starts at "
    "the same angle); both are tried.",
    parameters=(
        Parameter("m", "m", 1e-5, 1e-4, signed=False),
        Parameter("phase_rad", "rad", 0.0, 3.15),
        Parameter("clocked", "1", 0, 1, signed=False),
    ),
    coefficients=("cos", "sin"),
    prior_sd=(1e-4, 1e-4),
    values=_values,
    coefficients_of=_coefficients,
    needs=("time_s",),
    scan=_scan,
    symbolic=("clocked",),
    overlap=_runout,
)
