"""A second list of effects that the catalogue does not hold, invented after the diagnosis was written and without reading it.

The first list (`ocp.blindtest.worlds.outside`) was known to the author of the diagnosis. This one was not: it asks the same
question unseen. Forms depend on the same instants, in order of time, so that one may remember all readings before. Besides
shifts, twists and frame turns there are moves: where the reflector itself sits off its nest, (n, 3) m in base axes. All per unit
size.
"""

import numpy as np

from ocp.blindtest.worlds.outside import KINDS as FIRST
from ocp.blindtest.worlds.outside import Form, Forms, Instants
from ocp.simulate.twin.arm.joint_errors import gear_ratios
from ocp.simulate.twin.arm.machine import GRAVITY
from ocp.simulate.twin.truth.planting import Key, Kind, Planted
from robots.pose import Array, apply

OIL = 1500.0  # s: time constant of a gear's oil that comes to temperature; a third of the structure's
MEMORY = 0.8  # rad: half width within which hoses and seals stick to where they were dragged
TWIST_SLACK = 2.0  # rad: twist of the wrist's cable, axes 4 and 6 together, before it is taut
HELD = 0.15  # share of the axis' rated torque up to which a worn bearing's preload holds; at twice that it stands at its stop


def _kind(name: str, joints: tuple[int, ...], size: Key, *more: Key) -> Kind:
    return Kind(name, joints, (size, *more), "outside")


def _size_key(name: str, unit: str, low: float, high: float, signed: bool = True) -> Key:
    return Key(name, unit, low, high, signed, None)


_PHASE = Key("phase_rad", "rad", 0.0, 2 * np.pi, False, 0.0, uniform=True)
_AT = Key("at_s", "s", 1000.0, 8000.0, False, None, uniform=True)  # inside a campaign of three hours, away from its ends
_PINS = Key("order", "1", 20.0, 60.0, False, None, integer=True)  # pins of a cycloidal gear's ring
_POLES = Key("order", "1", 3.0, 8.0, False, None, uniform=True, integer=True)  # pole pairs of a motor's resolver, or twice that

KINDS: dict[str, Kind] = {
    kind.name: kind
    for kind in (
        _kind("mesh_error_under_load", (2, 3, 5), _size_key("rad_at_rated", "rad", 5e-5, 6e-4, False), _PINS, _PHASE),
        _kind("zero_jump", (1, 2, 3, 4, 5), _size_key("rad", "rad", 3e-5, 5e-4), _AT),
        _kind("bearing_slack", (4, 5, 6), _size_key("rad", "rad", 5e-5, 8e-4, False)),
        _kind("loose_anchor", (), _size_key("rad_per_Nm", "rad/(N m)", 5e-9, 1e-7, False), _PHASE),
        _kind("ball_out_of_round", (), _size_key("m", "m", 1e-5, 1.5e-4)),
        _kind("slip_memory", (1, 2, 3, 4), _size_key("rad", "rad", 3e-5, 3e-4)),
        _kind("resolver_error", (1, 2, 3, 4), _size_key("rad", "rad", 2e-5, 3e-4, False), _POLES, _PHASE),
        _kind("cable_twist", (4, 6), _size_key("rad_per_rad", "1", 2e-5, 4e-4)),
        _kind("oil_warm_up", (1, 2, 3, 4, 5), _size_key("rad", "rad", 3e-5, 5e-4)),
        _kind("trunnion_tilt", (), _size_key("rad", "rad", 5e-6, 8e-5)),
    )
}
"""By name; `draw_effect` draws from them as from the catalogue's."""

EVERY: dict[str, Kind] = {**FIRST, **KINDS}
"""Both lists."""


def _joint(planted: Planted) -> int:
    return (planted.joint or 1) - 1


def _mesh_error(p: Planted, at: Instants) -> Array:
    """Pins that bend under load: the transmission error of the mesh grows with the torque that it carries."""
    j = _joint(p)
    wave = np.cos(p.number("order") * at.q[:, j] + p.number("phase_rad"))
    return np.asarray(at.tau[:, j] / at.robot.torque_max[j] * wave)


def _zero_jump(p: Planted, at: Instants) -> Array:
    """A new reference run, or a coupling that slipped: the axis has another zero from then on."""
    return np.asarray(at.time >= p.number("at_s"), float)


def _slip_memory(p: Planted, at: Instants) -> Array:
    """Hoses and seals that are dragged along: a slider that sticks within +-MEMORY of where the axis has been, relaxed at the
    first reading, so that a reading depends on the postures before it and on how far they lay apart (stop operator)."""
    q = at.q[:, _joint(p)]
    dragged, place = np.zeros(len(q)), 0.0
    for k in range(1, len(q)):
        place = float(np.clip(place + q[k] - q[k - 1], -MEMORY, MEMORY))
        dragged[k] = place
    return -dragged / MEMORY


def _resolver(p: Planted, at: Instants) -> Array:
    """Sine and cosine of a resolver that differ in size: waves of its electrical angle, several a turn of the motor."""
    j = _joint(p)
    return np.cos(p.number("order") * gear_ratios(at.robot)[j] * at.q[:, j] + p.number("phase_rad"))


def _cable_twist(p: Planted, at: Instants) -> Array:
    """A cable through the wrist that axes 4 and 6 twist together: slack at first, then a torsion spring."""
    twisted = at.q[:, 3] + at.q[:, 5]
    return np.asarray(-np.sign(twisted) * np.maximum(np.abs(twisted) - TWIST_SLACK, 0.0))


def _oil(p: Planted, at: Instants) -> Array:
    """A gear that was cold at the start: what is left of its cold error while the oil churns itself warm."""
    return np.exp(-at.time / OIL)


def _moment(at: Instants, joint: int) -> Array:
    """Moments (n, 3) N m, base axes, of the weight of all links after the joint (0..5) and of the payload about its origin."""
    origin, weight = at.links[:, joint, :3, 3], np.array([0.0, 0.0, -GRAVITY])
    total = at.mass[:, None] * np.cross(at.centre - origin, weight)
    for link in range(joint + 1, 7):
        centre = apply(at.links[:, link], np.broadcast_to(at.robot.link_com[link], (len(at.q), 3)))
        total = total + at.robot.link_mass[link] * np.cross(centre - origin, weight)
    return np.asarray(total)


def _bearing_slack(p: Planted, at: Instants) -> Array:
    """A worn bearing: stiff while its preload holds, then it gives way to the moment across its axis up to its stop."""
    j = _joint(p)
    axis = at.links[:, j, :3, 2]
    moment = _moment(at, j)
    across = moment - (moment * axis).sum(axis=1, keepdims=True) * axis
    size = np.linalg.norm(across, axis=1, keepdims=True)
    given = np.clip(size / (HELD * at.robot.torque_max[j]) - 1.0, 0.0, 1.0)
    return np.asarray(given * across / np.maximum(size, 1e-9))


def _loose_anchor(p: Planted, at: Instants) -> Array:
    """A base plate with an anchor that is loose: it yields to the overturning moment on that side and to no other."""
    edge = np.array([np.cos(p.number("phase_rad")), np.sin(p.number("phase_rad")), 0.0])
    return np.asarray(np.maximum(_moment(at, 0) @ edge, 0.0)[:, None] * edge)


def _ball(p: Planted, at: Instants) -> Array:
    """A reflector's ball that is longer along its optical axis: turned to the tracker it stands higher in its nest (facing along
    the flange's z axis), by the second Legendre polynomial of the angle between nest and beam."""
    sight = at.point @ at.turn
    sight = sight / np.linalg.norm(sight, axis=1, keepdims=True)
    facing = at.links[:, 6, :3, 2]
    slant = (sight * facing).sum(axis=1, keepdims=True)
    return np.asarray(0.5 * (3.0 * slant**2 - 1.0) * facing)


def _trunnion(p: Planted, at: Instants) -> Array:
    """A tracker of which the elevation axis is not square to the azimuth axis: azimuths are off by the tangent of elevation."""
    slope = at.point[:, 2] / np.hypot(at.point[:, 0], at.point[:, 1])
    return np.asarray(slope[:, None] * np.array([0.0, 0.0, 1.0]))


_SHIFTS: dict[str, Form] = {
    "mesh_error_under_load": _mesh_error, "zero_jump": _zero_jump, "slip_memory": _slip_memory, "resolver_error": _resolver,
    "cable_twist": _cable_twist, "oil_warm_up": _oil,
}  # fmt: skip
_TWISTS: dict[str, Form] = {"bearing_slack": _bearing_slack, "loose_anchor": _loose_anchor}
_TURNS: dict[str, Form] = {"trunnion_tilt": _trunnion}
_MOVES: dict[str, Form] = {"ball_out_of_round": _ball}
FORMS = Forms(KINDS, _SHIFTS, _TWISTS, _TURNS, _MOVES)
