"""The splice of the belt knocks once per turn of the belt.

The splice knocks at turn, turn + 1, .. of the belt, hz a second: a bell N high and `length` turns wide. It acts on the normal
reading, and on the tangential one by friction times N and `more_ft_N` along it: -friction N where a knock is too short to rub, or
strikes the one sensor alone. The splice is thicker than the belt (DIAGNOSIS, catalogue); `length` is the bell's standard
deviation. Turns count from the start of each run (clocked 0) or on the campaign's clock (1: the belt keeps
turning between runs). A force log is searched for rate, place and length beforehand (`ocp/diagnose/force/waves.py`).
"""

from collections.abc import Sequence

import casadi as ca
import numpy as np

from ocp.effects.context import ContactContext
from ocp.effects.effect import Effect, Parameter, Scanned, Surroundings
from ocp.effects.forms import proportional, row, tried

RATES = (5.0, 15.0)  # 1/s, turns of the belt
LENGTHS = (0.01, 0.12)  # of a turn: standard deviation of a knock's bell
USUAL = 0.03
GRID = 11  # rates that stand for all where no readings say which
SCANNED = ("hz", "turn", "length", "clocked")


def _scan(joint: int, seen: Surroundings) -> Sequence[Scanned]:
    if seen.splice_trains:
        return seen.splice_trains
    return tried(hz=np.linspace(*RATES, GRID).tolist(), turn=[0.0], length=[USUAL], clocked=[0.0])(joint, seen)


def _knock(x: ContactContext, scanned: Scanned) -> ca.SX:
    """Height (1, 1) of the knock; between two knocks it is zero to well below a thousandth."""
    time = ca.if_else(scanned["clocked"] > 0.5, x.clock, x.time)
    turns = time * scanned["hz"] - scanned["turn"]
    away = turns - ca.floor(turns + 0.5)
    touching = ca.if_else(x.F > 0, 1.0, 0.0) * ca.fabs(ca.sign(x.belt))
    return touching * ca.exp(-0.5 * (away / scanned["length"]) ** 2)


EFFECT = Effect(
    name="belt_splice",
    title="splice of the belt",
    subsystem="wheel",
    needs=("time_s",),
    scan=_scan,
    symbolic=SCANNED,
    sensor=lambda x, j, scanned: row(_knock(x, scanned), 0.0),
    shear=lambda x, j, scanned: ca.sign(x.belt) * row(x.friction * _knock(x, scanned), _knock(x, scanned)),
    **proportional(
        Parameter("N", "N", 1.0, 10.0, signed=False),
        Parameter("more_ft_N", "N", 0.0, 3.5),
        Parameter("hz", "1/s", *RATES, signed=False),
        Parameter("turn", "1", 0.0, 1.0, signed=False),
        Parameter("length", "1", *LENGTHS, signed=False),
        Parameter("clocked", "1", 0.0, 1.0, signed=False),
        scanned=SCANNED,
        usual=dict.fromkeys((*SCANNED, "more_ft_N"), 0.0) | {"length": USUAL},
    ),
)
