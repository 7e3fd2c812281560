"""What remains after the named effects, above the instrument's own noise: a posterior predictive check, signal by signal.

A fit's joint noise is learnt from its residual and holds whatever is not modelled, so its size does not stand out. Here the
residual is held against the instrument and the repeatability that repeats show, else the usual one (Rubin 1984, section 5; tail
probability averaged over how well the repeatability is known), its pattern against the kernel that follows it best, the number of
kernels allowed for, and one group's scatter against the others' (`robots.calibration.uneven`). The smallest of these p-values
counts as often as there are tests.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.special import chdtrc, fdtrc, ndtri

from ocp.diagnose.engine.channel_system import SCALE, Channel
from ocp.diagnose.engine.evidence import stack
from ocp.diagnose.engine.findings import KernelTest
from ocp.diagnose.engine.search import outliers
from ocp.diagnose.rules import NOISE_TRUST, PLACE_SURE
from ocp.diagnose.tracker.channel import TrackerChannel
from ocp.diagnose.tracker.refit import freedom_used, usual_noise
from robots.calibration.noise import Noise, reading_covariance

LEVELS = 21  # of the joint noise that are averaged


@dataclass(frozen=True)
class Remaining:
    """Rms (SI, of the reading's size) that stays above the instrument's noise, 0 where noise may well be all (`PLACE_SURE`);
    probability that noise alone leaves as much."""

    above_noise: float
    p_value: float


def remaining(channel: Channel, tests: Sequence[KernelTest]) -> Remaining:
    """Of a channel with the named effects in it, gross readings apart; tests: kernel tests after the effects."""
    told = [_of_tracker(channel) if isinstance(channel, TrackerChannel) else _of_rows(channel)]
    if isinstance(channel, TrackerChannel):  # a test that found nothing is one too
        one = channel.uneven
        told.append(Remaining(0.0, 1.0) if one is None else Remaining(one.rms * float(np.sqrt(one.share)), one.p_value))
    if own := [t for t in tests if t.channel == channel.name]:
        best = min(own, key=lambda t: t.p_value)
        noise = channel.noise_floor / SCALE[channel.unit]
        follows = noise * float(np.sqrt(max(best.gained, 0.0) / len(channel.system.residual)))
        told.append(Remaining(follows, min(1.0, best.p_value * len(own))))
    above = max((r.above_noise for r in told if r.p_value < PLACE_SURE), default=0.0)
    return Remaining(above, min(1.0, len(told) * min(r.p_value for r in told)))


def _of_tracker(channel: TrackerChannel) -> Remaining:
    fit, c = channel.fit, channel.task.campaign
    good = ~outliers(channel)
    off, d_joints, readings = fit.linear.residual[good], fit.linear.d_joints[good], c.readings.take(np.flatnonzero(good))
    freedom = max(3.0 * len(off) - freedom_used(channel.task.layout, fit), 1.0)
    usual, sd = usual_noise(channel.task.repeats)
    p = 0.0
    for level in usual * np.exp(sd * ndtri((np.arange(LEVELS) + 0.5) / LEVELS)):
        S = reading_covariance(readings, c.instrument, Noise(float(level)), d_joints)
        squares = float(np.einsum("ni,ni->", off, np.linalg.solve(S, off[..., None])[..., 0]))
        p += float(chdtrc(freedom, squares)) / LEVELS
    square = float(np.mean(np.sum(off**2, axis=1))) * 3.0 * len(off) / freedom
    own = reading_covariance(readings, c.instrument, Noise(usual), d_joints)
    return Remaining(float(np.sqrt(max(square - np.trace(own, axis1=1, axis2=2).mean(), 0.0))), p)


def _of_rows(channel: Channel) -> Remaining:
    """Whitened rows against unit noise, whose scale is known to `NOISE_TRUST` rows."""
    made = stack((channel,), np.zeros(len(channel.system.residual)))
    freedom = max(float(made.freedom), 1.0)
    ratio = float(made.y @ made.y) / freedom
    gap = channel.gap()[~outliers(channel)]
    square = float(np.mean(np.sum(gap.reshape(len(gap), -1) ** 2, axis=1)))
    return Remaining(float(np.sqrt(max(square * (1.0 - 1.0 / max(ratio, 1.0)), 0.0))), float(fdtrc(freedom, NOISE_TRUST, ratio)))
