"""Signs of the axes' motion along a pass, for effects that change with the direction of approach.

Where an axis turns back the sign goes through zero over a few millimetres: where exactly friction lets go nobody knows, and a
jump of the command over one waypoint could not be driven.
"""

import numpy as np

from robots.pose import Array

WINDOW = 3e-3  # m to either side over which the sign is averaged
STILL = 1e-3  # rad/m; an axis that turns less per metre of the pass keeps the sign it had


def approach_signs(q: Array, s: Array) -> Array:
    """Averaged signs (n, 6), -1 to 1, of the motion of axes q (n, 6) rad along the arc length s (n,) m."""
    rate = np.diff(q, axis=0) / np.maximum(np.diff(s), 1e-9)[:, None]
    sign = np.where(np.abs(rate) > STILL, np.sign(rate), 0.0)
    for j in range(sign.shape[1]):
        known = np.flatnonzero(sign[:, j])
        if len(known):
            last = np.maximum.accumulate(np.where(sign[:, j] != 0, np.arange(len(sign)), -1))
            sign[:, j] = np.where(last >= 0, sign[np.maximum(last, 0), j], sign[known[0], j])
    # The integral of the sign, straight on beyond both ends.
    far = 2 * WINDOW
    at = np.concatenate([[s[0] - far], s, [s[-1] + far]])
    steps = np.vstack([sign[:1], sign, sign[-1:]]) * np.diff(at)[:, None]
    whole = np.vstack([np.zeros((1, sign.shape[1])), np.cumsum(steps, axis=0)])
    out = np.empty_like(q, dtype=float)
    for j in range(out.shape[1]):
        out[:, j] = (np.interp(s + WINDOW, at, whole[:, j]) - np.interp(s - WINDOW, at, whole[:, j])) / (2 * WINDOW)
    return out
