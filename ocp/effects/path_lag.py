"""The contact lags along its path by the direction of travel, whatever the speed.

Where the log says s the contact is m behind in the direction of travel, at any feed. Play and friction in the drives hold it
back (DIAGNOSIS, catalogue). Passes in both directions tell it from a shifted blade, two feeds from a delay.
"""

from ocp.effects.effect import Effect, Parameter
from ocp.effects.forms import late, shifted_by_path

EFFECT = Effect(
    name="path_lag",
    title="lag along the path",
    subsystem="timing",
    **late(Parameter("m", "m", 5e-5, 6e-4), about=(1e-4, 5e-4), least=5e-5, shifted=shifted_by_path),
)
