"""Folds of a force log, and what effects bring on rows that were left out: linear refits about the fits of all rows.

With the left-out rows' part of the normal equations taken off, the unknowns move by what a refit without them gives to first
order (`ocp.calibrate.force.assessment.without_rows`); a fit with effects and one without have unknowns of their own.
"""

from typing import Any

import numpy as np

from ocp.calibrate.force.assessment import without_rows
from ocp.calibrate.force.log import Flags, ForceLog
from ocp.diagnose.engine.channel_system import Fold, HeldOut, drifts
from ocp.diagnose.force.fit import EffectFit, ForceProblem
from ocp.diagnose.force.prediction import LogScene
from ocp.diagnose.rules import FOLD_PARTS, FOLD_PIECE, FOLD_REST, FOLD_ROWS
from robots.pose import Array

Fitted = tuple[ForceProblem, EffectFit]


def force_folds(log: ForceLog, scene: LogScene) -> list[Fold]:
    """Pieces of runs (random) and stretches of the passes (block); then runs, lines, setpoints, feeds, belts, directions of
    travel, sessions, times, each left out as a whole."""
    c = scene.conditions
    rng = np.random.default_rng(0)
    piece = np.zeros(len(log), np.int64)
    for r in np.unique(log.run):
        at = np.flatnonzero(log.run == r)
        piece[at] = 1000 * int(r) + np.arange(len(at)) // FOLD_PIECE
    kinds, index = np.unique(piece, return_inverse=True)
    part = rng.permutation(np.arange(len(kinds)) % FOLD_PARTS)[index]
    found = [Fold(f"random={k + 1}", "random", part == k) for k in range(FOLD_PARTS)]
    edges = np.quantile(c.s[log.contact], np.linspace(0, 1, FOLD_PARTS + 1))
    stretch = np.searchsorted(edges[1:-1], c.s)
    found += [Fold(f"stretch={k + 1}", "block", (stretch == k) & log.contact) for k in range(FOLD_PARTS)]
    ways: dict[str, Any] = {name: getattr(log, name) for name in ("run", "line", "feed", "belt")} | {"travel": c.travel}
    if log.setpoint_sd is None:
        ways["setpoint"] = log.setpoint
    if len(log.sessions) > 1:
        ways["session"] = log.session
    for kind, values in ways.items():
        if values is not None:
            found += _left_out(kind, np.round(values, 6), log)
    clock = c.clock if "clock_s" in c.given else None
    if clock is not None and np.ptp(clock) > 0:
        cut = float(np.quantile(clock[log.contact], 2 / 3))
        found.append(Fold(f"time after {cut:.0f} s", "time", clock > cut))
    if log.wheel_temperature is not None and np.ptp(log.wheel_temperature) > 1.0:
        cut = float(np.quantile(log.wheel_temperature, 2 / 3))
        found.append(Fold(f"wheel above {cut:.1f} C", "temperature", log.wheel_temperature > cut))
    rest = max(FOLD_ROWS, FOLD_REST * log.contact.sum())
    return [f for f in found if (f.held & log.contact).sum() >= FOLD_ROWS and (~f.held & log.contact).sum() >= rest]


def _left_out(kind: str, values: Array, log: ForceLog) -> list[Fold]:
    """One fold for each value."""
    levels = np.unique(values[log.contact])
    scale = {"feed": 1e3}.get(kind, 1.0)
    names = {v: log.runs[int(v)] if kind == "run" else f"{scale * v:g}" for v in levels}
    held = [(v, (values == v) & (log.contact | (kind == "run"))) for v in levels]
    return [Fold(f"{kind}={names[v]}", kind, rows) for v, rows in held] if len(levels) > 1 else []


def force_fold_errors(before: Fitted, after: Fitted, fold: Fold, good: Flags) -> HeldOut | None:
    """Squared errors N^2 of the fold's normal readings in contact, everything refitted on the rest, without and with effects;
    good (n,): readings that are held against a model, the same ones whatever the effects, so that errors can be compared.

    What the believed contact itself cannot know there without them counts as noise. Where that is more than a reading's own
    noise nothing is judged: another side of the blade stands where its registration has it, whatever the effect.
    """
    log, held, whitener = after[0].log, np.asarray(fold.held, bool), after[1].whiteners[0]
    rows = held & log.contact & good
    if rows.sum() < FOLD_ROWS or (~held & log.contact).sum() < FOLD_ROWS:
        return None
    changes, covariances = zip(*(_without(fit, held) for _, fit in (before, after)), strict=True)
    b, a = (_errors(*fitted, change)[rows] ** 2 for fitted, change in zip((before, after), changes, strict=True))
    (r, o), nuisance, covariance = after[0].sizes, before[1].normal[rows, : before[0].sizes[0]], covariances[1]
    known = covariances[0][: nuisance.shape[1], : nuisance.shape[1]]
    noise, unknown = whitener.noise.sigma()[rows] ** 2, np.einsum("ni,ij,nj->n", nuisance, known, nuisance)
    if fold.extrapolates and unknown.mean() > noise.mean():
        return None
    noise = noise + unknown
    # What errors of estimation without the held rows bring into these, beyond what they bring without effects: an effect that
    # the nuisance imitates has a value that is hardly known, and a prediction that is.
    columns = after[1].normal[rows].copy()
    columns[:, r : r + o] = 0.0
    estimation = np.maximum(np.einsum("ni,ij,nj->n", columns, covariance, columns) - unknown, 0.0)
    drift = drifts(after[1].active, changes[1][r + o :], covariance[r + o :, r + o :])
    return HeldOut(fold, float(b.mean()), float(a.mean()), float(noise.mean()), b, a, noise, float(estimation.mean()), drift)


def _without(fit: EffectFit, held: Flags) -> tuple[Array, Array]:
    """By how much the unknowns (k,) move without the held rows, and their covariance (k, k) then."""
    out = np.tile(held, len(fit.whiteners))
    rest = fit.sensitivity[~out]
    return without_rows(np.eye(len(fit.z)) + rest.T @ rest, fit.sensitivity[out], fit.residual[out])


def _errors(problem: ForceProblem, fit: EffectFit, change: Array) -> Array:
    """Measured less predicted normal reading (n,) N with the unknowns moved by `change`."""
    r = problem.sizes[0]
    columns = fit.normal.copy()
    columns[:, r : r + problem.offsets.runs] = 0.0  # a run's own offset does not carry over
    return np.asarray(problem.gap(fit.at, fit.z) - columns @ change)
