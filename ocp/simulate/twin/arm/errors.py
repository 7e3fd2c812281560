"""What hidden errors and planted effects do to the arm: to the angles behind its gears, and to the machine that is built.

The output of an axis is q + dq (rad, the controller's signs) before its spring bends; what depends on the load's torque is a
spring's law (`ocp.simulate.twin.arm.statics`). Parts of the machine are springs, hinges inside links, a tendon, masses, growth,
a base that tilts.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from ocp.simulate.twin.arm.machine import ArmDesign, Balancer, Bending
from ocp.simulate.twin.arm.statics import Laws
from ocp.simulate.twin.truth.planting import Planted
from ocp.simulate.twin.truth.truth import Truth
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


_LAWS: dict[str, Callable[[Planted, int, AxisState], Array]] = {
    "gear_1x": lambda p, j, s: _harmonic(p, 1.0, s.q[:, j]),
    "gear_2x": lambda p, j, s: _harmonic(p, 2.0, s.q[:, j]),
    "gear_harmonic": lambda p, j, s: _harmonic(p, p.number("order"), s.q[:, j]),
    "motor_harmonic": lambda p, j, s: _harmonic(p, p.number("order") * gear_ratios(s.robot)[j], s.q[:, j]),
    # The catalogue's sign: the axis rests on the side it came from, b ahead of the middle of its slack.
    "backlash": lambda p, j, s: p.number("half_width_rad") * s.sign[:, j],
    # The part without load; the part with it is a spring's law.
    "friction_windup": lambda p, j, s: p.number("base_rad") * s.sign[:, j],
    "encoder_scale": lambda p, j, s: p.number("scale") * s.q[:, j],
    "wrist_coupling": lambda p, j, s: p.number("ratio") * s.q[:, int(p.number("source_joint")) - 1],
    "joint_thermal": lambda p, j, s: p.number("rad_per_K") * s.warmth,
}


@dataclass(frozen=True)
class Hardware:
    """The machine with its planted parts: design, laws of the springs, compliance (ns,) rad/(N m) of every spring under
    contact, and its cubic part in `laws`."""

    design: ArmDesign
    laws: Laws
    contact_compliance: Array


def hardware(robot: Robot, truth: Truth) -> Hardware:
    """What to build: the truth's springs, in series with those that are planted."""
    own = np.divide(1.0, truth.stiffness, out=np.zeros(6), where=truth.stiffness > 0)
    extra, cubic, windup = np.zeros(6), np.zeros(6), np.zeros(6)
    for planted in truth.effects:
        at = (planted.joint or 1) - 1
        if planted.effect == "joint_compliance":
            extra[at] += planted.number("rad_per_Nm")
        elif planted.effect == "joint_stiffening":
            cubic[at] += planted.number("rad_per_Nm3")
        elif planted.effect == "friction_windup":
            windup[at] += planted.number("per_Nm")
    compliance: dict[int, float] = {}
    for planted in truth.planted("link_bending"):
        joint = planted.joint or 2
        compliance[joint] = compliance.get(joint, 0.0) + planted.number("rad_per_Nm")
    bendings = tuple(Bending(joint, compliance[joint]) for joint in sorted(compliance))
    springs = np.array([planted.number("stiffness_N_m") for planted in truth.planted("gravity_compensator")])
    levers = [(p.number("lever_link1_m"), p.number("lever_arm_m")) for p in truth.planted("gravity_compensator")]
    balancer = Balancer(float(springs.sum()), levers[0]) if levers else None
    design = ArmDesign(
        robot,
        truth.mdh,
        truth.placement,
        truth.mass_scale,
        own * truth.bends + extra,
        bendings,
        balancer,
        grows=bool(truth.planted("link_thermal")),
    )
    none = np.zeros(2 * len(bendings))  # two hinges a link
    contact = np.array([*(own + extra), *(0.5 * b.compliance for b in bendings for _ in range(2))])
    return Hardware(design, Laws(np.array([*cubic, *none]), np.array([*windup, *none])), contact)


def hung(truth: Truth, name: str) -> tuple[float, Array]:
    """Mass kg and centre (3,) m of a payload as it is: planted errors are of every payload that weighs something."""
    mass, com = truth.payloads[name] if name else (0.0, np.zeros(3))
    more = sum(planted.number("kg") for planted in truth.planted("payload_mass")) if mass > 0 else 0.0
    shift = sum((planted.vector("shift_m") for planted in truth.planted("payload_com")), np.zeros(3))
    return max(mass + more, 0.0), com + shift


def growth(truth: Truth, warmth: Array) -> Array:
    """Relative growth (n,) of all lengths at `warmth` (n,) K above the reference temperature."""
    return np.asarray(sum(p.number("per_K") for p in truth.planted("link_thermal")) * warmth, float) + np.zeros(len(warmth))


def base_tilt(truth: Truth, time_s: Array) -> Array | None:
    """Quaternions (n, 4), w first, of the base at times (n,) s; None where it never tilts."""
    steps = truth.planted("base_tilt")
    if not steps:
        return None
    turn = np.zeros((len(time_s), 3))
    for planted in steps:
        turn += np.where(time_s[:, None] >= planted.number("at_s"), planted.vector("rad"), 0.0)
    return np.asarray(Rotation.from_rotvec(turn).as_quat(scalar_first=True))
