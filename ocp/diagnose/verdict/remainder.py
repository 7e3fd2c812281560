"""What the errors of the fitted parameters leave on a new reading, effects included: no correction brings the gap below it."""

import numpy as np

from ocp.diagnose.engine.system import Channel
from robots.pose import Array

SI = {"mm": 1e-3, "N": 1.0, "arcsec": float(np.radians(1.0) / 3600.0)}


def estimation_variance(channel: Channel, effects: Array) -> float:
    """Mean square SI^2 of a reading; effects (N, m): whitened columns of the channel's active effects over their priors' sd.

    With leverage h of a row, a fit without it predicts it with the variance h / (1 - h) of its noise (Allen 1974, PRESS)."""
    system = channel.system
    known = np.isfinite(system.prior_sd)
    A = np.hstack([system.nuisance * np.where(known, system.prior_sd, 1.0), effects])
    held = np.concatenate([known, np.ones(effects.shape[1], bool)])
    prior = np.where(held, 1.0, 1e-9 * np.linalg.norm(A, axis=0))
    U, s, _ = np.linalg.svd(np.vstack([A, np.diag(prior)]), full_matrices=False)
    leverage = np.minimum((U[: len(A), s > 1e-12 * s[0]] ** 2).sum(axis=1), 0.9)
    return float((SI[channel.unit] * channel.noise_floor) ** 2 * np.mean(leverage / (1.0 - leverage)))
