"""Where the motors really put the axes: encoders, gears, play and heat on top of what is commanded.

The output of an axis is q + dq (rad, the controller's signs) before its spring bends. Every function gives dq of the joint
that carries it; what depends on the load's torque is a spring's law (`ocp.simulate.twin.arm.statics`).
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from ocp.simulate.twin.truth.machine import Truth
from ocp.simulate.twin.truth.planting import Planted
from robots.errors import BadInput
from robots.pose import Array
from robots.robot import Robot, load_robot


@dataclass(frozen=True)
class AxisState:
    """What dq depends on: q (n, 6) rad commanded, sign (n, 6) of the last motion, warmth (n,) K over the reference, robot."""

    q: Array
    sign: Array
    warmth: Array
    robot: Robot


def motor_side(truth: Truth, state: AxisState) -> Array:
    """Axis angles (n, 6) rad behind the gears: background ripple and play, then every planted effect of the joints."""
    q, ripple = state.q, truth.ripple
    real = q + ripple[:, 0] * np.cos(ripple[:, 1] * q + ripple[:, 2]) + truth.play * state.sign
    for planted in truth.effects:
        law = _LAWS.get(planted.effect)
        if law is not None and planted.joint is not None:
            real[:, planted.joint - 1] += law(planted, planted.joint - 1, state)
    return np.asarray(real)


def gear_ratios(robot: Robot) -> Array:
    """Motor turns per turn of each axis (6,).

    The extra's are not published: it takes those of the prime, its sister with the same limits and speeds (PHYSICS 2.1).
    Raises BadInput: a robot of which none are known.
    """
    ratio = robot.gear_ratio
    if np.isfinite(ratio).all():
        return ratio
    if robot.name.startswith("kr210"):
        return load_robot("kr210_r2700_prime").gear_ratio
    raise BadInput(f"robot '{robot.name}' has no gear ratios, which motor_harmonic needs; add [gears] to its file")


def _harmonic(planted: Planted, order: Array | float, q: Array) -> Array:
    wave = np.cos(order * q + planted.number("phase_rad"))
    return np.asarray(planted.number("amplitude_rad") * wave)


def _gear_1x(p: Planted, j: int, s: AxisState) -> Array:
    return _harmonic(p, 1.0, s.q[:, j])


def _gear_2x(p: Planted, j: int, s: AxisState) -> Array:
    return _harmonic(p, 2.0, s.q[:, j])


def _gear_harmonic(p: Planted, j: int, s: AxisState) -> Array:
    return _harmonic(p, p.number("order"), s.q[:, j])


def _motor_harmonic(p: Planted, j: int, s: AxisState) -> Array:
    return _harmonic(p, p.number("order") * gear_ratios(s.robot)[j], s.q[:, j])


def _backlash(p: Planted, j: int, s: AxisState) -> Array:
    """The catalogue's sign: the axis rests on the side it came from, b ahead of the middle of its slack."""
    return p.number("half_width_rad") * s.sign[:, j]


def _friction_windup(p: Planted, j: int, s: AxisState) -> Array:
    """The part without load; the part with it is a spring's law."""
    return p.number("base_rad") * s.sign[:, j]


def _encoder_scale(p: Planted, j: int, s: AxisState) -> Array:
    return p.number("scale") * s.q[:, j]


def _wrist_coupling(p: Planted, j: int, s: AxisState) -> Array:
    return p.number("ratio") * s.q[:, int(p.number("source_joint")) - 1]


def _joint_thermal(p: Planted, j: int, s: AxisState) -> Array:
    return p.number("rad_per_K") * s.warmth


_LAWS: dict[str, Callable[[Planted, int, AxisState], Array]] = {
    "gear_1x": _gear_1x,
    "gear_2x": _gear_2x,
    "gear_harmonic": _gear_harmonic,
    "motor_harmonic": _motor_harmonic,
    "backlash": _backlash,
    "friction_windup": _friction_windup,
    "encoder_scale": _encoder_scale,
    "wrist_coupling": _wrist_coupling,
    "joint_thermal": _joint_thermal,
}
