"""Effects of the robot and the tracker: names, keys and typical ranges of the catalogue (project DIAGNOSIS, first table)."""

from ocp.simulate.twin.truth.planting import Key, Kind

ALL = (1, 2, 3, 4, 5, 6)
BENDING = (2, 3, 4, 5, 6)  # joint 1 stands upright: nothing hangs on its spring
# c3 tau^2 / c is the share at the joint's rated torque; 1 / (k tau^2) of a KR 210 is the unit of c3 (PHYSICS 2.1, 2.5).
_CUBIC = (9.4e-15, 4.6e-15, 1.45e-14, 4.2e-13, 1.74e-12, 4.9e-12)
# While a step of a campaign happens, s: inside a campaign of three hours, away from its ends.
_LATE = (1000.0, 8000.0)


def _phase() -> Key:
    return Key("phase_rad", "rad", 0.0, 6.283185307179586, False, 0.0, uniform=True)


def _at() -> Key:
    return Key("at_s", "s", *_LATE, False, None, uniform=True)


def _gear(name: str) -> Kind:
    return Kind(name, ALL, (Key("amplitude_rad", "rad", 2e-5, 6e-4, False, None), _phase()), "arm")


KINDS: tuple[Kind, ...] = (
    # dq = c tau, in series with the joint's own spring
    Kind("joint_compliance", ALL, (Key("rad_per_Nm", "rad/(N m)", 0.3e-6, 5e-6, False, None),), "arm"),
    # dq = -c3 tau^3
    Kind("joint_stiffening", BENDING, (Key("rad_per_Nm3", "rad/(N m)^3", 0.05, 0.3, False, None, scale=_CUBIC),), "arm"),
    # a beam: its end turns by k M, M the mean bending moment along it
    Kind("link_bending", (2, 3), (Key("rad_per_Nm", "rad/(N m)", 1e-8, 2e-7, False, None),), "arm"),
    # a spring between link 1 (above axis 2) and the upper arm, both anchors so far from axis 2
    Kind(
        "gravity_compensator",
        (2,),
        (
            Key("stiffness_N_m", "N/m", 2e4, 3e5, False, None),
            Key("lever_link1_m", "m", 0.1, 0.6, False, 0.2),
            Key("lever_arm_m", "m", 0.1, 0.6, False, 0.2),
        ),
        "arm",
    ),
    # of every payload that weighs something
    Kind("payload_mass", (), (Key("kg", "kg", 0.5, 25.0, False, None),), "arm"),
    Kind("payload_com", (), (Key("shift_m", "m", 0.005, 0.12, True, None, 3),), "arm"),
    # A cos(k q + phase)
    _gear("gear_1x"),
    _gear("gear_2x"),
    Kind(
        "gear_harmonic",
        ALL,
        (Key("amplitude_rad", "rad", 3e-5, 2e-4, False, None), Key("order", "1", 3, 300, False, None, integer=True), _phase()),
        "arm",
    ),
    # A cos(k R q + phase), R the gear's ratio
    Kind(
        "motor_harmonic",
        ALL,
        (
            Key("amplitude_rad", "rad", 2e-5, 2e-4, False, None),
            Key("order", "1", 1, 2, False, 1.0, uniform=True, integer=True),
            _phase(),
        ),
        "arm",
    ),
    # b s, s the approach's sign
    Kind("backlash", ALL, (Key("half_width_rad", "rad", 2e-5, 8e-4, False, None),), "arm"),
    # (b0 + h |tau|) s
    Kind(
        "friction_windup",
        ALL,
        (Key("base_rad", "rad", 2e-5, 2e-4, False, None), Key("per_Nm", "rad/(N m)", 2e-8, 1e-7, False, None)),
        "arm",
    ),
    # e q
    Kind("encoder_scale", ALL, (Key("scale", "1", 1e-5, 4e-4, True, None),), "arm"),
    # dq_j = k q_i
    Kind(
        "wrist_coupling",
        (4, 5, 6),
        (Key("ratio", "1", 1e-4, 3e-3, True, None), Key("source_joint", "1", 4, 6, False, 4.0, integer=True)),
        "arm",
    ),
    # lengths of all links times 1 + alpha (T - T0)
    Kind("link_thermal", (), (Key("per_K", "1/K", 4e-6, 2.5e-5, False, None),), "arm"),
    # g (T - T0)
    Kind("joint_thermal", ALL, (Key("rad_per_K", "rad/K", 1e-6, 2e-5, True, None),), "arm"),
    # the base turns by this rotation vector, at a time
    Kind("base_tilt", (), (Key("rad", "rad", 5e-6, 2e-4, True, None, 3), _at()), "arm"),
    # readings move and turn about the head, proportional to time
    Kind(
        "tracker_drift",
        (),
        (Key("m_per_h", "m/h", 5e-6, 8e-5, True, None, 3), Key("rad_per_h", "rad/h", 1e-6, 2e-5, True, None, 3)),
        "tracker",
    ),
    # readings times 1 + scale
    Kind("tracker_scale", (), (Key("scale", "1", 1e-6, 1e-5, True, None),), "tracker"),
    # one nest moves, in its link's frame, at a time
    Kind(
        "target_shift",
        (),
        (Key("shift_m", "m", 5e-5, 4e-4, True, None, 3), Key("target", "name", 0, 0, False, None), _at()),
        "tracker",
    ),
    # one recorded channel behind the others (joints.csv, force.csv)
    Kind("channel_delay", ALL, (Key("s", "s", 1e-3, 5e-2, False, None),), "timing", common=True),
)  # fmt: skip
