"""Folds of tracker readings: blocks of the workspace and random parts, and conditions that are left out as a whole."""

import numpy as np
from scipy.cluster.vq import kmeans2

from ocp.diagnose.engine.system import Fold
from robots.pose import Array
from robots.tracker_readings import Readings

PARTS = 5
LEAST_RANGE = np.radians(20.0)  # an axis that moved less has no half to leave out
LEAST_WARMTH, LEAST_TIME = 1.0, 600.0  # K, s
LEAST = 8  # readings on each side


def tracker_folds(readings: Readings, seed: int = 0) -> list[Fold]:
    """Random and regional parts (repeats stay together), then payloads, sessions, warm and late readings, halves of joints'
    ranges, approach from one side."""
    r = readings
    group = r.repeats()
    part = np.random.default_rng(seed).permutation(np.arange(group.max() + 1) % PARTS)[group]
    found = [Fold(f"random={k + 1}", "random", part == k) for k in range(PARTS)]
    _, label = kmeans2(r.q[:, :3], PARTS, seed=seed, minit="++")
    found += [Fold(f"block={k + 1}", "block", label == k) for k in np.unique(label)]
    for kind, index, names in (("payload", r.payload, r.payloads), ("session", r.session, r.sessions)):
        if len(np.unique(index)) > 1:
            found += [Fold(f"{kind}={names[k]}", kind, index == k) for k in np.unique(index)]
    for kind, values, least in (("temperature", r.temperature, LEAST_WARMTH), ("time", r.time, LEAST_TIME)):
        if values is not None and np.ptp(values) > least:
            found += _thirds(kind, values)
    for j in range(6):
        if np.ptp(r.q[:, j]) > LEAST_RANGE:
            middle = float(np.median(r.q[:, j]))
            degrees = f"{np.degrees(middle):.0f}"
            found.append(Fold(f"joint {j + 1} above {degrees} deg", "joint range", r.q[:, j] > middle))
            found.append(Fold(f"joint {j + 1} below {degrees} deg", "joint range", r.q[:, j] <= middle))
    return [f for f in found if f.held.sum() >= LEAST and (~f.held).sum() >= LEAST]


def _thirds(kind: str, values: Array) -> list[Fold]:
    """The highest third."""
    cut = float(np.quantile(values, 2 / 3))
    unit = {"temperature": "C", "time": "s"}[kind]
    return [Fold(f"{kind} above {cut:.4g} {unit}", kind, values > cut)]
