"""Planted effects that are parts of the machine: springs, hinges inside links, a tendon, masses, growth, a base that tilts."""

from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from ocp.simulate.twin.arm.machine import Balancer, Bending, Design
from ocp.simulate.twin.arm.statics import Laws
from ocp.simulate.twin.truth.machine import Truth
from robots.pose import Array
from robots.robot import Robot


@dataclass(frozen=True)
class Hardware:
    """The machine with its planted parts: design, laws of the springs, compliance (ns,) rad/(N m) of every spring under
    contact, and its cubic part in `laws`."""

    design: Design
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
    give: dict[int, float] = {}
    for planted in truth.planted("link_bending"):
        joint = planted.joint or 2
        give[joint] = give.get(joint, 0.0) + planted.number("rad_per_Nm")
    bendings = tuple(Bending(joint, give[joint]) for joint in sorted(give))
    springs = np.array([planted.number("stiffness_N_m") for planted in truth.planted("gravity_compensator")])
    levers = [(p.number("lever_link1_m"), p.number("lever_arm_m")) for p in truth.planted("gravity_compensator")]
    balancer = Balancer(float(springs.sum()), levers[0]) if levers else None
    design = Design(
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
