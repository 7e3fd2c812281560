"""Upper arm or forearm bends like a beam under what hangs on it.

The link's tip turns by rad_per_Nm times its load's moment, of which root_share counts at the root, and sags with it. A link is
a beam (Euler-Bernoulli cantilever, any textbook on strength of materials). The moment that counts lies between that at the
root and that at the tip: root_share 1/2 for an even beam, 1 for one that gives at its root, 0 at its tip. Link 2 is the upper
arm up to axis 3, link 3 the forearm up to the wrist centre.
"""

import casadi as ca

from ocp.effects.context import ArmContext
from ocp.effects.effect import Effect, Parameter, Scanned
from ocp.effects.forms import hanging_moment, proportional, tried

EVEN = 0.5


def _beam(x: ArmContext, j: int, scanned: Scanned) -> dict[int, ca.SX]:
    """Cantilever of length L, k = L / EI, under the moment w root + (1 - w) tip on its average: turn of the tip k times that,
    sag across the beam k L (turn / 2 + w (1 - w) (root - tip) / 3), exact for a moment that falls linearly (w = 1/2) and for
    a constant one (w = 0, 1). Link 2 ends at axis 3, link 3 at the wrist centre."""
    share = scanned["root_share"]
    tip = 2 if j == 2 else 4
    axis, start, end = x.frames[j - 1][:3, 2], x.frames[j - 1][:3, 3], x.frames[tip][:3, 3]
    root_moment = x.sign[j - 1] * x.tau[j - 1]
    tip_moment = x.sign[2] * x.tau[2] * ca.dot(axis, x.frames[2][:3, 2]) if j == 2 else ca.dot(axis, hanging_moment(x, 5))
    turn = share * root_moment + (1 - share) * tip_moment
    sag = 0.5 * turn + share * (1 - share) * (root_moment - tip_moment) / 3.0
    return {tip: ca.vertcat(sag * ca.cross(axis, end - start), turn * axis)}


EFFECT = Effect(
    name="link_bending",
    title="bending of link {joint}",
    subsystem="link",
    joints=(2, 3),
    scan=tried(root_share=(EVEN, 1.0, 0.0)),
    symbolic=("root_share",),
    twist=_beam,
    **proportional(
        Parameter("rad_per_Nm", "rad/(N m)", 1e-8, 2e-7, signed=False),
        Parameter("root_share", "1", 0.0, 1.0, signed=False),
        scanned=("root_share",),
        usual={"root_share": EVEN},
    ),
)
