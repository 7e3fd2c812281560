"""The wheel's cover relaxes after it engages.

After engagement the cover's stiffness falls by the share g with time constant tau. Rubber as a standard linear solid
(DIAGNOSIS, catalogue): the force it lets go is -w g times the force through a first-order lag that starts at zero with every
run, w the wheel's share of the give of the chain.
"""

import numpy as np

from ocp.effects.context import LogRows
from ocp.effects.effect import Effect, Parameter, Scanned
from ocp.effects.forms import proportional, tried
from robots.pose import Array

TIMES = (0.05, 0.15, 0.5, 1.5, 5.0, 15.0, 30.0)  # s


def _loss(x: LogRows, joint: int, scanned: Scanned) -> Array:
    """Force that the cover has let go: its share of the chain's give times the force seen through a first-order lag; in the air
    it recovers as fast."""
    load = np.where(x.contact[:, None], x.F.reshape(len(x.time), -1), 0.0)
    out, held = np.zeros(load.shape), np.zeros(load.shape[1])
    for k in range(len(x.time)):
        if k == 0 or x.run[k] != x.run[k - 1]:
            held = np.zeros(load.shape[1])
        else:
            held = held + (load[k] - held) * -np.expm1(-(x.time[k] - x.time[k - 1]) / scanned["tau"])
        if x.contact[k]:
            out[k] = -x.wheel_share[k] * held
    return out


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
