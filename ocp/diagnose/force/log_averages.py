"""The rows of a log that are handed on: averages over short blocks, and the fast patterns that averages would lose.

Nearly all of what any effect does to a reading is slow against ten samples; averages of whitened rows keep it, with unit
noise.
What is fast (a runout, a splice) is kept as products with its own patterns, orthonormal to the averages.
docs/diagnosis_force.md, eq. 9.
"""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np

from ocp.calibrate.force.noise import Whitener
from ocp.diagnose.engine.channel_system import Wave
from ocp.diagnose.engine.kernels import BY_RUN
from ocp.diagnose.force.fit import EffectFit, ForceProblem
from ocp.diagnose.force.prediction import effect_derivatives
from ocp.diagnose.rules import FAST_LAMBDA, FAST_SHARE
from ocp.effects.effect import Effect, Surroundings
from robots.pose import Array

TOGETHER = 24  # variants evaluated at once


@dataclass(frozen=True)
class LogAverages:
    """Rows of the whitened system: averages of each signal, products with the fast patterns.

    patterns (S, n, k): orthonormal whitened patterns of S signals together; back (S, n, k): through the filters' transposes;
    slopes (S, n): of the signals in the contact force.
    """

    whiteners: tuple[Whitener, ...]
    patterns: Array = field(repr=False)
    back: Array = field(repr=False)
    slopes: Array = field(repr=False)

    def rows(self, columns: Sequence[Array]) -> Array:
        """Columns (n, m) of each signal, N, as rows of the system (N, m)."""
        short = [w.short(c) for w, c in zip(self.whiteners, columns, strict=True)]
        return np.concatenate([*short, np.asarray(sum(b.T @ c for b, c in zip(self.back, columns, strict=True)))])

    def of_whitened(self, white: Array) -> Array:
        """Rows of the system from columns (S, n, m) that are whitened row by row."""
        short = [np.concatenate([s.blocks @ c[s.rows] for s in w.stretches]) for w, c in zip(self.whiteners, white, strict=True)]
        return np.concatenate([*short, np.einsum("snk,snm->km", self.patterns, white)])

    def variants(self, columns: Sequence[Array]) -> Array:
        """Columns (V, n, m) of each signal as rows (N, V, m)."""
        V, n, m = columns[0].shape
        return self.rows([c.swapaxes(0, 1).reshape(n, V * m) for c in columns]).reshape(-1, V, m)

    def by_force(self, force: Array) -> Array:
        """The same of an effect that does no more than change the contact force, by (n, V, m) N: one product with the patterns
        for all signals."""
        n, V, m = force.shape
        columns = force.reshape(n, V * m)
        short = [w.short(slope[:, None] * columns) for w, slope in zip(self.whiteners, self.slopes, strict=True)]
        return np.concatenate([*short, self._back_of_force.T @ columns]).reshape(-1, V, m)

    @cached_property
    def _back_of_force(self) -> Array:
        """What all signals' `back` make of a newton of the contact force (n, k)."""
        return np.einsum("snk,sn->nk", self.back, self.slopes)


def log_averages(
    problem: ForceProblem, fit: EffectFit, effects: Iterable[Effect], around: Surroundings, waves: Sequence[Wave]
) -> LogAverages:
    """The rows for this fit: fast patterns of `effects`, of all that is active and of waves that were picked."""
    n, count = len(problem.log), len(fit.whiteners)
    chosen = [np.zeros((count, n, 0))]
    for one in fit.active:
        both = effect_derivatives(problem.scene, fit.at, fit.slopes, one.effect, one.joint, [one.scanned])
        if both is not None:
            chosen.append(_lost(fit, both[:, 0]))
    chosen += [_lost(fit, [wave.columns, np.zeros_like(wave.columns)][:count]) for wave in waves]
    slopes = fit.at.slope[:count]
    chosen += [_lost(fit, slopes[:, :, None] * wave.columns) for wave in waves if wave.where.endswith(BY_RUN)]
    for effect in effects:
        if effect.on_arm or effect.along is not None or not _is_fast(problem, fit, effect, around):
            continue
        scans = effect.scan(0, around)
        for start in range(0, len(scans), TOGETHER):
            made = effect_derivatives(problem.scene, fit.at, fit.slopes, effect, 0, scans[start : start + TOGETHER])
            chosen += [] if made is None else [_lost(fit, made[:, v]) for v in range(made.shape[1])]
    patterns = _orthonormal(np.concatenate(chosen, axis=2))
    back = np.stack([w.back(p) for w, p in zip(fit.whiteners, patterns, strict=True)])
    return LogAverages(fit.whiteners, patterns, back, slopes)


def _lost(fit: EffectFit, columns: Iterable[Array]) -> Array:
    """What the averages lose of columns (n, m) of each signal, whitened: (S, n, m)."""
    return np.stack([w.lost(w.whole(c)) for w, c in zip(fit.whiteners, columns, strict=False)])


def _is_fast(problem: ForceProblem, fit: EffectFit, effect: Effect, around: Surroundings) -> bool:
    if not any((effect.overlap, effect.push, effect.sensor, effect.shear)):
        return False
    scans = effect.scan(0, around)
    made = effect_derivatives(problem.scene, fit.at, fit.slopes, effect, 0, [scans[len(scans) // 2]]) if len(scans) else None
    if made is None:
        return False
    scale = np.asarray(effect.prior_sd)
    white = [w.whole(c[0] * scale) for w, c in zip(fit.whiteners, made, strict=False)]
    whole = sum(float(np.sum(c**2)) for c in white)
    lost = sum(float(np.sum(w.lost(c) ** 2)) for w, c in zip(fit.whiteners, white, strict=False))
    return lost > FAST_LAMBDA and lost > FAST_SHARE * whole


def _orthonormal(columns: Array) -> Array:
    """Orthonormal patterns (S, n, k) of the span of columns (S, n, m) over all signals together."""
    count, n, m = columns.shape
    if not m:
        return columns
    flat = columns.reshape(count * n, m)
    size = np.linalg.norm(flat, axis=0)
    U, s, _ = np.linalg.svd(flat[:, size > 0] / size[size > 0], full_matrices=False)
    return np.asarray(U[:, s > 1e-6 * s[0]] if len(s) else flat[:, :0]).reshape(count, n, -1)
