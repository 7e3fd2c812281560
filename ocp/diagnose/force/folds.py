"""Folds of a force log, and what effects bring on rows that were left out: linear refits about the fits of all rows.

With the left-out rows' part of the normal equations taken off, the unknowns move by
    dz = -(H - B^T B)^-1 B^T e_B            (docs/force_registration.md, eq. 12),
which is what a refit without them gives to first order; a fit with effects and one without have unknowns of their own.
"""

from typing import Any

import numpy as np

from ocp.calibrate.force.log import Flags, ForceLog
from ocp.diagnose.engine.system import Fold, HeldOut, drifts
from ocp.diagnose.force.fit import EffectFit, ForceProblem
from ocp.diagnose.force.prediction import LogScene
from robots.pose import Array

Fitted = tuple[ForceProblem, EffectFit]
PARTS = 5
PIECE = 40  # rows of a run that stay together in random folds
LEAST = 40  # rows in contact on each side
REST = 1 / 3  # of the rows in contact that must be left: what few rows say about the many judges nothing
GROSS = 0.1  # weight of a reading below which it is an outlier and is not held against a model


def force_folds(log: ForceLog, scene: LogScene) -> list[Fold]:
    """Pieces of runs (random) and stretches of the passes (block); then runs, lines, setpoints, feeds, belts, directions of
    travel, sessions, times, each left out as a whole."""
    c = scene.conditions
    rng = np.random.default_rng(0)
    piece = np.zeros(len(log), np.int64)
    for r in np.unique(log.run):
        at = np.flatnonzero(log.run == r)
        piece[at] = 1000 * int(r) + np.arange(len(at)) // PIECE
    kinds, index = np.unique(piece, return_inverse=True)
    part = rng.permutation(np.arange(len(kinds)) % PARTS)[index]
    found = [Fold(f"random={k + 1}", "random", part == k) for k in range(PARTS)]
    edges = np.quantile(c.s[log.contact], np.linspace(0, 1, PARTS + 1))
    stretch = np.searchsorted(edges[1:-1], c.s)
    found += [Fold(f"stretch={k + 1}", "block", (stretch == k) & log.contact) for k in range(PARTS)]
    ways: dict[str, Any] = {
        "run": log.run, "line": log.line, "feed": log.feed, "belt": log.belt, "travel": c.travel,
    }  # fmt: skip
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
    rest = max(LEAST, REST * log.contact.sum())
    return [f for f in found if (f.held & log.contact).sum() >= LEAST and (~f.held & log.contact).sum() >= rest]


def _left_out(kind: str, values: Array, log: ForceLog) -> list[Fold]:
    """One fold for each value."""
    levels = np.unique(values[log.contact])
    scale = {"feed": 1e3}.get(kind, 1.0)
    names = {v: log.runs[int(v)] if kind == "run" else f"{scale * v:g}" for v in levels}
    held = [(v, (values == v) & (log.contact | (kind == "run"))) for v in levels]
    return [Fold(f"{kind}={names[v]}", kind, rows) for v, rows in held] if len(levels) > 1 else []


def fold_errors(before: Fitted, after: Fitted, fold: Fold, good: Flags) -> HeldOut | None:
    """Squared errors N^2 of the fold's normal readings in contact, everything refitted on the rest, without and with effects;
    good (n,): readings that are held against a model, the same ones whatever the effects, so that errors can be compared.

    What the believed contact itself cannot know there without them counts as noise. Where that is more than a reading's own
    noise nothing is judged: another side of the blade stands where its registration has it, whatever the effect.
    """
    log, held, whitener = after[0].log, np.asarray(fold.held, bool), after[1].whiteners[0]
    rows = held & log.contact & good
    if rows.sum() < LEAST or (~held & log.contact).sum() < LEAST:
        return None
    changes = [_change(*fitted, held) for fitted in (before, after)]
    b, a = (_errors(*fitted, change)[rows] ** 2 for fitted, change in zip((before, after), changes, strict=True))
    noise, unknown = whitener.noise.sigma()[rows] ** 2, _extrapolated(*before, held)[rows]
    if fold.extrapolates and unknown.mean() > noise.mean():
        return None
    noise = noise + unknown
    fit, (r, o) = after[1], after[0].sizes
    covariance = np.asarray(np.linalg.inv(_information(fit, held)), float)
    # What errors of estimation without the held rows bring into these, beyond what they bring without effects: an effect that
    # the nuisance imitates has a value that is hardly known, and a prediction that is.
    columns = fit.normal[rows].copy()
    columns[:, r : r + o] = 0.0
    told = np.maximum(np.einsum("ni,ij,nj->n", columns, covariance, columns) - unknown, 0.0)
    drift = drifts(fit.active, changes[1][r + o :], covariance[r + o :, r + o :])
    return HeldOut(fold, float(b.mean()), float(a.mean()), float(noise.mean()), b, a, noise, float(told.mean()), drift)


def _information(fit: EffectFit, held: Flags) -> Array:
    """What the rows beside the held ones tell (k, k), the prior's in."""
    rest = fit.sensitivity[~np.tile(held, len(fit.whiteners))]
    return np.asarray(np.eye(len(fit.z)) + rest.T @ rest)


def _extrapolated(problem: ForceProblem, fit: EffectFit, held: Flags) -> Array:
    """Variance (n,) N^2 that the nuisance has in the readings when it is fitted without the held rows."""
    r = problem.sizes[0]
    covariance = np.linalg.inv(_information(fit, held))[:r, :r]
    return np.asarray(np.einsum("ni,ij,nj->n", fit.normal[:, :r], covariance, fit.normal[:, :r]))


def _change(problem: ForceProblem, fit: EffectFit, held: Flags) -> Array:
    """By how much the unknowns (k,) move without the held rows."""
    out = np.tile(held, len(fit.whiteners))
    # At the estimate the whole gradient is zero: what the held rows pulled is what their absence lets go.
    return np.asarray(-np.linalg.solve(_information(fit, held), fit.sensitivity[out].T @ fit.residual[out]))


def _errors(problem: ForceProblem, fit: EffectFit, change: Array) -> Array:
    """Measured less predicted normal reading (n,) N with the unknowns moved by `change`."""
    r = problem.sizes[0]
    columns = fit.normal.copy()
    columns[:, r : r + problem.offsets.runs] = 0.0  # a run's own offset does not carry over
    return np.asarray(problem.gap(fit.at, fit.z) - columns @ change)
