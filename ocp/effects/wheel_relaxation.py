"""The wheel's cover relaxes after it engages.

After engagement the cover's stiffness falls by the share g with time constant tau. Rubber as a standard linear solid
(DIAGNOSIS, catalogue): the force it lets go is -w g times the force through a first-order lag that starts at zero with every
run, w the wheel's share of the give of the chain.
"""

import numpy as np
from scipy.linalg import solve_banded

from ocp.effects.context import LogRows
from ocp.effects.effect import Effect, Parameter, Scanned
from ocp.effects.forms import proportional, tried
from robots.pose import Array

TIMES = (0.05, 0.15, 0.5, 1.5, 5.0, 15.0, 30.0)  # s


def _loss(x: LogRows, joint: int, scanned: Scanned) -> Array:
    """Force that the cover has let go: its share of the chain's give times the force seen through a first-order lag; in the air
    it recovers as fast."""
    n, goes_on = len(x.time), x.run[1:] == x.run[:-1]
    load = np.where(x.contact[:, None], x.F.reshape(n, -1), 0.0)
    taken = -np.expm1(-np.where(goes_on, np.diff(x.time), 0.0) / scanned["tau"])
    # held[k] = held[k - 1] + taken[k] (load[k] - held[k - 1]), zero where a run begins: two bands.
    bands = np.array([np.ones(n), np.append(np.where(goes_on, taken - 1.0, 0.0), 0.0)])
    held = solve_banded((1, 0), bands, np.append(0.0, taken)[:, None] * load, check_finite=False)  # nan is told by who asks
    return np.where(x.contact[:, None], -x.wheel_share[:, None] * held, 0.0)


EFFECT = Effect(
    name="wheel_relaxation",
    title="relaxation of the wheel's cover",
    subsystem="wheel",
    scan=tried(tau=TIMES),
    along=_loss,
    **proportional(
        Parameter("g", "1", 0.05, 0.25, signed=False), Parameter("tau", "s", 0.05, 30.0, signed=False), scanned=("tau",)
    ),
)
