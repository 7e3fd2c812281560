"""The robot's base tilts during a campaign, at once or slowly.

The robot turns about its base's origin by rad (3), at once at at_s or evenly until until_s. The pedestal gives or its anchors
slip. The rotation vector has base axes, times are on the campaign's clock. A tilt from the start belongs to the tracker's
frame. That the weight's direction turns too is left out (below 1 um at the largest tilt). Without reflectors on the floor a
tilt of the tracker looks the same.
"""

from collections.abc import Mapping, Sequence
from typing import Any

import casadi as ca
import numpy as np

from ocp.effects.context import ArmContext
from ocp.effects.effect import Effect, Parameter, Scanned, Surroundings
from ocp.effects.forms import AT_S, after, instants, proportional
from robots.pose import Array

_FORM = proportional(
    Parameter("rad", "rad", 5e-6, 2e-4, length=3),
    AT_S,
    Parameter("until_s", "s", 0.0, 1e5, signed=False),
    scanned=("at_s", "until_s"),
)


def _scan(joint: int, seen: Surroundings) -> Sequence[Scanned]:
    at = [{"at_s": float(t), "until_s": float(t)} for t in instants(seen.time)]
    known = np.asarray(seen.time, float)[np.isfinite(seen.time)]
    drift = [{"at_s": float(known.min()), "until_s": float(known.max())}] if len(at) else []
    return drift + at


def _tilt(x: ArmContext, j: int, scanned: Scanned) -> dict[int, ca.SX]:
    start, end = scanned["at_s"], scanned["until_s"]
    ramp = ca.fmin(ca.fmax((x.time - start) / ca.fmax(end - start, 1e-9), 0.0), 1.0)
    share = ca.if_else(end > start, ramp, after(x.time, start))
    return {0: ca.vertcat(ca.SX.zeros(3, 3), share * ca.SX.eye(3))}


def _coefficients(values: Mapping[str, Any]) -> tuple[Array, dict[str, Any]]:
    """Without until_s a step."""
    return _FORM["coefficients_of"]({"until_s": values["at_s"], **values})


EFFECT = Effect(
    name="base_tilt",
    title="tilt of the base",
    subsystem="base",
    needs=("time_s",),
    scan=_scan,
    symbolic=("at_s", "until_s"),
    twist=_tilt,
    **(_FORM | {"coefficients_of": _coefficients}),
)
