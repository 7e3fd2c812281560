"""Effects that the catalogue does not hold, for worlds in which "none of these" is the right answer.

Each is a form that real arms and trackers show, with one size. Shifts dq (n, 6) rad of the joints depend on the commanded
posture, the approach, the load torques and the clock; twists of a link are rotation vectors (n, 3) rad in base axes about that
joint's origin; frame turns are rotation vectors (n, 3) rad of a reading about the tracker's head. All per unit size.
"""

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np

from ocp.simulate.twin.arm.machine import GRAVITY
from ocp.simulate.twin.truth.planting import Key, Kind, Planted
from robots.pose import Array, apply
from robots.robot import Robot

SETTLING, CREEP = 60.0, 1800.0  # s: time constants of settling after a stop and of creep under load
SLACK = 0.35  # share of its range in which a hose pack hangs loose


@dataclass(frozen=True, eq=False)
class Instants:
    """What forms may depend on, n readings: q (n, 6) rad, sign (n, 6), tau (n, 6) N m, warmth (n,) K, time (n,) s; links (n, 7,
    4, 4); mass (n,) kg and centre (n, 3) m (base axes) of the payload; point (n, 3) m of the reading in the tracker's frame, turn
    (3, 3) from base to tracker axes."""

    robot: Robot
    q: Array
    sign: Array
    tau: Array
    warmth: Array
    time: Array
    links: Array
    mass: Array
    centre: Array
    point: Array
    turn: Array


Form = Callable[[Planted, Instants], Array]


def _kind(name: str, joints: tuple[int, ...], key: str, unit: str, low: float, high: float, phase: bool = False) -> Kind:
    keys = (Key(key, unit, low, high, not phase, None),)
    turn = (Key("phase_rad", "rad", 0.0, 2 * np.pi, False, 0.0, uniform=True),) if phase else ()
    return Kind(name, joints, keys + turn, "outside")


KINDS: dict[str, Kind] = {
    kind.name: kind
    for kind in (
        _kind("bearing_wobble", (1, 2, 3, 4), "rad", "rad", 1e-5, 1e-4, True),
        _kind("hose_pull", (1, 4, 6), "rad", "rad", 5e-5, 5e-4),
        _kind("load_hysteresis", (3, 4, 5), "rad_per_Nm", "rad/(N m)", 2e-8, 4e-7),
        _kind("posture_crosstalk", (2, 3), "rad_per_rad2", "1/rad", 2e-5, 2e-4),
        _kind("axis_tilt_under_load", (1, 2, 3), "rad_per_Nm", "rad/(N m)", 3e-9, 5e-8),
        _kind("settling", (1, 2, 3), "rad", "rad", 3e-5, 3e-4),
        _kind("creep_under_load", (2, 3), "rad_per_Nm", "rad/(N m)", 3e-8, 3e-7),
        _kind("warm_torsion", (2, 3, 4), "rad_per_K", "rad/K", 2e-6, 2e-5),
        _kind("azimuth_eccentricity", (), "rad", "rad", 3e-6, 5e-5, True),
        _kind("beam_bending", (), "rad_per_m", "rad/m", 1e-6, 1e-5),
    )
}
"""By name; `draw_effect` draws from them as from the catalogue's."""


@dataclass(frozen=True)
class Forms:
    """A list of effects: their kinds, and their forms by what they move, per unit size."""

    kinds: dict[str, Kind]
    of_joints: dict[str, Form]
    of_links: dict[str, Form]
    of_frame: dict[str, Form]
    of_reflector: dict[str, Form] = field(default_factory=dict)

    def shifts(self, planted: Planted, at: Instants) -> Array:
        """dq (n, 6) rad of the joints; zero where the effect is none of a joint's angle."""
        dq = np.zeros_like(at.q)
        moved = self._moved(self.of_joints, planted, at)
        if moved is not None and planted.joint is not None:
            dq[:, planted.joint - 1] = moved
        return dq

    def twist(self, planted: Planted, at: Instants) -> Array | None:
        """Rotation vectors (n, 3) rad, base axes, by which the joint's link and all after it turn about the joint's origin; of an
        effect without a joint the whole arm about its base."""
        return self._moved(self.of_links, planted, at)

    def frame_turn(self, planted: Planted, at: Instants) -> Array | None:
        """Rotation vectors (n, 3) rad by which readings turn about the tracker's head, tracker's axes."""
        return self._moved(self.of_frame, planted, at)

    def move(self, planted: Planted, at: Instants) -> Array | None:
        """Shifts (n, 3) m of the reflector in its nest, base axes."""
        return self._moved(self.of_reflector, planted, at)

    def _moved(self, forms: dict[str, Form], planted: Planted, at: Instants) -> Array | None:
        form = forms.get(planted.effect)
        if form is None:
            return None
        return np.asarray(planted.number(self.kinds[planted.effect].keys[0].name) * form(planted, at))


def _joint(planted: Planted) -> int:
    return (planted.joint or 1) - 1


def _hose_pull(p: Planted, at: Instants) -> Array:
    """A hose pack hangs loose in the middle of its range (half a turn each way) and pulls back towards its ends, with the square
    of what it is drawn."""
    j = _joint(p)
    share = at.q[:, j] / min(max(abs(at.robot.q_min[j]), at.robot.q_max[j]), np.pi)
    drawn = np.maximum(np.abs(share) - SLACK, 0.0) / (1.0 - SLACK)
    return np.asarray(-np.sign(share) * drawn**2)


def _load_hysteresis(p: Planted, at: Instants) -> Array:
    """A gear between two loads: lags by its torque, with the torque's sign, behind the motion."""
    return np.asarray(at.tau[:, _joint(p)] * at.sign[:, _joint(p)])


def _posture_crosstalk(p: Planted, at: Instants) -> Array:
    """Coupled drives: the product of joints 2 and 3 about the middle of their ranges."""
    return np.asarray((at.q[:, 1] + np.pi / 2) * (at.q[:, 2] - np.pi / 2))


def _settling(p: Planted, at: Instants) -> Array:
    """What is left of the motion when a reading is taken soon after the stop: the axis comes to rest from where it came."""
    waited = np.diff(at.time, prepend=at.time[0] - 10 * SETTLING)
    return np.asarray(-at.sign[:, _joint(p)] * np.exp(-waited / SETTLING))


def _creep(p: Planted, at: Instants) -> Array:
    """A gear or its grease that gives with the logarithm of the time under load."""
    return np.asarray(at.tau[:, _joint(p)] * np.log1p(at.time / CREEP))


def _bearing_wobble(p: Planted, at: Instants) -> Array:
    """An out-of-round bearing: the axis nods twice a turn, about the x axis of the frame before the joint."""
    j = _joint(p)
    return np.asarray(np.cos(2 * at.q[:, j] + p.number("phase_rad"))[:, None] * at.links[:, j, :3, 0])


def _axis_tilt(p: Planted, at: Instants) -> Array:
    """A main bearing that yields to the moment across its axis, of all links beyond it and the payload."""
    j = _joint(p)
    origin, axis = at.links[:, j, :3, 3], at.links[:, j, :3, 2]
    weight = np.array([0.0, 0.0, -GRAVITY])
    moment = at.mass[:, None] * np.cross(at.centre - origin, weight)
    for link in range(j + 1, 7):
        centre = apply(at.links[:, link], np.broadcast_to(at.robot.link_com[link], (len(at.q), 3)))
        moment = moment + at.robot.link_mass[link] * np.cross(centre - origin, weight)
    return np.asarray(moment - (moment * axis).sum(axis=1, keepdims=True) * axis)


def _warm_torsion(p: Planted, at: Instants) -> Array:
    """A link that warms on one side twists about its own length."""
    j = _joint(p)
    along = at.links[:, j + 1, :3, 3] - at.links[:, j, :3, 3]
    return np.asarray(at.warmth[:, None] * along / np.linalg.norm(along, axis=1, keepdims=True))


def _azimuth(p: Planted, at: Instants) -> Array:
    """The circle of the azimuth encoder sits off centre: once per turn of the head."""
    azimuth = np.arctan2(at.point[:, 1], at.point[:, 0])
    return np.cos(azimuth + p.number("phase_rad"))[:, None] * np.array([0.0, 0.0, 1.0])


def _beam_bending(p: Planted, at: Instants) -> Array:
    """Air that is warmer at the top bends the beam down, by an angle that grows with the distance."""
    level = np.stack([at.point[:, 1], -at.point[:, 0], np.zeros(len(at.q))], axis=1)
    return np.asarray(level / np.linalg.norm(level, axis=1, keepdims=True) * np.linalg.norm(at.point, axis=1, keepdims=True))


_SHIFTS: dict[str, Form] = {
    "hose_pull": _hose_pull, "load_hysteresis": _load_hysteresis, "posture_crosstalk": _posture_crosstalk,
    "settling": _settling, "creep_under_load": _creep,
}  # fmt: skip
_TWISTS: dict[str, Form] = {"bearing_wobble": _bearing_wobble, "axis_tilt_under_load": _axis_tilt, "warm_torsion": _warm_torsion}
_TURNS: dict[str, Form] = {"azimuth_eccentricity": _azimuth, "beam_bending": _beam_bending}
FORMS = Forms(KINDS, _SHIFTS, _TWISTS, _TURNS)
