"""The wheel was moved."""

from ocp.effects.effect import Effect, Parameter
from ocp.effects.forms import after, steps_between_runs, vectors

EFFECT = Effect(
    name="wheel_frame_shift",
    title="the wheel was moved",
    subsystem="wheel",
    physics="From at_s on (campaign's clock) the wheel's centre is shifted by m (3) in base axes. What was so from the start is "
    "registration (DIAGNOSIS, catalogue). Along the wheel's axis and along the belt nothing shows.",
    parameters=(Parameter("m", "m", 5e-5, 5e-4, length=3), Parameter("at_s", "s", 0.0, 1e5, signed=False)),
    coefficients=("x", "y", "z"),
    prior_sd=(5e-4, 5e-4, 5e-4),
    needs=("clock_s",),
    scan=steps_between_runs,
    symbolic=("at_s",),
    overlap=lambda x, j, scanned: after(x.clock, scanned["at_s"]) * x.e.T,
    **vectors(("m",), "at_s"),
)
