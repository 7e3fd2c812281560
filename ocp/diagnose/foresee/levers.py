"""Experiments in words that no rows of the data can stand for: what each brings out, and how long it takes."""

from dataclasses import dataclass


@dataclass(frozen=True)
class Lever:
    """An experiment: what to do, minutes, effects whose signature it isolates or turns over (others keep theirs)."""

    do: str
    minutes: float
    moves: frozenset[str]


FORCE = (
    Lever(
        "second blade: the same line on a fresh blade of the same kind (session)",
        15.0, frozenset({"material_removal", "stock_profile", "blade_stiffness"}),
    ),
    Lever(
        "tilt: the same contact with the flange's axis turned up and down by 30 deg",
        8.0, frozenset({"flange_gravity", "sensor_bias"}),
    ),
)  # fmt: skip
JOINT = (
    Lever(
        "the same motion at half and at double speed",
        3.0, frozenset({"channel_delay", "joint_compliance", "friction_windup"}),
    ),
    Lever(
        "creep: every joint over its range at 1 deg/s and back, so that inertia and delay vanish",
        10.0, frozenset({"channel_delay", "backlash", "gear_1x", "gear_2x", "gear_harmonic", "motor_harmonic", "encoder_scale"}),
    ),
    Lever(
        "the same motion with a known payload",
        12.0, frozenset({"joint_compliance", "joint_stiffening", "gravity_compensator", "friction_windup", "payload_mass"}),
    ),
)  # fmt: skip
BY_SIGNAL = {"force": FORCE, "joint": JOINT}
