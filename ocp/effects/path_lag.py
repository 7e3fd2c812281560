"""The contact lags along its path by the direction of travel, whatever the speed."""

from collections.abc import Sequence

from ocp.effects.effect import Effect, Parameter, Scanned, Surroundings
from ocp.effects.forms import one, shifted_by_path

ABOUT = (1e-4, 5e-4)  # m; the shift is exact at this lag and to first order about it


def _scan(joint: int, seen: Surroundings) -> Sequence[Scanned]:
    return [{"about": m} for m in ABOUT]


_ONE = one("m")

EFFECT = Effect(
    name="path_lag",
    title="lag along the path",
    subsystem="timing",
    physics="Play and friction in the drives hold the contact back by the same distance at any feed: where the log says s the "
    "contact is m behind in the direction of travel (DIAGNOSIS, catalogue). Passes in both directions tell it from a shifted "
    "blade, two feeds from a delay.",
    parameters=(Parameter("m", "m", 5e-5, 6e-4),),
    coefficients=("m",),
    prior_sd=(6e-4,),
    values=_ONE["values"],
    coefficients_of=lambda values: (_ONE["coefficients_of"](values)[0], {"about": max(abs(values["m"]), 5e-5)}),
    scan=_scan,
    along=lambda x, j, scanned: shifted_by_path(x, x.fn, scanned["about"]),
    along_shear=lambda x, j, scanned: shifted_by_path(x, x.ft, scanned["about"]),
)
