"""Effects of the grinding that the catalogue does not hold, for worlds in which "none of these" is the right answer.

Each is a form that real cells show, with one size. What presses deeper is told as overlap m, what the flange pushes with as force
N, what the sensor alone shows as reading N.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from ocp.simulate.twin.truth.planting import Key, Kind, Planted
from robots.pose import Array

SCAR = 9e-3  # m of path between two slips of a sticking flange
WANDER = 240.0  # s: how slowly a badly led belt wanders
HEATING = 0.9  # s in which a blade warms under the wheel
RATE = 27.0  # 1/s of a chatter that is the frame's own


@dataclass(frozen=True, eq=False)
class Instants:
    """What forms may depend on (n,): s m, travel +-1, time s since the run's start, clock s, belt m/s, way of the belt m since
    the run's start, radius m of the wheel, force N without the effect; q (n, 6) rad."""

    s: Array
    travel: Array
    time: Array
    clock: Array
    belt: Array
    way: Array
    radius: float
    force: Array
    q: Array


Form = Callable[[Planted, Instants], Array]


def _kind(name: str, key: str, unit: str, low: float, high: float, phase: bool = False, joint: int = 0) -> Kind:
    turn = (Key("phase_rad", "rad", 0.0, 2 * np.pi, False, 0.0, uniform=True),) if phase else ()
    return Kind(name, (joint,) if joint else (), (Key(key, unit, low, high, not phase, None), *turn), "outside")


KINDS: dict[str, Kind] = {
    kind.name: kind
    for kind in (
        _kind("flange_stick_slip", "N", "N", 0.05, 3.0),
        _kind("wheel_two_waves", "m", "m", 5e-6, 3e-4, True),
        _kind("belt_wander", "m", "m", 5e-6, 5e-4, True),
        _kind("coolant_push", "N", "N", 0.05, 5.0),
        _kind("frame_chatter", "N", "N", 0.05, 3.0, True),
        _kind("cable_pull", "N_per_rad2", "N/rad^2", 0.2, 80.0, joint=6),
        _kind("blade_bow", "m", "m", 5e-6, 5e-4),
    )
}
"""By name; `draw_effect` draws from them as from the catalogue's."""


def overlaps(planted: Planted, at: Instants) -> Array:
    """Overlap (n,) m that the effect adds."""
    return _added(_OVERLAPS, planted, at)


def pushes(planted: Planted, at: Instants) -> Array:
    """Force (n,) N that the flange pushes with beside its setpoint."""
    return _added(_PUSHES, planted, at)


def readings(planted: Planted, at: Instants) -> Array:
    """What the normal reading (n,) N shows beside the contact's force."""
    return _added(_READINGS, planted, at)


def _added(forms: dict[str, Form], planted: Planted, at: Instants) -> Array:
    form = forms.get(planted.effect)
    if form is None:
        return np.zeros_like(at.s)
    return np.asarray(planted.number(KINDS[planted.effect].keys[0].name) * form(planted, at))


def _stick_slip(p: Planted, at: Instants) -> Array:
    """A flange that sticks at scars of its guide and slips free: a saw along the path, leaning against the travel."""
    return np.asarray(at.travel * (2.0 * np.mod(at.s / SCAR, 1.0) - 1.0))


def _two_waves(p: Planted, at: Instants) -> Array:
    """A wheel that was clamped oval: two waves a turn."""
    return np.asarray(np.cos(2.0 * at.way / at.radius + p.number("phase_rad")))


def _wander(p: Planted, at: Instants) -> Array:
    """A belt that wanders to and fro over a crowned wheel."""
    return np.asarray(np.sin(2 * np.pi * at.clock / WANDER + p.number("phase_rad")) * (at.belt != 0))


def _bow(p: Planted, at: Instants) -> Array:
    """A blade that warms on the ground side and bows toward the wheel from the start of each pass."""
    return np.asarray(1.0 - np.exp(-at.time / HEATING))


def _cable(p: Planted, at: Instants) -> Array:
    """A cable that hangs loose where axis 6 stands at 0 and pulls at the blade's holder, with the square of what axis 6 turns
    away (of the chord, so that half a turn to either side is the same)."""
    return np.asarray((2.0 * np.sin(0.5 * at.q[:, 5])) ** 2)


def _coolant(p: Planted, at: Instants) -> Array:
    """Coolant that the belt throws at the blade, with the square of its speed, in the air too."""
    return np.asarray((at.belt / 20.0) ** 2)


def _chatter(p: Planted, at: Instants) -> Array:
    """The frame's own swinging, in contact."""
    return np.asarray(np.cos(2 * np.pi * RATE * at.time + p.number("phase_rad")) * (at.force > 0))


_OVERLAPS: dict[str, Form] = {"wheel_two_waves": _two_waves, "belt_wander": _wander, "blade_bow": _bow}
_PUSHES: dict[str, Form] = {"flange_stick_slip": _stick_slip, "cable_pull": _cable}
_READINGS: dict[str, Form] = {"coolant_push": _coolant, "frame_chatter": _chatter}
