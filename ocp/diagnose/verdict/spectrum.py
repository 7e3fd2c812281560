"""Spectrum of the gap in each joint's angle, weighted by the Jacobian, with circular shifts as its null.

Every reading tells the error of joint j as e_i = a_i / g_i with weight g_i (a_i, g_i: whitened residual and derivative along the
joint's direction, and the derivative's square). A wave of k per turn is fitted by weighted least squares. Shifting the
errors in the order of measuring, against the angles, keeps what they have in common over time and breaks what they owe to the
angle (circular shifts, Good 2005, chapter 3).
"""

from dataclasses import replace

import numpy as np

from ocp.diagnose.engine.findings import SpectrumPeak
from ocp.diagnose.engine.problem import Problem
from ocp.diagnose.rules import LEAST_TURN
from robots.pose import Array

ORDERS = np.arange(1.0, 121.0, 0.5)  # per turn
SHIFTS = 199


def spectra(problem: Problem, y: Array, seed: int) -> list[SpectrumPeak]:
    """Of every channel that knows how joints move its readings: one a joint, most significant first; y (N,) projected."""
    found = []
    for channel, block in zip(problem.channels, problem.stack.blocks, strict=True):
        c = channel.conditions
        if c.d_joints is None:
            continue
        rows = channel.whiten(c.d_joints)
        reading = channel.system.reading
        n = len(c.q)
        for j in range(6):
            if np.ptp(c.q[:, j]) < LEAST_TURN:
                continue
            a = np.bincount(reading, rows[:, j] * y[block], n).astype(float)
            g = np.bincount(reading, rows[:, j] ** 2, n).astype(float)
            if g.max() > 0:
                peak = _peak(j + 1, c.q[:, j], a, g, np.random.default_rng([seed, j]))
                found.append(replace(peak, signal=channel.name))
    return sorted(found, key=lambda p: p.p_value)


def _peak(joint: int, q: Array, a: Array, g: Array, rng: np.random.Generator) -> SpectrumPeak:
    shifts = rng.integers(1, len(q), SHIFTS)
    pick = (np.arange(len(q)) + np.concatenate([[0], shifts])[:, None]) % len(q)
    # The error moves, the place's weight stays: a_i = e_i g_i.
    error = np.divide(a, np.sqrt(g), out=np.zeros_like(a), where=g > 0)[pick] * np.sqrt(g)
    waves = np.exp(1j * ORDERS[None, :] * q[:, None])
    power = np.abs(error @ waves) ** 2 / (0.5 * g.sum())
    best = power.max(axis=1)
    k = int(np.argmax(power[0]))
    amplitude = float(np.abs(error[0] @ waves[:, k]) / (0.5 * g.sum()))
    p = float((1 + np.sum(best[1:] >= best[0])) / (SHIFTS + 1))
    return SpectrumPeak(joint, float(ORDERS[k]), amplitude, p, ORDERS, power[0])
