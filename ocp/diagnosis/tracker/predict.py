"""Predictions of readings nobody has seen: the believed cell refitted, and corrected by the named effects, with one sigma."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from ocp.diagnosis.system import Sealed
from ocp.diagnosis.tracker.motion import together
from ocp.diagnosis.tracker.refit import Held, Task, looked, seen_of
from ocp.effects.effect import Active
from robots.calibration.residuals import points
from robots.measurements import Readings
from robots.pose import Array


def predict(
    before_task: Task, before: Held, after_task: Task, after: Held, lasting: Array, sealed: Readings,
    unknown: Sequence[Active] = (),
) -> Sealed:  # fmt: skip
    """`sealed` use the same names (targets, payloads, stations) as the readings that were fitted; `before` has no effects.
    lasting (6,): mean square rad^2 of each joint's errors that last (`background`); unknown: those of the effects for which the
    conditions lack a column."""
    seen = replace(sealed, turn=None, sigma_turn=None, point=np.nan_to_num(sealed.point))
    baseline = points(before_task.campaign.robot, seen, before_task.campaign.instrument, before.state)
    corrected, covariance = _points(after_task, after, seen, lasting, unknown)
    usual = np.mean(_size(after_task, after, unknown) ** 2, axis=0)
    sigma = np.sqrt(np.maximum(np.einsum("nii->ni", covariance), 0.0) + usual)
    return Sealed(baseline, corrected, sigma, tuple(a.effect.name for a in unknown))


def _size(task: Task, fit: Held, active: Sequence[Active]) -> Array:
    """What effects add (n, 3) m in the readings that were fitted."""
    if not active:
        return np.zeros((1, 3))
    parts, _, _ = together(tuple(active), seen_of(task, fit.state))
    changes = [(fit.linear.d_joints @ p[:, :6] + p[:, 6:]) @ a.a for p, a in zip(parts, active, strict=True)]
    return np.asarray(sum(changes))


def _points(task: Task, fit: Held, sealed: Readings, lasting: Array, unknown: Sequence[Active]) -> tuple[Array, Array]:
    """Points (n, 3) m in the tracker's frame, without the effects `unknown`, and covariance (n, 3, 3) m^2 of where noise-free
    reflectors will be; lasting (6,): mean square rad^2 of each joint's errors that are the same whenever its axis comes back, and
    so in a noise-free reading too."""
    gone = {(a.effect.name, a.joint) for a in unknown}
    known = tuple(a for a in fit.active if (a.effect.name, a.joint) not in gone)
    inside = [(a.effect.name, a.joint) not in gone for a in fit.active for _ in range(a.effect.size)]
    c = task.campaign
    # Effects of the tracker and of the base act on where the reflector is: predicted, as nobody measured it.
    place = points(c.robot, sealed, c.instrument, fit.state)
    asked = replace(task, campaign=replace(c, readings=replace(sealed, point=place)))
    linear, extra = looked(asked, fit.state, known)
    J = np.concatenate([linear.J, extra], axis=2)
    own = linear.J.shape[2]
    keep = np.r_[np.arange(own), own + np.flatnonzero(inside)]
    covariance = fit.covariance[np.ix_(keep, keep)]
    D = linear.d_joints * np.sqrt(lasting)
    return linear.point, np.asarray(J @ covariance @ np.swapaxes(J, 1, 2) + D @ np.swapaxes(D, 1, 2))
