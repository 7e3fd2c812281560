"""A ripple of a joint once or twice per turn of its motor.

dq = amplitude_rad cos(order gear_ratio q + phase_rad): an eccentric first stage. Stage, resolver or coupling repeat with the
motor, order 1 or 2 (DIAGNOSIS, catalogue). The KR 210 extra's ratios are not published; those of its two sister machines are
tried in their place (PHYSICS 2.1), other robots without ratios are not tested. phase_rad counts from the commanded axis at
zero.
"""

from collections.abc import Sequence

import numpy as np

from ocp.effects.effect import Effect, Parameter, Scanned, Surroundings
from ocp.effects.forms import at_joint, cosines, wave

ORDERS = (1, 2)
# Motor turns per turn of the axis of the machines that share the extra's name (PHYSICS 2.1): prime, -2.
SISTERS = ((256.857, 252.909, 236.368, 198.9, 209.667, 131.151), (256.857, 269.176, 251.333, 188.855, 190.133, 131.277))


def ratios(joint: int, seen: Surroundings) -> list[float]:
    """Gear ratios that joint 1..6 may have: the robot's own, else those of its sisters, else none."""
    known = seen.gear_ratio[joint - 1]
    if np.isfinite(known):
        return [float(known)]
    return sorted({sister[joint - 1] for sister in SISTERS}) if seen.robot in ("", "kr210_r2700_extra") else []


def ratios_of(seen: Surroundings) -> tuple[tuple[float, ...], ...]:
    """The same of all six joints."""
    return tuple(tuple(ratios(j, seen)) for j in range(1, 7))


def _scan(joint: int, seen: Surroundings) -> Sequence[Scanned]:
    return [{"order": k, "gear_ratio": ratio} for ratio in ratios(joint, seen) for k in ORDERS]


EFFECT = Effect(
    name="motor_harmonic",
    title="motor-side ripple of joint {joint}",
    subsystem="joint",
    joints=(1, 2, 3, 4, 5, 6),
    scan=_scan,
    symbolic=("order", "gear_ratio"),
    joint=lambda x, j, scanned: at_joint(j, *cosines(scanned["order"] * scanned["gear_ratio"] * x.q[j - 1])),
    **wave(
        Parameter("order", "1", 1, 2, signed=False),
        Parameter("amplitude_rad", "rad", 2e-5, 2e-4, signed=False),
        Parameter("gear_ratio", "1", 50, 300, signed=False),
        scanned=("order", "gear_ratio"),
    ),
)
