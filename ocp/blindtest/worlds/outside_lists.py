"""The two lists of effects that the catalogue does not hold: forms that real arms, trackers and belt grinders show.

The first list was known to the author of the diagnosis. The second asks the same question unseen by that author: it was invented
after the diagnosis was written and without reading it. `ocp.blindtest.worlds.outside` says what a form may move and depend on.
Instants stand in order of time, so that a form may remember all readings before.
"""

import numpy as np

from ocp.blindtest.worlds.outside import ArmInstants, GrindingInstants, Outside, by_name, joint_index, outside, size
from ocp.simulate.twin.arm import gear_ratios
from ocp.simulate.twin.planting import LATE_STEP, PHASE, Key, Planted
from robots.pose import Array

SETTLING, CREEP = 60.0, 1800.0  # s: time constants of settling after a stop and of creep under load
SLACK = 0.35  # share of its range in which a hose pack hangs loose
SCAR = 9e-3  # m of path between two slips of a sticking flange
WANDER = 240.0  # s: how slowly a badly led belt wanders
HEATING = 0.9  # s in which a blade warms under the wheel
RATE = 27.0  # 1/s of a chatter that is the frame's own


def _hose_pull(p: Planted, at: ArmInstants) -> Array:
    """A hose pack hangs loose in the middle of its range (half a turn each way) and pulls back towards its ends, with the square
    of what it is drawn."""
    j = joint_index(p)
    share = at.q[:, j] / min(max(abs(at.robot.q_min[j]), at.robot.q_max[j]), np.pi)
    drawn = np.maximum(np.abs(share) - SLACK, 0.0) / (1.0 - SLACK)
    return np.asarray(-np.sign(share) * drawn**2)


def _load_hysteresis(p: Planted, at: ArmInstants) -> Array:
    """A gear between two loads: lags by its torque, with the torque's sign, behind the motion."""
    return np.asarray(at.tau[:, joint_index(p)] * at.sign[:, joint_index(p)])


def _posture_crosstalk(p: Planted, at: ArmInstants) -> Array:
    """Coupled drives: the product of joints 2 and 3 about the middle of their ranges."""
    return np.asarray((at.q[:, 1] + np.pi / 2) * (at.q[:, 2] - np.pi / 2))


def _settling(p: Planted, at: ArmInstants) -> Array:
    """What is left of the motion when a reading is taken soon after the stop: the axis comes to rest from where it came."""
    waited = np.diff(at.time, prepend=at.time[0] - 10 * SETTLING)
    return np.asarray(-at.sign[:, joint_index(p)] * np.exp(-waited / SETTLING))


def _creep(p: Planted, at: ArmInstants) -> Array:
    """A gear or its grease that gives with the logarithm of the time under load."""
    return np.asarray(at.tau[:, joint_index(p)] * np.log1p(at.time / CREEP))


def _bearing_wobble(p: Planted, at: ArmInstants) -> Array:
    """An out-of-round bearing: the axis nods twice a turn, about the x axis of the frame before the joint."""
    j = joint_index(p)
    return np.asarray(np.cos(2 * at.q[:, j] + p.number("phase_rad"))[:, None] * at.links[:, j, :3, 0])


def _axis_tilt(p: Planted, at: ArmInstants) -> Array:
    """A main bearing that yields to the moment across its axis, of all links beyond it and the payload."""
    return at.moment_across(joint_index(p))[1]


def _warm_torsion(p: Planted, at: ArmInstants) -> Array:
    """A link that warms on one side twists about its own length."""
    j = joint_index(p)
    along = at.links[:, j + 1, :3, 3] - at.links[:, j, :3, 3]
    return np.asarray(at.warmth[:, None] * along / np.linalg.norm(along, axis=1, keepdims=True))


def _down(at: ArmInstants) -> Array:
    """Level unit vectors (n, 3) square to the beam: a turn about them bends it down."""
    level = np.stack([at.point[:, 1], -at.point[:, 0], np.zeros(len(at.q))], axis=1)
    return np.asarray(level / np.linalg.norm(level, axis=1, keepdims=True))


def _elevation(p: Planted, at: ArmInstants) -> Array:
    """The circle of the elevation encoder sits off centre: once per turn of the mirror."""
    elevation = np.arctan2(at.point[:, 2], np.hypot(at.point[:, 0], at.point[:, 1]))
    return np.asarray(np.cos(elevation + p.number("phase_rad"))[:, None] * _down(at))


def _beam_bending(p: Planted, at: ArmInstants) -> Array:
    """Air that is warmer at the top bends the beam down, by an angle that grows with the distance."""
    return np.asarray(_down(at) * np.linalg.norm(at.point, axis=1, keepdims=True))


ON_ARM: dict[str, Outside] = by_name(
    outside("bearing_wobble", "link", _bearing_wobble, (1, 2, 3, 4), size("rad", "rad", 1e-5, 1e-4, False), PHASE),
    outside("hose_pull", "angle", _hose_pull, (1, 4, 6), size("rad", "rad", 5e-5, 5e-4)),
    outside("load_hysteresis", "angle", _load_hysteresis, (3, 4, 5), size("rad_per_Nm", "rad/(N m)", 2e-8, 4e-7)),
    outside("posture_crosstalk", "angle", _posture_crosstalk, (2, 3), size("rad_per_rad2", "1/rad", 2e-5, 2e-4)),
    outside("axis_tilt_under_load", "link", _axis_tilt, (1, 2, 3), size("rad_per_Nm", "rad/(N m)", 3e-9, 5e-8)),
    outside("settling", "angle", _settling, (1, 2, 3), size("rad", "rad", 3e-5, 3e-4)),
    outside("creep_under_load", "angle", _creep, (2, 3), size("rad_per_Nm", "rad/(N m)", 3e-8, 3e-7)),
    outside("warm_torsion", "link", _warm_torsion, (2, 3, 4), size("rad_per_K", "rad/K", 2e-6, 2e-5)),
    outside("elevation_eccentricity", "frame", _elevation, (), size("rad", "rad", 3e-6, 5e-5, False), PHASE),
    outside("beam_bending", "frame", _beam_bending, (), size("rad_per_m", "rad/m", 1e-6, 1e-5)),
)


def _stick_slip(p: Planted, at: GrindingInstants) -> Array:
    """A flange that sticks at scars of its guide and slips free: a saw along the path, leaning against the travel."""
    return np.asarray(at.travel * (2.0 * np.mod(at.s / SCAR, 1.0) - 1.0))


def _two_waves(p: Planted, at: GrindingInstants) -> Array:
    """A wheel that was clamped oval: two waves a turn."""
    return np.asarray(np.cos(2.0 * at.way / at.radius + p.number("phase_rad")))


def _wander(p: Planted, at: GrindingInstants) -> Array:
    """A belt that wanders to and fro over a crowned wheel."""
    return np.asarray(np.sin(2 * np.pi * at.clock / WANDER + p.number("phase_rad")) * (at.belt != 0))


def _bow(p: Planted, at: GrindingInstants) -> Array:
    """A blade that warms on the ground side and bows toward the wheel from the start of each pass."""
    return np.asarray(1.0 - np.exp(-at.time / HEATING))


def _cable(p: Planted, at: GrindingInstants) -> Array:
    """A cable that hangs loose where axis 6 stands at 0 and pulls at the blade's holder, with the square of what axis 6 turns
    away (of the chord, so that half a turn to either side is the same)."""
    return np.asarray((2.0 * np.sin(0.5 * at.q[:, 5])) ** 2)


def _coolant(p: Planted, at: GrindingInstants) -> Array:
    """Coolant that the belt throws at the blade, with the square of its speed, in the air too."""
    return np.asarray((at.belt / 20.0) ** 2)


def _chatter(p: Planted, at: GrindingInstants) -> Array:
    """The frame's own swinging, in contact."""
    return np.asarray(np.cos(2 * np.pi * RATE * at.time + p.number("phase_rad")) * (at.force > 0))


ON_GRINDING: dict[str, Outside] = by_name(
    outside("flange_stick_slip", "push", _stick_slip, (), size("N", "N", 0.05, 3.0)),
    outside("wheel_two_waves", "overlap", _two_waves, (), size("m", "m", 5e-6, 3e-4, False), PHASE),
    outside("belt_wander", "overlap", _wander, (), size("m", "m", 5e-6, 5e-4, False), PHASE),
    outside("coolant_push", "reading", _coolant, (), size("N", "N", 0.05, 5.0)),
    outside("frame_chatter", "reading", _chatter, (), size("N", "N", 0.05, 3.0, False), PHASE),
    outside("cable_pull", "push", _cable, (6,), size("N_per_rad2", "N/rad^2", 0.2, 80.0)),
    outside("blade_bow", "overlap", _bow, (), size("m", "m", 5e-6, 5e-4)),
)


OIL = 1500.0  # s: time constant of a gear's oil that comes to temperature; a third of the structure's
MEMORY = 0.8  # rad: half width within which hoses and seals stick to where they were dragged
TWIST_SLACK = 2.0  # rad: twist of the wrist's cable, axes 4 and 6 together, before it is taut
HELD = 0.15  # share of the axis' rated torque up to which a worn bearing's preload holds; at twice that it stands at its stop


_PINS = Key("order", "1", 20.0, 60.0, integer=True)  # pins of a cycloidal gear's ring
_POLES = Key("order", "1", 3.0, 8.0, uniform=True, integer=True)  # pole pairs of a motor's resolver, or twice that


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
    outside("zero_jump", "angle", _zero_jump, (1, 2, 3, 4, 5), size("rad", "rad", 3e-5, 5e-4), LATE_STEP),
    outside("bearing_slack", "link", _bearing_slack, (4, 5, 6), size("rad", "rad", 5e-5, 8e-4, False)),
    outside("loose_anchor", "link", _loose_anchor, (), size("rad_per_Nm", "rad/(N m)", 5e-9, 1e-7, False), PHASE),
    outside("ball_out_of_round", "nest", _ball, (), size("m", "m", 1e-5, 1.5e-4)),
    outside("slip_memory", "angle", _slip_memory, (1, 2, 3, 4), size("rad", "rad", 3e-5, 3e-4)),
    outside("resolver_error", "angle", _resolver, (1, 2, 3, 4), size("rad", "rad", 2e-5, 3e-4, False), _POLES, PHASE),
    outside("cable_twist", "angle", _cable_twist, (4, 6), size("rad_per_rad", "1", 2e-5, 4e-4)),
    outside("oil_warm_up", "angle", _oil, (1, 2, 3, 4, 5), size("rad", "rad", 3e-5, 5e-4)),
    outside("trunnion_tilt", "frame", _trunnion, (), size("rad", "rad", 5e-6, 8e-5)),
)
