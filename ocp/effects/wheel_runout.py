"""The wheel runs out of true.

The radius is m cos(w t + phase_rad) larger, w = belt speed / radius. Time t is the campaign's clock (clocked 1: the wheel
keeps turning between runs) or the time of the run (clocked 0: each run starts at the same angle); both are tried.
"""

import casadi as ca

from ocp.effects.context import ContactContext
from ocp.effects.effect import Effect, Parameter, Scanned
from ocp.effects.forms import cosines, row, tried, wave


def _runout(x: ContactContext, j: int, scanned: Scanned) -> ca.SX:
    time = ca.if_else(scanned["clocked"] > 0.5, x.clock, x.time)
    angle = x.belt / x.radius * time
    return row(*cosines(angle))


EFFECT = Effect(
    name="wheel_runout",
    title="runout of the wheel",
    subsystem="wheel",
    needs=("time_s",),
    scan=tried(clocked=(0.0, 1.0)),
    symbolic=("clocked",),
    overlap=_runout,
    **wave(
        Parameter("m", "m", 1e-5, 1e-4, signed=False),
        Parameter("clocked", "1", 0, 1, signed=False),
        scanned=("clocked",),
        usual={"clocked": 1.0},
    ),
)
