"""How well a set of readings would fix a calibration, before any is taken: information, observability, expected error.

Unknowns are counted in units of their `Layout.scale`, readings in units of their noise, so that singular values have no unit.
Equations: docs/poses.md.
"""

from dataclasses import dataclass, replace

import numpy as np
from scipy.linalg import solve_triangular

from robots.calibration.layout import Layout, State
from robots.calibration.noise import Noise, reading_covariance, whitener
from robots.calibration.residuals import linearise
from robots.pose import Array, skew
from robots.robot import Robot
from robots.tracker_readings import Instrument, Readings

# What is known of a tracker's stand before the first reading, m and rad: next to nothing, but not nothing, so that the
# information matrix of few poses can be inverted.
STATION_SD = 1.0

CRITERIA = {
    "O1": "determinant (D-optimal; Borm and Menq 1989)",
    "O2": "inverse condition number (Driels and Pathre 1990)",
    "O3": "smallest singular value (Nahvi, Hollerbach and Hayward 1994)",
    "O4": "noise amplification index (Nahvi and Hollerbach 1996)",
    "O5": "trace of the covariance (A-optimal; Sun and Hollerbach 2008)",
}


@dataclass(frozen=True)
class Sensitivity:
    """What n readings tell: J (n, 3, p) m per scaled unknown and covariance (n, 3, 3) m^2 in the tracker's frame, d_joints
    (n, 3, 6) m/rad, point (n, 3) m; prior (p,): scale over the prior's one sigma."""

    J: Array
    covariance: Array
    d_joints: Array
    point: Array
    prior: Array

    @property
    def rows(self) -> Array:
        """J over the noise (n, 3, p), without unit."""
        return whitener(self.covariance) @ self.J


def sensitivity(
    robot: Robot, readings: Readings, instrument: Instrument, layout: Layout, state: State, noise: Noise
) -> Sensitivity:
    """Derivatives and noise of readings that need not have been taken; `state.stations` says where the tracker stands."""
    seen = linearise(robot, readings, instrument, layout, state)
    covariance = reading_covariance(replace(readings, point=seen.point, sigma=None), instrument, noise, seen.d_joints)
    sd = np.where(np.isfinite(layout.prior_sd), layout.prior_sd, STATION_SD)
    return Sensitivity(seen.J[:, :3] * layout.scale, covariance, seen.d_joints, seen.point, layout.scale / sd)


def identifiable_basis(rows: Array, prior: Array, count: int) -> Array:
    """Orthonormal directions (p, r), in units of the priors, that `count` average readings of rows (m, 3, p) fix better than
    the priors do."""
    A = (rows / prior).reshape(-1, rows.shape[-1])
    value, vector = np.linalg.eigh(A.T @ A * (count / len(rows)))
    return np.asarray(vector[:, value > 1.0])


def observability(singular: Array, count: int, criterion: str) -> Array:
    """Index (...) of singular values (..., L) > 0 of `count` readings; larger is better. `CRITERIA` has the sources."""
    s = np.asarray(singular, float)
    low, high = s.min(axis=-1), s.max(axis=-1)
    if criterion == "O1":
        return np.asarray(np.exp(np.log(s).mean(axis=-1)) / np.sqrt(count))
    if criterion == "O2":
        return np.asarray(low / high)
    if criterion == "O3":
        return np.asarray(low)
    if criterion == "O4":
        return np.asarray(low**2 / high)
    return np.asarray(1.0 / (s**-2).sum(axis=-1))


def singular_values(rows: Array, prior: Array, basis: Array) -> Array:
    """Singular values (r,) of readings with rows (n, 3, p) and the priors, in the identifiable directions (p, r)."""
    A = (rows / prior).reshape(-1, len(prior)) @ basis
    return np.asarray(np.linalg.svd(np.vstack([A, np.eye(basis.shape[1])]), compute_uv=False))


def posterior_root(rows: Array, prior: Array) -> Array:
    """Upper triangular R (p, p) with R^T R the information of readings with rows (n, 3, p) and of the priors."""
    return np.asarray(np.linalg.qr(np.vstack([rows.reshape(-1, len(prior)), np.diag(prior)]), mode="r"))


def expected_error(rows: Array, prior: Array, J: Array) -> Array:
    """One sigma (k,) m, all three directions together, of points with derivatives J (k, 3, p) after a fit to rows (n, 3, p).

    Raises numpy.linalg.LinAlgError: a column is neither measured nor has a prior.
    """
    R = posterior_root(rows, prior)
    if np.abs(np.diag(R)).min() < 1e-12 * np.abs(np.diag(R)).max():
        raise np.linalg.LinAlgError("an unknown is neither measured nor known before")
    half = solve_triangular(R, J.reshape(-1, len(prior)).T, trans="T")
    return np.asarray(np.sqrt((half**2).sum(axis=0).reshape(len(J), 3).sum(axis=1)))


def posterior_sd(rows: Array, prior: Array) -> Array:
    """One sigma (p,) of every unknown after the fit over its one sigma before."""
    root = solve_triangular(posterior_root(rows, prior), np.eye(len(prior)))
    return np.asarray(np.sqrt((root**2).sum(axis=1)) * prior)


def carried_point(nests: Array, point: Array) -> Array:
    """K (3, 3 k): displacement of a point (3,) of a body from those of k >= 3 nests (k, 3), by least squares; base axes.

    Small motion a + w x (x - c) fitted to the nests' displacements, taken at the point. It has no part in what the nests
    cannot show, the choice of the flange's own frame.
    """
    centre = nests.mean(axis=0)
    lever = np.vstack([np.hstack([np.eye(3), -skew(x - centre)]) for x in nests])
    return np.asarray(np.hstack([np.eye(3), -skew(point - centre)]) @ np.linalg.pinv(lever))
