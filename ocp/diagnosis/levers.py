"""Experiments in words for signals whose new rows are not simulated: what each brings out, and how long it takes."""

from dataclasses import dataclass


@dataclass(frozen=True)
class Lever:
    """An experiment: what to do, minutes, effects whose signature it isolates or turns over (others keep theirs)."""

    do: str
    minutes: float
    moves: frozenset[str]


FORCE = (
    Lever(
        "air run: retract the flange and run every recorded line once in the air, contact = 0",
        4.0, frozenset({"sensor_bias", "sensor_drift", "flange_gravity"}),
    ),
    Lever(
        "force ladder: the same line at 10, 15, 20, 25 and 30 N (setpoint_N)",
        8.0,
        frozenset({"wheel_stiffness", "wheel_law", "blade_stiffness", "sensor_gain", "clamp_compliance", "flange_stiffness"}),
    ),
    Lever(
        "feed ladder: the same line at 20, 40 and 80 mm/s (feed_mm_s)",
        6.0, frozenset({"time_delay", "wheel_relaxation", "material_removal", "channel_delay", "wheel_runout"}),
    ),
    Lever(
        "belt stop: press with the belt stopped, then with it reversed (belt_m_s = 0, -v)",
        5.0,
        frozenset({"tangential_force", "sensor_crosstalk", "wheel_runout", "belt_splice", "wheel_wear", "wheel_temperature"}),
    ),
    Lever(
        "wheel speed change: the same line at half the belt speed (belt_m_s)",
        4.0, frozenset({"wheel_runout", "belt_splice", "wheel_wear", "wheel_temperature"}),
    ),
    Lever(
        "both directions: the same line from root to tip and back",
        4.0, frozenset({"path_lag", "flange_friction", "time_delay", "backlash", "friction_windup", "stock_profile"}),
    ),
    Lever(
        "tap test: press the blade against the wheel at rest in six places from clamp to tip, 5 to 30 N",
        12.0,
        frozenset({"blade_stiffness", "clamp_compliance", "wheel_stiffness", "wheel_law", "wheel_relaxation", "flange_friction"}),
    ),
    Lever(
        "hold test: press 20 N at one point for a minute, lift, press again",
        4.0, frozenset({"wheel_relaxation", "sensor_drift", "wheel_temperature", "flange_friction"}),
    ),
    Lever(
        "repeat and pause: one line five times, half an hour's pause, the same line again (clock_s, wheel_temperature_C)",
        40.0, frozenset({"wheel_wear", "wheel_temperature", "sensor_drift", "material_removal", "clamp_slip", "joint_thermal"}),
    ),
    Lever(
        "second blade: the same line on a fresh blade of the same kind (session)",
        15.0, frozenset({"material_removal", "stock_profile", "blade_stiffness", "clamp_slip", "tool_frame_shift"}),
    ),
    Lever(
        "tilt: the same contact with the flange's axis turned up and down by 30 deg",
        8.0, frozenset({"flange_gravity", "sensor_bias"}),
    ),
    Lever(
        "tracker campaign of 60 readings with all payloads, both approach directions",
        50.0,
        frozenset({
            "backlash", "friction_windup", "gear_1x", "gear_2x", "gear_harmonic", "motor_harmonic", "encoder_scale",
            "joint_compliance", "gravity_compensator", "wrist_coupling", "base_tilt", "link_bending", "link_thermal",
        }),
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
