"""Wheel, blade, mount and force sensor of the virtual cell (docs/virtual_grinding.md).

Here: how hard blade and wheel press, and what the sensor shows. Not here: where the arm is without contact (twin.arm). This file
holds what the contact is asked at n instants, and what it answers.
"""

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from robots.pose import Array, Stacked

Index = NDArray[np.int64]


@dataclass(frozen=True)
class ContactMoments(Stacked):
    """n instants in time order inside each run, SI, stacks with the leading axis n.

    T_base_flange (n, 4, 4): true pose without contact; arm_compliance (n, 6, 6): twist of the flange (translation at the flange
    origin m, rotation rad, base axes) per wrench (force N, moment N m about the flange origin); p, n, t (n, 3): planned contact,
    outward normal and feed direction in the blade frame; s m along the line; line: number of the line; setpoint N of the force
    flange (nan: the cell's); feed m/s; belt m/s, signed; contact: False in an air run; clock_s since the campaign's start
    (nan: no clock), time_s since the run's; run: number of the recording; ground_before: grindings of this place before;
    wheel_temperature_C and temperature_C (nan: at the cell's reference temperature).

    Where `contact` is False, p, n, t, s and line are not looked at.
    """

    T_base_flange: Array
    arm_compliance: Array
    p: Array
    n: Array
    t: Array
    s: Array
    line: Index
    setpoint: Array
    feed: Array
    belt: Array
    contact: NDArray[np.bool_]
    clock_s: Array
    time_s: Array
    run: Index
    ground_before: Array
    wheel_temperature_C: Array
    temperature_C: Array

    def runs(self) -> list[slice]:
        """Stretches of one recording each."""
        cuts = np.flatnonzero(np.diff(self.run)) + 1
        edges = [0, *cuts.tolist(), len(self.run)]
        return [slice(a, b) for a, b in pairwise(edges) if b > a]

    def campaign_time(self) -> Array:
        """Clock of the campaign (n,) s, the run's own time where there is no clock."""
        return np.where(np.isfinite(self.clock_s), self.clock_s, self.time_s)


@dataclass(frozen=True)
class ContactResult(Stacked):
    """The contact as it is at n instants.

    force: normal force N; tangential: signed friction N along axis x outward wheel radial; overlap: of the undeformed bodies
    along the wheel radial through the planned contact m (nan in an air run); stroke of the force flange m (0: rigid mount);
    indentation of the cover m at the planned contact, along the blade's normal (nan in an air run).
    """

    force: Array
    tangential: Array
    overlap: Array
    stroke: Array
    indentation: Array
