"""The blade is gripped anew and sits elsewhere."""

from ocp.effects.effect import Effect, Parameter
from ocp.effects.forms import after, steps_between_runs, vectors

EFFECT = Effect(
    name="tool_frame_shift",
    title="the blade sits elsewhere in its grip",
    subsystem="tool",
    physics="From at_s on (campaign's clock) the blade's frame is shifted by m (3) in the flange frame. What was so from the "
    "start is registration (DIAGNOSIS, catalogue).",
    parameters=(Parameter("m", "m", 5e-5, 5e-4, length=3), Parameter("at_s", "s", 0.0, 1e5, signed=False)),
    coefficients=("x", "y", "z"),
    prior_sd=(5e-4, 5e-4, 5e-4),
    needs=("clock_s",),
    scan=steps_between_runs,
    symbolic=("at_s",),
    overlap=lambda x, j, scanned: -after(x.clock, scanned["at_s"]) * (x.e.T @ x.R_flange),
    **vectors(("m",), "at_s"),
)
