"""The detectability index of a planted effect: how far its true signature stands out of noise and of all that is refitted.

    lambda = d^T (Sigma + A P A^T)^-1 d                                                       (DIAGNOSIS, "How it is judged")

d (3n,) is the reading with the effect less the reading without it on the same virtual cell, Sigma the covariance of a reading
with the joints' repeatability, A the derivatives in everything a machine is drawn with, P the variances it is drawn with: the
right covariance, not one that was fitted. Scanned families pay 2 ln(variants), the price of looking at all of them.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from ocp.blindtest.worlds.scene import Scene
from ocp.simulate.twin.arm.arm import make_arm
from ocp.simulate.twin.truth.truth import MASS_SD, PLACEMENT, PLAY, REPEATABILITY, RIPPLE, STIFFNESS
from robots.pose import Array

FREE = 1.0  # m, rad: the tracker's place is not known at all
_MASS_STEP = 0.01
# Instants that can be told apart, orders, nests: how many members of a scanned family are looked at.
GEAR_ORDERS, MOTOR_ORDERS = 298, 2


@dataclass(frozen=True, eq=False)
class Whitener:
    """The symmetric root of (Sigma + A P A^T)^-1: W (n, 3, 3) of the readings, then U (3n, r) and what it takes of each
    direction (r,)."""

    W: Array
    U: Array
    take: Array

    def apply(self, changes: Array) -> Array:
        """White rows (3n, ...) of changes (n, 3, ...) m."""
        n = len(changes)
        rows = (self.W @ changes.reshape(n, 3, -1)).reshape(3 * n, -1)
        rows = rows - self.U @ (self.take[:, None] * (self.U.T @ rows))
        return np.asarray(rows.reshape(3 * n, *changes.shape[2:]))


def whitener(scene: Scene, kept: Array | None = None) -> Whitener:
    """With the variances that machines are drawn with; a machine with background ripple and play has those too. kept (n,):
    readings that count."""
    A, sd = nuisance(scene)
    W = np.linalg.inv(np.linalg.cholesky(reading_covariance(scene)))
    if kept is not None:
        W = W * kept[:, None, None]
    rows = (W @ A).reshape(3 * len(scene), -1) * sd
    U, s, _ = np.linalg.svd(rows, full_matrices=False)
    keep = s > 1e-9
    return Whitener(W, U[:, keep], 1.0 - 1.0 / np.sqrt(1.0 + s[keep] ** 2))


def reading_covariance(scene: Scene) -> Array:
    """Covariance (n, 3, 3) m^2 of the readings: the instrument's directions, repeatability through the Jacobian; ripples of the
    background, each of an order nobody knows, scatter like joint noise."""
    table = scene.cell.tables.tracker
    along = 1e-6 * (table.range_noise_um if table is not None else 8.0)
    per_metre = 1e-6 * (table.transverse_noise_um_per_m if table is not None else 3.0)
    distance = np.linalg.norm(scene.point, axis=1)
    beam = scene.point / distance[:, None]
    across = (along + per_metre * distance) ** 2
    own = across[:, None, None] * np.eye(3) + (along**2 - across)[:, None, None] * beam[:, :, None] * beam[:, None, :]
    joints = REPEATABILITY**2 + (RIPPLE**2 / 6 if has_background(scene) else 0.0)
    return np.asarray(own + joints * scene.D @ np.swapaxes(scene.D, 1, 2))


def has_background(scene: Scene) -> bool:
    """Whether the machine has ripple and play that nobody planted."""
    return bool(scene.truth.ripple[:, 0].any() or scene.truth.play.any())


def nuisance(scene: Scene) -> tuple[Array, Array]:
    """Derivatives (n, 3, p) of the points and one sigma (p,) of what a machine is drawn with: the tracker's place, the placement
    of every link, nests, springs, masses, and the play of a background."""
    n = len(scene)
    blocks, sds = [], []
    frame = np.concatenate([np.broadcast_to(np.eye(3), (n, 3, 3)), -cross_matrices(scene.point)], axis=2)
    blocks.append(frame)
    sds += [FREE] * 6
    for link in range(1, 7):
        R = scene.links[:, link, :3, :3]
        motion = np.zeros((n, 6, 6))
        motion[:, :3, :3] = motion[:, 3:, 3:] = R
        blocks.append(scene.moved(link, motion))
        sds += list(np.repeat(PLACEMENT, 3))
    table = scene.cell.tables.tracker
    for name in dict.fromkeys(scene.campaign.targets):
        own = np.array([t == name for t in scene.campaign.targets])
        R = scene.links[np.arange(n), scene.carrier, :3, :3]
        blocks.append(scene.turn @ R * own[:, None, None])
        sds += [1e-3 * (table.target_sd_mm if table is not None else 1.0)] * 3
    give = _compliance(scene)
    blocks.append(scene.D * (scene.tau * give)[:, None, :])
    sds += [STIFFNESS / np.sqrt(3.0)] * 6
    blocks.append(_masses(scene, give))
    sds += [MASS_SD] * 7
    if has_background(scene):
        blocks.append(scene.D * scene.campaign.moments.approach[:, None, :])
        sds += [PLAY / np.sqrt(3.0)] * 6
    return np.concatenate(blocks, axis=2), np.array(sds)


def _compliance(scene: Scene) -> Array:
    """rad/(N m) of the joints that weight bends."""
    k = scene.truth.stiffness
    return np.asarray(np.divide(1.0, k, out=np.zeros(6), where=k > 0) * scene.truth.bends)


def _masses(scene: Scene, give: Array) -> Array:
    """Derivatives (n, 3, 7) in the relative masses of base and links, through the torques they make."""
    columns = np.zeros((len(scene), 3, 7))
    for link in range(1, 7):
        scale = scene.truth.mass_scale.copy()
        scale[link] += _MASS_STEP
        changed = make_arm(scene.cell, replace(scene.truth, mass_scale=scale)).settled(scene.campaign.moments)
        torque = (changed.load_torque[:, :6] - scene.tau) / _MASS_STEP
        columns[:, :, link] = np.einsum("nij,nj->ni", scene.D, torque * give)
    return columns


def cross_matrices(v: Array) -> Array:
    """Matrices (n, 3, 3) of the cross products v x."""
    x, y, z = v[:, 0], v[:, 1], v[:, 2]
    zero = np.zeros(len(v))
    return np.stack([np.stack([zero, -z, y], 1), np.stack([z, zero, -x], 1), np.stack([-y, x, zero], 1)], axis=1)


def variants(effect: str, scene: Scene) -> int:
    """How many members of a scanned family are looked at: orders, instants, nests; 1 for effects of one form."""
    nests = len(set(scene.campaign.targets))
    counts = {
        "gear_harmonic": GEAR_ORDERS, "motor_harmonic": MOTOR_ORDERS, "base_tilt": len(scene), "target_shift": nests * len(scene),
    }  # fmt: skip
    return counts.get(effect, 1)


def price(effect: str, scene: Scene) -> float:
    """What a scanned family pays: 2 ln(variants)."""
    return float(2.0 * np.log(variants(effect, scene)))


def given_others(white: Sequence[Array]) -> Array:
    """Lambda (k,) of each of k white signatures (3n,), the directions of the others being free."""
    S = np.stack(white, axis=1)
    found = np.empty(S.shape[1])
    for i in range(len(found)):
        rest = np.delete(S, i, axis=1)
        left = S[:, i]
        if rest.shape[1]:
            Q, _ = np.linalg.qr(rest)
            left = left - Q @ (Q.T @ left)
        found[i] = left @ left
    return found
