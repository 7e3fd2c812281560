"""Predictions of readings nobody has seen: the believed cell refitted, and corrected by the named effects, with one sigma."""

from dataclasses import replace

import numpy as np

from ocp.diagnose.engine.system import Foreseen, Sealed
from ocp.diagnose.tracker.held_out import added
from ocp.diagnose.tracker.refit import Held, Task, looked, seen_of
from robots.calibration.residuals import points
from robots.pose import Array
from robots.tracker_readings import Readings


def predict(
    before_task: Task, before: Held, after_task: Task, after: Held, lasting: Array, sealed: Readings,
    parted: Foreseen,
) -> Sealed:  # fmt: skip
    """`sealed` use the same names (targets, payloads, stations) as the readings that were fitted; `before` has no effects.
    lasting (6,): mean square rad^2 of each joint's errors that last (`background`); parted: which of `after`'s effects the
    conditions say enough of."""
    seen = replace(sealed, turn=None, sigma_turn=None, point=np.nan_to_num(sealed.point))
    baseline = points(before_task.campaign.robot, seen, before_task.campaign.instrument, before.state)
    corrected, covariance = _points(after_task, after, seen, lasting, parted)
    usual = np.mean(added(parted.unknown, seen_of(after_task, after.state), after)[1] ** 2, axis=0)
    sigma = np.sqrt(np.maximum(np.einsum("nii->ni", covariance), 0.0) + usual)
    return Sealed(baseline, corrected, sigma, parted.lacking)


def _points(task: Task, fit: Held, sealed: Readings, lasting: Array, parted: Foreseen) -> tuple[Array, Array]:
    """Points (n, 3) m in the tracker's frame, with the effects that are known there, and covariance (n, 3, 3) m^2 of where
    noise-free reflectors will be; lasting (6,): mean square rad^2 of each joint's errors that are the same whenever its axis
    comes back, and so are in noise-free readings."""
    c = task.campaign
    # Effects of the tracker and of the base act on where the reflector is: predicted, as nobody measured it.
    place = points(c.robot, sealed, c.instrument, fit.state)
    asked = replace(task, campaign=replace(c, readings=replace(sealed, point=place)))
    linear, extra = looked(asked, fit.state, parted.known)
    J = np.concatenate([linear.J, extra], axis=2)
    own = linear.J.shape[2]
    keep = np.r_[np.arange(own), own + parted.kept]
    covariance = fit.covariance[np.ix_(keep, keep)]
    D = linear.d_joints * np.sqrt(lasting)
    return linear.point, np.asarray(J @ covariance @ np.swapaxes(J, 1, 2) + D @ np.swapaxes(D, 1, 2))
