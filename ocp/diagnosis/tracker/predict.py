"""Predictions of readings nobody has seen: the believed cell refitted, and corrected by the named effects, with one sigma."""

from dataclasses import replace

import numpy as np

from ocp.diagnosis.system import Sealed
from ocp.diagnosis.tracker.refit import Held, Task, looked
from robots.calibration.residuals import points
from robots.measurements import Readings
from robots.pose import Array


def predict(before_task: Task, before: Held, after_task: Task, after: Held, lasting: Array, sealed: Readings) -> Sealed:
    """`sealed` use the same names (targets, payloads, stations) as the readings that were fitted; `before` has no effects.
    lasting (6,): mean square rad^2 of each joint's errors that last (`background`)."""
    seen = replace(sealed, turn=None, sigma_turn=None, point=np.nan_to_num(sealed.point))
    baseline = points(before_task.campaign.robot, seen, before_task.campaign.instrument, before.state)
    corrected, covariance = _points(after_task, after, seen, lasting)
    sigma = np.sqrt(np.maximum(np.einsum("nii->ni", covariance), 0.0))
    return Sealed(baseline, corrected, sigma)


def _points(task: Task, fit: Held, sealed: Readings, lasting: Array) -> tuple[Array, Array]:
    """Points (n, 3) m in the tracker's frame and covariance (n, 3, 3) m^2 of where noise-free reflectors will be; lasting (6,):
    mean square rad^2 of each joint's errors that are the same whenever its axis comes back, and so in a noise-free reading too.
    """
    c = task.campaign
    # Effects of the tracker and of the base act on where the reflector is: predicted, as nobody measured it.
    place = points(c.robot, sealed, c.instrument, fit.state)
    asked = replace(task, campaign=replace(c, readings=replace(sealed, point=place)))
    linear, extra = looked(asked, fit.state, fit.active)
    J = np.concatenate([linear.J, extra], axis=2)
    D = linear.d_joints * np.sqrt(lasting)
    return linear.point, np.asarray(J @ fit.covariance @ np.swapaxes(J, 1, 2) + D @ np.swapaxes(D, 1, 2))
