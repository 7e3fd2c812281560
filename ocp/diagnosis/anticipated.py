"""What the named effects change where nobody has measured yet: the campaign's postures with every payload that the cell names.

Nothing sealed is read. New readings are taken to come after the campaign, with any of the cell's payloads in any mixture:
an effect that the refitted geometry hides among the payloads measured may show with another one, and then the baseline is worse
than on the campaign itself.
"""

from dataclasses import dataclass, replace

import numpy as np

from ocp.diagnosis.planned import foreseen
from ocp.diagnosis.tracker.channel import TrackerChannel
from robots.measurements import Readings

LATER = 1.0 / 3.0  # of the campaign's duration: how far ahead new readings are thought


@dataclass(frozen=True)
class Group:
    """New readings with one payload, mean squares m^2 of a reading: moved by the effects (corrected less baseline), errors of the
    parameters of the corrected model, joint noise."""

    payload: str
    moved: float
    estimation: float
    noise: float


def anticipated(before: TrackerChannel, after: TrackerChannel) -> list[Group]:
    """One group for every payload of the cell."""
    readings = _later(after.readings)
    found = []
    for k, name in enumerate(readings.payloads):
        new = replace(readings, payload=np.full(len(readings), k, np.int64))
        old, now = foreseen(before, new).fit, foreseen(after, new).fit
        J = np.concatenate([now.linear.J, now.extra], axis=2)
        moved = np.sum((now.linear.point - old.linear.point) ** 2, axis=1)
        estimation = np.einsum("nij,jk,nik->n", J, now.covariance, J, optimize=True)
        noise = after.fit.noise.joints**2 * np.sum(now.linear.d_joints**2, axis=(1, 2))
        found.append(Group(name, float(moved.mean()), float(estimation.mean()), float(noise.mean())))
    return found


def _later(readings: Readings) -> Readings:
    """The campaign's postures once more, after its end, without loads."""
    n = len(readings)
    time = readings.time
    if time is not None:
        length = float(np.ptp(time))
        time = float(time.max()) + LATER * length * (np.argsort(np.argsort(time)) + 1.0) / n
    return replace(readings, time=time, turn=None, sigma_turn=None, load=np.zeros((n, 6)))
