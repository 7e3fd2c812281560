"""The wheel's cover relaxes after it engages.

After engagement the cover's stiffness falls by the share g with time constant tau. Rubber as a standard linear solid
(DIAGNOSIS, catalogue): of the elastic force E of its indentation it lets go g q, with dq/dt = (E - q) / tau from zero at the
start of every run. What it lets go, the rest of the chain gives back, and the cover is pressed in further: with w the wheel's
share of the give of the chain and F the force without relaxation, E = F + g q (1 - w), so

    dq/dt = (F - k q) / tau,   k = 1 - g (1 - w),   and the force falls by w g q.

It is linear at a given g only, the one that it acts as of.
"""

from collections.abc import Mapping
from typing import Any

import numpy as np
from scipy.linalg import solve_banded

from ocp.effects.context import LogRows
from ocp.effects.effect import Effect, Parameter, Scanned
from ocp.effects.forms import proportional, tried
from robots.pose import Array

TIMES = (0.05, 0.085, 0.15, 0.25, 0.42, 0.7, 1.2, 2.1, 3.6, 6.0, 10.0, 18.0, 30.0)  # s
USUAL, LEAST, MOST = 0.12, 0.01, 0.9  # of g: before it is known, and the limits of what it acts as of


def _loss(x: LogRows, joint: int, scanned: Scanned) -> Array:
    """Force that the cover has let go; in the air it recovers as fast."""
    n, goes_on = len(x.time), x.run[1:] == x.run[:-1]
    back = np.where(x.contact, 1.0 - scanned["acts_g"] * (1.0 - x.wheel_share), 1.0)
    load = np.where(x.contact[:, None], x.F.reshape(n, -1), 0.0) / back[:, None]
    taken = -np.expm1(-np.where(goes_on, np.diff(x.time), 0.0) * back[1:] / scanned["tau"])
    # held[k] = held[k - 1] + taken[k] (load[k] - held[k - 1]), zero where a run begins: two bands.
    bands = np.array([np.ones(n), np.append(np.where(goes_on, taken - 1.0, 0.0), 0.0)])
    held = solve_banded((1, 0), bands, np.append(0.0, taken)[:, None] * load, check_finite=False)  # nan is told by who asks
    return np.where(x.contact[:, None], -x.wheel_share[:, None] * held, 0.0)


def _own_size(a: Array) -> Scanned:
    return {"acts_g": float(np.clip(a[0], LEAST, MOST))}


SOLID = proportional(
    Parameter("g", "1", 0.05, 0.25, signed=False), Parameter("tau", "s", 0.05, 30.0, signed=False), scanned=("tau",)
)


def _of_table(values: Mapping[str, Any]) -> tuple[Array, dict[str, Any]]:
    a, scanned = SOLID["coefficients_of"](values)
    return a, {**scanned, **_own_size(a)}


EFFECT = Effect(
    name="wheel_relaxation",
    title="relaxation of the wheel's cover",
    subsystem="wheel",
    scan=tried(tau=TIMES, acts_g=(USUAL,)),
    along=_loss,
    own_size=_own_size,
    **SOLID | {"coefficients_of": _of_table},
)
