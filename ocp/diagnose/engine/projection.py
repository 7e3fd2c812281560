"""The nuisance projected out: what the readings say of effects once geometry, frames and springs are free to follow.

With unit noise, nuisance columns A of prior sd s_k and residual y about the prior's mean, y ~ N(A m, 1 + A S A^T): with the
singular values sigma of A S^1/2 and its left vectors U the symmetric root of the inverse covariance is

    M = 1 - U diag(1 - 1 / sqrt(1 + sigma^2)) U^T        (free unknowns: sigma infinite, taken out altogether)

so that M y is white and |M C a|^2 is the detectability lambda of columns C with coefficients a (docs/diagnosis.md, eq. 2).
Nothing is inverted: a covariance inverted without its singular values ruined the intervals of a prototype.
"""

from dataclasses import dataclass

import numpy as np

from ocp.diagnose.engine.channel_system import Channel, System
from robots.pose import Array

RANK = 1e-10  # singular values below this share of the largest are no direction of their own


@dataclass(frozen=True)
class Projection:
    """M as U (N, r) and what it takes of each direction (r,): 1 for free ones; free: how many are."""

    U: Array
    take: Array
    free: int

    def apply(self, rows: Array) -> Array:
        """M rows, rows (N,) or (N, m)."""
        inner = self.U.T @ rows
        return rows - self.U @ (self.take * inner if rows.ndim == 1 else self.take[:, None] * inner)


def project(columns: Array, prior_sd: Array) -> Projection:
    """Projection of columns (N, p) with prior sd (p,), infinite where free."""
    free = ~np.isfinite(prior_sd)
    parts, takes, count = [], [], 0
    rest = columns[:, ~free] * prior_sd[~free]
    if free.any():
        loose = columns[:, free]
        size = np.linalg.norm(loose, axis=0)
        U, s, _ = np.linalg.svd(loose / np.where(size > 0, size, 1.0), full_matrices=False)
        U = U[:, s > RANK * max(s[0], 1e-300)] if len(s) else U
        count = U.shape[1]
        parts.append(U)
        takes.append(np.ones(count))
        rest = rest - U @ (U.T @ rest)
    if rest.shape[1]:
        U, s, _ = np.linalg.svd(rest, full_matrices=False)
        keep = s > 1e-6
        parts.append(U[:, keep])
        takes.append(1.0 - 1.0 / np.sqrt(1.0 + s[keep] ** 2))
    if not parts:
        return Projection(np.zeros((len(columns), 0)), np.zeros(0), 0)
    return Projection(np.hstack(parts), np.concatenate(takes), count)


def about_prior(system: System) -> Array:
    """Residual (N,) about the prior's mean of the nuisance instead of the estimate, to first order."""
    known = np.isfinite(system.prior_sd)
    return np.asarray(system.residual + system.nuisance[:, known] @ system.offset[known])


@dataclass(frozen=True)
class Stack:
    """Channels one below the other: projections and row blocks; y (N,): white under 'no effect'; freedom: squares that noise
    alone leaves, rows less free nuisance and what picked rows have more; active effects' columns are put back into y (about
    zero coefficients)."""

    projections: tuple[Projection, ...]
    blocks: tuple[slice, ...]
    y: Array
    freedom: int

    def apply(self, columns: Array) -> Array:
        """M columns, columns (N, m) of all channels."""
        own = [p.apply(columns[b]) for p, b in zip(self.projections, self.blocks, strict=True)]
        return own[0] if len(own) == 1 else np.concatenate(own)


def stack(channels: tuple[Channel, ...], put_back: Array) -> Stack:
    """Stack of the channels' systems; put_back (N,): what the active effects add to the predictions, to be explained
    again."""
    projections, blocks, parts, start, picked = [], [], [], 0, 0.0
    for channel in channels:
        system = channel.system
        block = slice(start, start + len(system.residual))
        start = block.stop
        picked += system.picked
        projection = project(system.nuisance, system.prior_sd)
        projections.append(projection)
        blocks.append(block)
        parts.append(projection.apply(about_prior(system) + put_back[block]))
    y = np.concatenate(parts)
    return Stack(tuple(projections), tuple(blocks), y, len(y) - sum(p.free for p in projections) + round(picked))
