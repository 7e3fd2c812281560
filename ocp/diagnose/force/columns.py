"""First-order columns of a prediction: both readings' derivatives in the nuisance and in the coefficients of any effect."""

from collections.abc import Sequence

import numpy as np

from ocp.calibrate.force.fit import BIAS
from ocp.calibrate.force.model import PlacedRows
from ocp.diagnose.force.arm import BLADE
from ocp.diagnose.force.believed import NUISANCE, SHEAR_BIAS, SHEAR_GAIN
from ocp.diagnose.force.context import hook_columns
from ocp.diagnose.force.prediction import M, Predicted, Scene, carried, interference, remembered, remembering
from ocp.effects.effect import Effect, Scanned
from robots.pose import Array

Both = tuple[Array, Array]  # of fn and ft, N


def derivatives(scene: Scene, at: Predicted) -> tuple[Array, Array]:
    """Contact force's derivatives of all rows: in theta (n, M) and in the joints (n, 6), zero in the air."""
    n, rows = len(scene.rows), scene.touching
    theta, joints = np.zeros((n, M)), np.zeros((n, 6))
    held = np.maximum(at.F[rows], scene.model.least_force)
    values = scene.model.evaluate("derivative", PlacedRows(at.rows.base, at.rows.theta), held)
    scaled = at.stiffness[rows, None] * values
    theta[rows], joints[rows] = scaled[:, 1 : 1 + M], scaled[:, 1 + M :]
    return theta, joints


def nuisance_columns(scene: Scene, at: Predicted, theta: Array) -> Both:
    """Derivatives (n, len(NUISANCE)) of fn and ft in the nuisance; theta (n, M): those of the force."""
    n = len(at.F)
    fn, ft = np.zeros((n, len(NUISANCE))), np.zeros((n, len(NUISANCE)))
    fn[:, :M], ft[:, :M] = at.fn_slope[:, None] * theta, at.ft_slope[:, None] * theta
    fn[:, BIAS] = 1.0
    ft[:, SHEAR_GAIN], ft[:, SHEAR_BIAS] = scene.shear * at.F, 1.0
    if remembering(scene, at):
        force = np.zeros_like(fn)
        force[:, :M] = theta
        own, shear = force.copy(), force * _shear(scene, at)[:, None]
        own[:, BIAS], shear[:, SHEAR_GAIN], shear[:, SHEAR_BIAS] = 1.0, scene.shear * at.F, 1.0
        late_n, late_t = carried(scene, at, (force, own, shear))
        fn, ft = fn + late_n, ft + late_t
    return fn, ft


def effect_columns(
    scene: Scene, at: Predicted, slopes: tuple[Array, Array], effect: Effect, joint: int, scans: Sequence[Scanned]
) -> Both | None:
    """Change (V, n, m) N of fn and ft per unit coefficient of each variant; None where the log does not say what the effect
    depends on. `slopes`: of `derivatives`."""
    theta, joints = slopes
    n, rows = len(at.F), scene.touching
    fn, ft = np.zeros((len(scans), n, effect.size)), np.zeros((len(scans), n, effect.size))
    force = np.zeros_like(fn)
    if effect.overlap is not None or effect.push is not None:
        part = at.samples.take(rows)
        force[:, rows] = at.stiffness[rows, None] * interference(scene.cell, effect, joint, scans, part)
    if effect.on_arm:
        moved = scene.arm.columns(effect, joint, scans)
        force += np.einsum("nj,vnjm->vnm", joints[:, moved.moving], moved.shift, optimize=True)
        if moved.blade is not None:
            force += np.einsum("nj,vnjm->vnm", theta[:, BLADE], moved.blade, optimize=True)
    if force.any():
        fn += at.fn_slope[:, None] * force
        ft += at.ft_slope[:, None] * force
    if effect.sensor is not None:
        fn += hook_columns(scene.cell, effect, "sensor", joint, scans, at.samples)
    if effect.shear is not None:
        ft += hook_columns(scene.cell, effect, "shear", joint, scans, at.samples)
    if remembering(scene, at) and force.any():
        own = _rows(force)
        late_n, late_t = carried(scene, at, (own, own, own * _shear(scene, at)[:, None]))
        fn, ft = fn + _back(late_n, fn.shape), ft + _back(late_t, ft.shape)
    if effect.along is not None or effect.along_shear is not None:
        for v, scanned in enumerate(scans):
            late_n, late_t = remembered(scene, at, effect, joint, scanned)
            fn[v], ft[v] = fn[v] + late_n, ft[v] + late_t
    return (fn, ft) if np.isfinite(fn).all() and np.isfinite(ft).all() else None


def _shear(scene: Scene, at: Predicted) -> Array:
    """The contact's own tangential reading (n,) per newton of its force."""
    return np.asarray(scene.shear * (1.0 + at.x[SHEAR_GAIN]))


def _rows(columns: Array) -> Array:
    """Columns (V, n, m) as (n, V m)."""
    return np.moveaxis(columns, 1, 0).reshape(columns.shape[1], -1)


def _back(rows: Array, shape: tuple[int, ...]) -> Array:
    """The other way round: (n, V m) as (V, n, m)."""
    return np.moveaxis(rows.reshape(shape[1], shape[0], shape[2]), 0, 1)
