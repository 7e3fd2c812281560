"""Predictions of readings nobody has seen: the believed cell refitted, and corrected by the named effects, with one sigma."""

from dataclasses import replace

import numpy as np

from ocp.diagnosis.system import Sealed
from ocp.diagnosis.tracker.refit import Held, Task, looked
from robots.calibration.residuals import linearise
from robots.measurements import Readings
from robots.pose import Array

LASTING = (0.3, 0.6)  # share of the joint noise's variance that stays when an axis comes back, at least and at most


def predict(before_task: Task, before: Held, after_task: Task, after: Held, sealed: Readings) -> Sealed:
    """`sealed` use the same names (targets, payloads, stations) as the readings that were fitted."""
    seen = replace(sealed, turn=None, sigma_turn=None, point=np.nan_to_num(sealed.point))
    baseline, _ = _points(before_task, before, seen)
    corrected, covariance = _points(after_task, after, seen)
    sigma = np.sqrt(np.maximum(np.einsum("nii->ni", covariance), 0.0))
    return Sealed(baseline, corrected, sigma)


def _points(task: Task, fit: Held, sealed: Readings) -> tuple[Array, Array]:
    """Points (n, 3) m in the tracker's frame and covariance (n, 3, 3) m^2 of where noise-free reflectors will be.

    The joint noise beyond the joints' repeatability (gear errors and the like that nobody named) is the same whenever an axis
    comes back, and so in a noise-free reading too: what repeats leave of it, within LASTING, as few repeats say little; half of
    it where nothing was repeated.
    """
    c = task.campaign
    # Effects of the tracker and of the base act on where the reflector is: predicted, as nobody measured it.
    place = linearise(c.robot, sealed, c.instrument, task.layout, fit.state).point
    asked = replace(task, campaign=replace(c, readings=replace(sealed, point=place)))
    linear, extra = looked(asked, fit.state, fit.active)
    J = np.concatenate([linear.J, extra], axis=2)
    if task.repeats is not None and task.repeats.freedom >= 12:
        share = float(np.clip(1.0 - (task.repeats.joints / fit.noise.joints) ** 2, *LASTING))
    else:
        share = 0.5
    lasting = share * fit.noise.joints**2
    D = linear.d_joints
    return linear.point, np.asarray(J @ fit.covariance @ np.swapaxes(J, 1, 2) + lasting * D @ np.swapaxes(D, 1, 2))
