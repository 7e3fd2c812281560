"""Springs from load tests alone: the posture is held, the load changes, reflectors move (the paper's eqs. 17 and 18).

Between two readings of one posture, nest, station and session that differ in load or payload only,
    p_1 - p_0 = R sum_j J_j c_j (tau_j,1 - tau_j,0),
linear in the compliances c; geometry drops out but for the levers. Robust least squares over all such pairs.
"""

from dataclasses import dataclass, replace

import numpy as np

from robots.calibration.fit import Fit
from robots.calibration.layout import State, build_layout
from robots.calibration.noise import reading_covariance, whitener
from robots.calibration.residuals import linearise
from robots.calibration.student_t import MEDIAN_OF_THREE, tail_weights
from robots.pose import Array
from robots.tracker_readings import REPEAT_TOLERANCE, Readings

LEAST_SHIFT = 3.0  # joints are fitted whose loads move the reflectors by this many noise sds, summed in squares


@dataclass(frozen=True)
class LoadTest:
    """Compliance (k,) rad/(N m) of joints (k,) with one sigma (k,), from `pairs` pairs of readings; rms m of the readings' shift
    under load before and after the springs are taken out."""

    joints: tuple[int, ...]
    compliance: Array
    sd: Array
    pairs: int
    before: float
    after: float


def load_test(fit: Fit) -> LoadTest | None:
    """The springs that load changes show, at the geometry of `fit`; None where no posture was read under two loads."""
    c = fit.campaign
    first, second = load_pairs(c.readings)
    if not len(first):
        return None
    choice = replace(fit.choice, joints=(1, 2, 3, 4, 5, 6), payloads=())
    layout = build_layout(c.robot, replace(c.readings, turn=None), c.instrument, choice, fit.priors)
    rigid: State = replace(fit.state, arm=np.concatenate([fit.state.arm[:30], np.full(6, 1e-12)]))
    linear = linearise(c.robot, replace(c.readings, turn=None), c.instrument, layout, rigid)
    covariance = reading_covariance(c.readings, c.instrument, fit.noise, linear.d_joints)
    W = whitener(covariance[first] + covariance[second])
    columns = layout.arm[30:]
    A = W @ (linear.J[second][..., columns] - linear.J[first][..., columns])
    y = (W @ (linear.residual[second] - linear.residual[first])[..., None])[..., 0]
    seen = (A**2).sum(axis=(0, 1)) * np.abs(fit.state.arm[30:] + 1e-7) ** 2 > LEAST_SHIFT**2
    joints = tuple(int(j) + 1 for j in np.flatnonzero(seen))
    if not joints:
        return None
    A = A[..., seen]
    weight, value = np.ones(len(y)), np.zeros(len(joints))
    for _ in range(50):
        normal = np.einsum("nki,nkj,n->ij", A, A, weight)
        value = np.linalg.solve(normal, np.einsum("nki,nk,n->i", A, y, weight))
        squared = ((y - A @ value) ** 2).sum(axis=1)
        weight = tail_weights(squared / max(np.median(squared) / MEDIAN_OF_THREE, 1e-12), 3)
    # Never surer than the noise model, and allowing for what the springs themselves take up of few pairs.
    spread = max(float(np.median(squared) / MEDIAN_OF_THREE), 1.0) * 3 * len(y) / max(3 * len(y) - len(joints), 1)
    sd = np.sqrt(np.diag(np.linalg.inv(np.einsum("nki,nkj->ij", A, A))) * spread)
    shift = (linear.residual[second] - linear.residual[first])[..., None]
    left = shift[..., 0] - (np.linalg.inv(W) @ (A @ value)[..., None])[..., 0]
    rms = [float(np.sqrt(np.median((s**2).sum(axis=1)))) for s in (shift[..., 0], left)]
    return LoadTest(joints, value, sd, len(first), *rms)


def load_pairs(readings: Readings) -> tuple[Array, Array]:
    """Indices (m,), (m,) of readings of one posture, nest, station and session under different loads, each against the
    least loaded of its posture."""
    keys = np.hstack(
        [np.round(readings.q / REPEAT_TOLERANCE), *(x[:, None] for x in (readings.target, readings.station, readings.session))]
    )
    _, group = np.unique(keys, axis=0, return_inverse=True)
    group = np.asarray(group).ravel()
    load = np.linalg.norm(readings.load[:, :3], axis=1) + np.linalg.norm(readings.load[:, 3:], axis=1)
    first, second = [], []
    for g in np.unique(group):
        rows = np.flatnonzero(group == g)
        states = np.column_stack([readings.payload[rows], readings.load[rows]])
        if len(np.unique(states, axis=0)) < 2:
            continue
        base = rows[np.argmin(load[rows] + 1e-9 * readings.payload[rows])]
        for row in rows:
            if (states[rows == row] != states[rows == base]).any():
                first.append(base)
                second.append(row)
    return np.array(first, dtype=int), np.array(second, dtype=int)
