"""Effects of contact, force reading and timing: names, keys and typical ranges of the catalogue (DIAGNOSIS, second table).

What each does to the virtual cell stands in docs/virtual_grinding.md; `at_s` counts on the campaign's clock.
"""

from ocp.simulate.twin.truth.planting import Key, Kind

# While a step of a grinding campaign happens, s on its clock: inside a campaign of twenty minutes, away from its ends.
_DURING = (120.0, 1000.0)
_TURN = 6.283185307179586


def _size(name: str, unit: str, low: float, high: float, signed: bool = False) -> Key:
    return Key(name, unit, low, high, signed, None)


def _at() -> Key:
    return Key("at_s", "s", *_DURING, False, None, uniform=True)


def _kind(name: str, part: str, *keys: Key) -> Kind:
    return Kind(name, (), keys, part)


KINDS: tuple[Kind, ...] = (
    # force of the cover times 1 + scale
    _kind("wheel_stiffness", "contact", _size("scale", "1", 0.03, 0.3, True)),
    # F = 20 N (F_believed(overlap) / 20 N)^(1 + exponent)
    _kind("wheel_law", "contact", _size("exponent", "1", 0.05, 0.6)),
    # standard linear solid: the force falls by the share g at constant overlap, with the time constant tau
    _kind("wheel_relaxation", "contact", _size("g", "1", 0.05, 0.25), _size("tau", "s", 0.05, 30.0)),
    # radius falls with the clock, in contact only where there is no clock
    _kind("wheel_wear", "contact", _size("m_per_s", "m/s", 2e-8, 1e-6)),
    # modulus times 1 + per_K dT, radius plus radius_per_K dT
    _kind(
        "wheel_temperature",
        "contact",
        Key("per_K", "1/K", -0.01, -0.003, False, -0.0055, uniform=True),
        _size("radius_per_K", "m/K", 2e-6, 1e-5),
    ),
    # radius plus m cos(angle turned + phase)
    _kind("wheel_runout", "contact", _size("m", "m", 1e-5, 1e-4), Key("phase_rad", "rad", 0.0, _TURN, False, 0.0, uniform=True)),
    # a push of N at its top, hz times a second
    _kind("belt_splice", "contact", _size("N", "N", 1.0, 10.0), Key("hz", "1/s", 5.0, 15.0, False, 10.0, uniform=True)),
    # N times a share that is 1 at an edge and rises with the blade's curvature
    _kind("belt_tension", "contact", _size("N", "N", 1.0, 10.0)),
    # the logger is behind the motion
    _kind("time_delay", "timing", _size("s", "s", 0.002, 0.06)),
    # the arm is behind on its path by a length, whatever its speed
    _kind("path_lag", "timing", _size("m", "m", 5e-5, 6e-4)),
    # friction plus dmu; the share `leak` of the tangential force stands in the normal reading
    _kind(
        "tangential_force", "contact", _size("dmu", "1", 0.05, 0.35, True), Key("leak", "1", 0.0, 0.1, False, 0.03, uniform=True)
    ),
    # every grinding before took so much, times 40 mm/s over the feed
    _kind("material_removal", "contact", _size("m_per_pass", "m", 5e-6, 1e-4)),
    # the surface stands out by a smooth random profile of this rms
    _kind("stock_profile", "contact", _size("m", "m", 5e-5, 2e-4)),
    # stiffness of the blade's solid times 1 + scale
    _kind("blade_stiffness", "contact", _size("scale", "1", 0.05, 0.4, True)),
    # give of the clamp at 60 mm from its plane, with the distance squared
    _kind("clamp_compliance", "contact", _size("m_per_N", "m/N", 1e-7, 2e-6)),
    # the blade slips away from the wheel, along the normal that is ground then
    _kind("clamp_slip", "contact", _size("m", "m", 2e-5, 3e-4), _at()),
    # the blade's frame moves (flange axes), the wheel moves (base axes), between two runs
    _kind("tool_frame_shift", "contact", Key("m", "m", 5e-5, 5e-4, True, None, 3), _at()),
    _kind("wheel_frame_shift", "contact", Key("m", "m", 5e-5, 5e-4, True, None, 3), _at()),
    # on the normal reading: plus N, plus N_per_h times the clock, times 1 + scale, plus share of the tangential force
    _kind("sensor_bias", "sensor", _size("N", "N", 0.1, 2.0, True)),
    _kind("sensor_drift", "sensor", _size("N_per_h", "N/h", 0.1, 3.0, True)),
    _kind("sensor_gain", "sensor", _size("scale", "1", 0.005, 0.06, True)),
    _kind("sensor_crosstalk", "sensor", _size("share", "1", 0.01, 0.1, True)),
    # spring of the flange times 1 + scale
    _kind("flange_stiffness", "contact", _size("scale", "1", 0.05, 0.4, True)),
    # Coulomb friction beside the flange's spring
    _kind("flange_friction", "contact", _size("N", "N", 0.3, 1.5)),
    # mass whose weight is not compensated
    _kind("flange_gravity", "contact", _size("kg", "kg", 0.05, 1.0)),
)
