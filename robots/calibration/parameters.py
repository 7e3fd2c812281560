"""Every parameter of the product by name: unit and meaning. No other name may appear in a calibration."""

from dataclasses import dataclass


@dataclass(frozen=True)
class Symbol:
    """Unit (SI, radians) and meaning of a parameter."""

    unit: str
    meaning: str


def _geometry() -> dict[str, Symbol]:
    """MD-H: absolute values, not deviations from the nominal robot (PHYSICS 2.2)."""
    rows = (
        ("th", "rad", "theta offset of joint {}"),
        ("d", "m", "distance along z of joint {}"),
        ("a", "m", "distance along x of joint {}"),
        ("al", "rad", "twist alpha of joint {}"),
        ("be", "rad", "Hayati twist beta of joint {}"),
    )
    return {f"{s}{i}": Symbol(unit, text.format(i)) for s, unit, text in rows for i in range(1, 7)}


def _vector(stem: str, unit: str, axes: str, meaning: str) -> dict[str, Symbol]:
    return {f"{stem}_{axis}": Symbol(unit, meaning.format(axis)) for axis in axes}


SYMBOLS: dict[str, Symbol] = {
    **_geometry(),
    **_vector("base", "m", "xyz", "robot base in the measuring frame, {}; not used by planning"),
    **_vector("base", "rad", "abc", "robot base in the measuring frame, KUKA angle {}; not used by planning"),
    **{f"c{i}": Symbol("rad/(N m)", f"compliance of joint {i}, absolute") for i in range(1, 7)},
    "payload_mass": Symbol("kg", "mass on the flange while grinding, absolute"),
    **_vector("payload_com", "m", "xyz", "its centre of mass in the flange frame, {}, absolute"),
    # From here on: small corrections that are added to what the cell file says.
    **_vector("wheel", "m", "xyz", "shift of the wheel's centre in the base frame, {}"),
    "wheel_radius": Symbol("m", "change of the wheel's radius, belt and cover together"),
    "wheel_wear": Symbol("m/s", "loss of the wheel's radius per second of its clock; what ocp.update forecasts by"),
    "wheel_axis_u": Symbol("rad", "turn of the wheel's axis about the first direction across it"),
    "wheel_axis_v": Symbol("rad", "turn of the wheel's axis about the second direction across it"),
    **_vector("blade", "m", "xyz", "shift of the blade frame in the flange frame, {}"),
    "blade_a": Symbol("rad", "small turn of the blade frame about z of the flange frame"),
    "blade_b": Symbol("rad", "small turn of the blade frame about y of the flange frame"),
    "blade_c": Symbol("rad", "small turn of the blade frame about x of the flange frame"),
    "cover_stiffness_scale": Symbol("1", "relative correction of the cover's stiffness, 0 = as in the cell"),
    "blade_stiffness_scale": Symbol("1", "relative correction of the blade's stiffness, 0 = as in the cell"),
    "flange_stiffness": Symbol("N/m", "stiffness of the force-setting flange, absolute"),
    "flange_setpoint_offset": Symbol("N", "force of the flange above its setpoint"),
    "sensor_bias": Symbol("N", "force reading in the air"),
}

# Row-major order of Robot.mdh.
MDH_NAMES: tuple[str, ...] = tuple(f"{s}{i}" for i in range(1, 7) for s in ("th", "d", "a", "al", "be"))
COMPLIANCE_NAMES: tuple[str, ...] = tuple(f"c{i}" for i in range(1, 7))
BASE_NAMES: tuple[str, ...] = ("base_x", "base_y", "base_z", "base_a", "base_b", "base_c")
