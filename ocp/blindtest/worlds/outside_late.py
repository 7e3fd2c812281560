"""The second list of effects that the catalogue does not hold, invented after the diagnosis was written and without reading it.

It asks the same question as the first list, unseen by the author of the diagnosis. Instants stand in order of time, so that a
form may remember all readings before. `ocp.blindtest.worlds.outside` says what a form may move and depend on.
"""

import numpy as np

from ocp.blindtest.worlds.outside import PHASE, ArmInstants, Outside, by_name, joint_index, outside, size
from ocp.simulate.twin.arm.errors import gear_ratios
from ocp.simulate.twin.truth.kinds import Key
from ocp.simulate.twin.truth.planting import Planted
from robots.pose import Array

OIL = 1500.0  # s: time constant of a gear's oil that comes to temperature; a third of the structure's
MEMORY = 0.8  # rad: half width within which hoses and seals stick to where they were dragged
TWIST_SLACK = 2.0  # rad: twist of the wrist's cable, axes 4 and 6 together, before it is taut
HELD = 0.15  # share of the axis' rated torque up to which a worn bearing's preload holds; at twice that it stands at its stop


_AT = Key("at_s", "s", 1000.0, 8000.0, False, None, uniform=True)  # inside a campaign of three hours, away from its ends
_PINS = Key("order", "1", 20.0, 60.0, False, None, integer=True)  # pins of a cycloidal gear's ring
_POLES = Key("order", "1", 3.0, 8.0, False, None, uniform=True, integer=True)  # pole pairs of a motor's resolver, or twice that


def _mesh_error(p: Planted, at: ArmInstants) -> Array:
    """Pins that bend under load: the transmission error of the mesh grows with the torque that it carries."""
    j = joint_index(p)
    wave = np.cos(p.number("order") * at.q[:, j] + p.number("phase_rad"))
    return np.asarray(at.tau[:, j] / at.robot.torque_max[j] * wave)


def _zero_jump(p: Planted, at: ArmInstants) -> Array:
    """A new reference run, or a coupling that slipped: the axis has another zero from then on."""
    return np.asarray(at.time >= p.number("at_s"), float)


def _slip_memory(p: Planted, at: ArmInstants) -> Array:
    """Hoses and seals that are dragged along: a slider that sticks within +-MEMORY of where the axis has been, relaxed at the
    first reading, so that a reading depends on the postures before it and on how far they lay apart (stop operator)."""
    q = at.q[:, joint_index(p)]
    dragged, place = np.zeros(len(q)), 0.0
    for k in range(1, len(q)):
        place = float(np.clip(place + q[k] - q[k - 1], -MEMORY, MEMORY))
        dragged[k] = place
    return -dragged / MEMORY


def _resolver(p: Planted, at: ArmInstants) -> Array:
    """Sine and cosine of a resolver that differ in size: waves of its electrical angle, several a turn of the motor."""
    j = joint_index(p)
    return np.cos(p.number("order") * gear_ratios(at.robot)[j] * at.q[:, j] + p.number("phase_rad"))


def _cable_twist(p: Planted, at: ArmInstants) -> Array:
    """A cable through the wrist that axes 4 and 6 twist together: slack at first, then a torsion spring."""
    twisted = at.q[:, 3] + at.q[:, 5]
    return np.asarray(-np.sign(twisted) * np.maximum(np.abs(twisted) - TWIST_SLACK, 0.0))


def _oil(p: Planted, at: ArmInstants) -> Array:
    """A gear that was cold at the start: what is left of its cold error while the oil churns itself warm."""
    return np.exp(-at.time / OIL)


def _bearing_slack(p: Planted, at: ArmInstants) -> Array:
    """A worn bearing: stiff while its preload holds, then it gives way to the moment across its axis up to its stop."""
    j = joint_index(p)
    across = at.moment_across(j)[1]
    amount = np.linalg.norm(across, axis=1, keepdims=True)
    given = np.clip(amount / (HELD * at.robot.torque_max[j]) - 1.0, 0.0, 1.0)
    return np.asarray(given * across / np.maximum(amount, 1e-9))


def _loose_anchor(p: Planted, at: ArmInstants) -> Array:
    """A base plate with an anchor that is loose: it yields to the overturning moment on that side and to no other."""
    edge = np.array([np.cos(p.number("phase_rad")), np.sin(p.number("phase_rad")), 0.0])
    return np.asarray(np.maximum(at.moment_across(0)[0] @ edge, 0.0)[:, None] * edge)


def _ball(p: Planted, at: ArmInstants) -> Array:
    """A reflector's ball that is longer along its optical axis: turned to the tracker it stands higher in its nest (facing along
    the flange's z axis), by the second Legendre polynomial of the angle between nest and beam."""
    sight = at.point @ at.turn
    sight = sight / np.linalg.norm(sight, axis=1, keepdims=True)
    facing = at.links[:, 6, :3, 2]
    slant = (sight * facing).sum(axis=1, keepdims=True)
    return np.asarray(0.5 * (3.0 * slant**2 - 1.0) * facing)


def _trunnion(p: Planted, at: ArmInstants) -> Array:
    """A tracker of which the elevation axis is not square to the azimuth axis: azimuths are off by the tangent of elevation."""
    slope = at.point[:, 2] / np.hypot(at.point[:, 0], at.point[:, 1])
    return np.asarray(slope[:, None] * np.array([0.0, 0.0, 1.0]))


LATE: dict[str, Outside] = by_name(
    outside(
        "mesh_error_under_load", "angle", _mesh_error, (2, 3, 5), size("rad_at_rated", "rad", 5e-5, 6e-4, False), _PINS, PHASE
    ),
    outside("zero_jump", "angle", _zero_jump, (1, 2, 3, 4, 5), size("rad", "rad", 3e-5, 5e-4), _AT),
    outside("bearing_slack", "link", _bearing_slack, (4, 5, 6), size("rad", "rad", 5e-5, 8e-4, False)),
    outside("loose_anchor", "link", _loose_anchor, (), size("rad_per_Nm", "rad/(N m)", 5e-9, 1e-7, False), PHASE),
    outside("ball_out_of_round", "nest", _ball, (), size("m", "m", 1e-5, 1.5e-4)),
    outside("slip_memory", "angle", _slip_memory, (1, 2, 3, 4), size("rad", "rad", 3e-5, 3e-4)),
    outside("resolver_error", "angle", _resolver, (1, 2, 3, 4), size("rad", "rad", 2e-5, 3e-4, False), _POLES, PHASE),
    outside("cable_twist", "angle", _cable_twist, (4, 6), size("rad_per_rad", "1", 2e-5, 4e-4)),
    outside("oil_warm_up", "angle", _oil, (1, 2, 3, 4, 5), size("rad", "rad", 3e-5, 5e-4)),
    outside("trunnion_tilt", "frame", _trunnion, (), size("rad", "rad", 5e-6, 8e-5)),
)
