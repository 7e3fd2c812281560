"""The force is logged later than the motion."""

from collections.abc import Sequence

from ocp.effects.effect import Effect, Parameter, Scanned, Surroundings
from ocp.effects.forms import one, shifted_by_time

ABOUT = (0.002, 0.015, 0.04)  # s; the shift is exact at this delay and to first order about it


def _scan(joint: int, seen: Surroundings) -> Sequence[Scanned]:
    return [{"about": t} for t in ABOUT]


_ONE = one("s")

EFFECT = Effect(
    name="time_delay",
    title="delay of the force logger",
    subsystem="timing",
    physics="Filters and buses delay what the sensor says: the reading at t shows the force at t - s, s positive where the "
    "logger is behind the motion (DIAGNOSIS, catalogue). In force-only logs at one feed an axis error that goes with speed looks "
    "the same.",
    parameters=(Parameter("s", "s", 0.002, 0.06),),
    coefficients=("s",),
    prior_sd=(0.06,),
    values=_ONE["values"],
    coefficients_of=lambda values: (_ONE["coefficients_of"](values)[0], {"about": max(abs(values["s"]), 1e-3)}),
    needs=("time_s",),
    scan=_scan,
    along=lambda x, j, scanned: shifted_by_time(x, x.fn, scanned["about"]),
    along_shear=lambda x, j, scanned: shifted_by_time(x, x.ft, scanned["about"]),
)
