"""The believed arm and the active effects fitted together to tracker readings, effects inside the nonlinear prediction.

Joint shifts are added to the commanded joints before the arm is bent and placed; twists and displacements of readings, below a
millimetre, are added to first order (their second order is below a micrometre). Gauss-Newton from a fit nearby.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from ocp.diagnose.tracker.motion import Seen, together
from ocp.diagnose.tracker.noise import joint_noise, reliability
from ocp.effects.effect import Active
from robots.calibration.layout import Layout, State, moved
from robots.calibration.noise import Noise, Repeats, reading_covariance, whitener
from robots.calibration.residuals import Linearised, linearise, points
from robots.calibration.solver import Campaign
from robots.pose import Array

STEPS = 8
SETTLED = 0.01  # of one posterior sd


@dataclass(frozen=True)
class Held:
    """A fit with active effects: state and its offset (p,) from the prior's mean, active effects with values and covariance,
    linear (residual about everything, derivatives in the layout's unknowns), extra (n, 3, m) m per unit coefficient of all
    active effects side by side, W (n, 3, 3) whitener with the readings' reliability in it, weight (n,), noise, covariance of
    all unknowns, coefficients last."""

    state: State
    offset: Array
    active: tuple[Active, ...]
    linear: Linearised
    extra: Array
    W: Array
    weight: Array
    noise: Noise
    covariance: Array


@dataclass(frozen=True)
class Task:
    """What is fitted: campaign (points only), layout with its priors, prior mean, reference temperature deg C,
    repeats."""

    campaign: Campaign
    layout: Layout
    start: State
    reference: float
    repeats: Repeats | None = None


def refit(task: Task, state: State, offset: Array, active: Sequence[Active], noise: Noise) -> Held:
    """Fit from `state` and the active effects' values, the joint noise with it."""
    found = _settled(task, state, offset, tuple(active), noise)
    for _ in range(3):
        used = freedom_used(task.layout, found)
        off = found.linear.residual
        c = task.campaign
        after = joint_noise(c.readings, c.instrument, off, found.linear.d_joints, used, task.repeats)
        small = abs(np.log(after.joints / noise.joints)) < 0.02
        noise = after
        found = _settled(task, found.state, found.offset, found.active, noise, (found.linear, found.extra))
        if small:
            break
    return found


def settled(task: Task, fit: Held) -> Held:
    """`fit` brought to rest with the priors and readings of `task`; its joint noise stays."""
    return _settled(task, fit.state, fit.offset, fit.active, fit.noise)


def freedom_used(layout: Layout, fit: Held) -> float:
    """Degrees of freedom that the readings, not the priors, take up."""
    prior = np.concatenate([layout.prior_sd, *[np.asarray(a.effect.prior_sd, float) for a in fit.active]])
    return float(np.sum(1.0 - np.diag(fit.covariance) / prior**2))


def looked(task: Task, state: State, active: tuple[Active, ...]) -> tuple[Linearised, Array]:
    """Residuals about state and effects, and the effects' columns (n, 3, m)."""
    c = task.campaign
    n = len(c.readings)
    if not active:
        return linearise(c.robot, c.readings, c.instrument, task.layout, state), np.zeros((n, 3, 0))
    parts, shift, displacement = together(active, seen_of(task, state))
    turned = replace(c.readings, q=c.readings.q + shift)
    linear = linearise(c.robot, turned, c.instrument, task.layout, state)
    linear = replace(linear, residual=linear.residual - displacement, point=linear.point + displacement)
    extra = np.concatenate([linear.d_joints @ p[:, :6] + p[:, 6:] for p in parts], axis=2)
    return linear, extra


def placed(task: Task, state: State, active: tuple[Active, ...]) -> Array:
    """Predicted reflectors (n, 3) m alone, as `looked` gives them."""
    c = task.campaign
    if not active:
        return points(c.robot, c.readings, c.instrument, state)
    _, shift, displacement = together(active, seen_of(task, state))
    return points(c.robot, replace(c.readings, q=c.readings.q + shift), c.instrument, state) + displacement


def seen_of(task: Task, state: State) -> Seen:
    """The readings about a state, for effects."""
    c = task.campaign
    return Seen(c.robot, c.readings, c.instrument, state, c.readings.point, task.reference, task.start.arm[30:])


def _settled(
    task: Task, state: State, offset: Array, active: tuple[Active, ...], noise: Noise,
    here: tuple[Linearised, Array] | None = None,
) -> Held:  # fmt: skip
    """Gauss-Newton until a step is small against the posterior; here: what `looked` says of the beginning, where it is known."""
    c, layout = task.campaign, task.layout
    linear, extra = looked(task, state, active) if here is None else here
    for _ in range(STEPS):
        W = whitener(reading_covariance(c.readings, c.instrument, noise, linear.d_joints))
        squared = np.einsum("nij,nj->ni", W, linear.residual)
        weight = reliability((squared**2).sum(axis=1))
        W = W * np.sqrt(weight)[:, None, None]
        prior = np.concatenate([layout.prior_sd, *[np.asarray(a.effect.prior_sd, float) for a in active]])
        centre = np.concatenate([offset, *[a.a for a in active]])
        scale = np.where(np.isfinite(prior), prior, np.concatenate([layout.scale, np.ones(len(prior) - layout.size)]))
        rows = (W @ np.concatenate([linear.J, extra], axis=2)).reshape(-1, len(prior)) * scale
        known = np.isfinite(prior)
        A = np.vstack([rows, np.eye(len(prior))[known]])
        y = np.concatenate([np.einsum("nij,nj->ni", W, linear.residual).ravel(), -(centre / scale)[known]])
        U, s, Vt = np.linalg.svd(A, full_matrices=False)
        safe = s > 1e-9 * s[0]
        V = Vt[safe].T / s[safe]
        step = scale * (V @ (U[:, safe].T @ y))
        length = float(np.linalg.norm(A @ (step / scale)))
        covariance = scale[:, None] * (V @ V.T) * scale[None, :]
        state, offset = moved(layout, state, step[: layout.size]), offset + step[: layout.size]
        active = _stepped(active, step[layout.size :], covariance[layout.size :, layout.size :])
        linear, extra = looked(task, state, active)
        if length < SETTLED * np.sqrt(len(prior)):
            break
    return Held(state, offset, active, linear, extra, W, weight, noise, covariance)


def _stepped(active: tuple[Active, ...], step: Array, covariance: Array) -> tuple[Active, ...]:
    """Active effects after a step of their coefficients."""
    found, start = [], 0
    for one in active:
        block = slice(start, start + one.effect.size)
        start = block.stop
        found.append(replace(one, a=one.a + step[block], covariance=covariance[block, block]))
    return tuple(found)
