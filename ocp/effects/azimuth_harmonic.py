"""The tracker's azimuth circle: an error that repeats with the head's turn.

Azimuths x about the head's z axis read too large by rad cos(order x + phase_rad). A circle that sits off centre does so once a
turn (order 1), an oval one twice; several read heads and the wheel that drives the head leave higher orders (Muralikrishnan et
al. 2009, J. Res. NIST 114, 21: the error terms of a laser tracker). Over the narrow sector in which a robot stands
neighbouring orders look alike, and the frame takes most of the slow ones.
"""

import casadi as ca

from ocp.effects.context import TrackerContext
from ocp.effects.effect import Effect, Parameter, Scanned
from ocp.effects.forms import cosines, tried, wave


def _turned(x: TrackerContext, j: int, scanned: Scanned) -> ca.SX:
    level = ca.vertcat(-x.point[1], x.point[0], 0)
    return level @ ca.horzcat(*cosines(scanned["order"] * ca.atan2(x.point[1], x.point[0])))


EFFECT = Effect(
    name="azimuth_harmonic",
    title="error of the tracker's azimuth",
    subsystem="tracker",
    scan=tried(order=range(1, 13)),
    symbolic=("order",),
    reading=_turned,
    **wave(Parameter("order", "1", 1, 12, signed=False), Parameter("rad", "rad", 3e-6, 5e-5, signed=False), scanned=("order",)),
)
