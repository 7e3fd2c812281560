"""What effects add to the link-side angles: the hooks of the catalogue, evaluated at the recorded motion and load.

A link-side encoder sees what lies between motor and link: hooks `joint`, and `torque` through the joint's spring where the
load was not recorded (a recorded load holds every weight already). The delay of a channel is the encoder's own: the motor's
angle of a moment ago is what the link shows now, column -speed (docs/diagnose.md, eq. 1).
"""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from ocp.diagnose.joints.signals import Signals
from ocp.effects.effect import Effect, Scanned
from ocp.effects.engine.compiled import Hook, evaluated
from ocp.effects.engine.rows import ARM_LAYOUT, ArmRows, arm_rows
from robots.calibration.reading_model import RowInputs
from robots.compliance import compliance_from_stiffness
from robots.pose import Array
from robots.robot import Robot
from robots.tracker_readings import Hanging

DELAY = "channel_delay"


def seen(effect: Effect) -> bool:
    """Whether a link-side encoder can see the effect at all."""
    return effect.joint is not None or effect.torque is not None


def rows_of(signals: Signals, robot: Robot, payload: Hanging) -> ArmRows:
    """The arm at the instants of a log: the believed arm with the recorded loads in place of its own."""
    n = len(signals.log)
    none = np.zeros((n, 3))
    hung = np.broadcast_to([payload.mass, *payload.com], (n, 4))
    arm = np.concatenate([robot.mdh.ravel(), compliance_from_stiffness(robot.stiffness)])
    inputs = RowInputs(signals.log.q, hung, np.zeros((n, 6)), none, none)
    rows = arm_rows(
        robot, arm, inputs, ("",), approach=signals.direction, warm=np.zeros(n), time=signals.log.time, speed=signals.qd
    )
    start = 0
    for name, size in ARM_LAYOUT.sizes:
        if name == "tau":
            rows.state[:, start : start + size] = signals.tau
        start += size
    return rows


def delay_columns(signals: Signals, joint: int, delays: Array) -> Array:
    """Angle (n, 6) rad of each link per s of delay of one joint's link side (0: of all), about the delays (6,) s."""
    out = np.zeros_like(signals.log.q)
    for j in signals.log.joints:
        if joint in (0, j):
            out[:, j - 1] = -signals.speed(j, float(delays[j - 1]))
    return out


def effect_columns(effect: Effect, joint: int, scans: Sequence[Scanned], rows: ArmRows, recorded: NDArray[np.bool_]) -> Array:
    """Angles (variants, n, 6, m) rad of the links per unit coefficient; recorded (6,): whose load was recorded."""
    total = np.zeros((len(scans), len(rows), 6, effect.size))
    if effect.joint is not None:
        total += evaluated(Hook(effect, "joint", joint, ARM_LAYOUT, rows.place), rows.state, scans)[-1]
    if effect.torque is not None:
        share = rows.block("c") * np.where(recorded, 0.0, 1.0)
        total += share[None, :, :, None] * evaluated(Hook(effect, "torque", joint, ARM_LAYOUT, rows.place), rows.state, scans)[-1]
    return total
