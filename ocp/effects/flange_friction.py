"""The flange sticks: seals and guides hold its stroke until the contact's force has moved by what they hold.

Stick friction of N newtons (DIAGNOSIS, catalogue: sign of its stroke rate). While the stroke moves, the contact feels N more as
the flange is pressed in and N less as it extends; after a turn of the motion it stands, the contact alone gives way, and the
friction goes from one limit to the other over about 2 N / (K + k) of the stroke that a flange without friction would have made, k
its stiffness and K that of all behind it. With u = (K + k) times that stroke the friction f follows df = du where it lets go and
df = (1 - f^2 / N^2) du where it builds up (Bouc and Wen's hysteresis at exponent 2; survey: Ismail, Ikhouane and Rodellar 2009):
f = N tanh(u / N) from rest, and so a fit finds its way. What touches the wheel has pressed the flange in. Derivatives hold K
and k still, which is a twentieth of them, a third where an effect scales these.
"""

import math
from collections.abc import Mapping
from typing import Any

import numpy as np
from scipy.linalg import solve_banded

from ocp.effects.context import LogRows
from ocp.effects.effect import Effect, Parameter, Scanned
from ocp.effects.forms import proportional, tried
from robots.pose import Array

LEAST = 0.02  # N
LIMITS = (0.1, 0.25, 0.6, 1.5, 4.0)  # N; a fit that knows nothing of friction sees up to thrice the stroke
STANDS = 0.02  # of the give: with less a flange stands at a stop, with all but so much nothing else gives
FULL = 1.0 - 1e-12  # of the limit, as good as all of it


def _held(x: LogRows, joint: int, scanned: Scanned) -> Array:
    """Friction over its limit, as much of it as the contact shows: (n, 1), or columns (n, k) of what changes of the stroke do to
    it. Nothing in the air, in a rigid cell and at a stop of the stroke."""
    moves = (x.contact > 0) & (x.flange_share > STANDS) & (x.flange_share < 1.0 - STANDS)
    goes_on = np.append(False, (x.run[1:] == x.run[:-1]) & moves[1:] & moves[:-1])
    share = np.where(moves, x.flange_share, 0.5)
    limit, both = max(abs(scanned["turn_N"]), LEAST), x.stiffness / (share * (1.0 - share))
    between = 0.5 * (both + np.append(both[:1], both[:-1]))[:, None] / limit
    steps = between * np.diff(x.d_flange, prepend=x.d_flange[:1])[:, None]
    held, kept, taken = np.array(_followed(steps[:, 0].tolist(), goes_on.tolist())).T
    shown = np.where(moves, x.flange_share, 0.0)[:, None]
    if x.stroke.ndim == 1:
        return np.asarray(shown * held[:, None])
    # change of the friction[k] = kept[k] (that of [k - 1]) + taken[k] (the step's change): two bands.
    bands = np.array([np.ones(len(kept)), np.append(-kept[1:], 0.0)])
    more = taken[:, None] * between * np.diff(x.stroke, axis=0, prepend=x.stroke[:1])
    return np.asarray(shown * solve_banded((1, 0), bands, more, check_finite=False))


def _followed(steps: list[float], goes_on: list[bool]) -> list[tuple[float, float, float]]:
    """For each of n steps of u / N: the friction over N, and how much of its own change and of the step's it takes over."""
    out, held = [], FULL
    for step, on in zip(steps, goes_on, strict=True):
        if not on:
            held = FULL
            out.append((held, 0.0, 0.0))
            continue
        before, eased = held, held * step < 0
        if eased and abs(step) <= abs(held):
            held = held + step
            out.append((held, 1.0, 1.0))
            continue
        from_, rest = (0.0, step + held) if eased else (held, step)
        held = min(max(math.tanh(math.atanh(from_) + rest), -FULL), FULL)
        left = 1.0 - held * held
        out.append((held, left if eased else left / (1.0 - before * before), left))
    return out


def _own_size(a: Array) -> Scanned:
    return {"turn_N": max(abs(float(a[0])), LEAST)}


SIZE = proportional(
    Parameter("N", "N", 0.3, 1.5, signed=False), Parameter("turn_N", "N", LEAST, 4.0, signed=False), scanned=("turn_N",)
)


def _of_table(values: Mapping[str, Any]) -> tuple[Array, dict[str, Any]]:
    """A table need not say over how much it turns. Raises ValueError: over nothing, or less."""
    if not 0.0 < values.get("turn_N", LEAST) < np.inf:
        raise ValueError(f"effect 'flange_friction': turn_N = {values['turn_N']} is not above zero; leave it out")
    return SIZE["coefficients_of"]({**_own_size(np.array([values["N"]])), **values})


EFFECT = Effect(
    name="flange_friction",
    title="friction of the flange",
    subsystem="flange",
    scan=tried(turn_N=LIMITS),
    along=_held,
    own_size=_own_size,
    **SIZE | {"coefficients_of": _of_table},
)
