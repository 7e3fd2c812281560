"""The blade slips in its clamp."""

from ocp.effects._forms import after, row, scanned_with, steps
from ocp.effects.effect import Effect, Parameter

EFFECT = Effect(
    name="clamp_slip",
    title="slip in the clamp",
    subsystem="blade",
    physics="From at_s on (campaign's clock) the blade stands m further back along its normal at the contact, away from the "
    "wheel, where grinding pushes it; negative: into the wheel (DIAGNOSIS, catalogue).",
    parameters=(Parameter("m", "m", 2e-5, 3e-4), Parameter("at_s", "s", 0.0, 1e5, signed=False)),
    coefficients=("m",),
    prior_sd=(3e-4,),
    needs=("clock_s",),
    scan=steps,
    symbolic=("at_s",),
    overlap=lambda x, j, scanned: row(-after(x.clock, scanned["at_s"])),
    **scanned_with(("m",), "at_s"),
)
